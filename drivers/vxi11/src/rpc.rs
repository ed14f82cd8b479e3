//! The parts of ONC RPC version 2 (RFC 5531) that VXI-11 needs: record marking, calls, replies, XDR (RFC 4506).

use std::io;

use tokio::io::{AsyncRead, AsyncReadExt};

/// Flag in the mark of a record's last fragment.
const LAST_FRAGMENT: u32 = 1 << 31;
const CALL: u32 = 0;
const REPLY: u32 = 1;
const RPC_VERSION: u32 = 2;

/// Reads one record of at most `most` bytes; `None` at the end of the stream.
///
/// # Errors
/// A broken stream, or a record that is too long.
pub(crate) async fn read_record<S>(stream: &mut S, most: usize) -> io::Result<Option<Vec<u8>>>
where
    S: AsyncRead + Unpin,
{
    let mut record = Vec::new();
    loop {
        let mark = match stream.read_u32().await {
            Ok(mark) => mark,
            Err(end) if end.kind() == io::ErrorKind::UnexpectedEof && record.is_empty() => {
                return Ok(None);
            }
            Err(fault) => return Err(fault),
        };
        let length = (mark & !LAST_FRAGMENT) as usize;
        if record.len() + length > most {
            let reason = format!("an RPC record of more than {most} bytes");
            return Err(io::Error::new(io::ErrorKind::InvalidData, reason));
        }
        let start = record.len();
        record.resize(start + length, 0);
        stream.read_exact(&mut record[start..]).await?;
        if mark & LAST_FRAGMENT != 0 {
            return Ok(Some(record));
        }
    }
}

/// Prepends the record mark.
pub(crate) fn marked(record: &[u8]) -> Vec<u8> {
    let length = u32::try_from(record.len()).expect("replies are bounded well below 2 GiB");
    let mut bytes = (length | LAST_FRAGMENT).to_be_bytes().to_vec();
    bytes.extend_from_slice(record);
    bytes
}

/// Arguments that do not have the expected form.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct MalformedArguments;

/// XDR decoder (RFC 4506).
#[derive(Debug)]
pub(crate) struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    pub(crate) fn word(&mut self) -> Result<u32, MalformedArguments> {
        let (word, rest) = self.0.split_first_chunk::<4>().ok_or(MalformedArguments)?;
        self.0 = rest;
        Ok(u32::from_be_bytes(*word))
    }

    pub(crate) fn flag(&mut self) -> Result<bool, MalformedArguments> {
        self.word().map(|word| word != 0)
    }

    pub(crate) fn opaque(&mut self) -> Result<&'a [u8], MalformedArguments> {
        let length = self.word()? as usize;
        let padded = length
            .checked_next_multiple_of(4)
            .ok_or(MalformedArguments)?;
        if padded > self.0.len() {
            return Err(MalformedArguments);
        }
        let (bytes, rest) = self.0.split_at(padded);
        self.0 = rest;
        Ok(&bytes[..length])
    }
}

/// XDR encoder.
#[derive(Debug, Default)]
pub(crate) struct Writer(Vec<u8>);

impl Writer {
    pub(crate) fn word(mut self, word: u32) -> Self {
        self.0.extend_from_slice(&word.to_be_bytes());
        self
    }

    pub(crate) fn opaque(self, bytes: &[u8]) -> Self {
        let length = u32::try_from(bytes.len()).expect("replies are bounded well below 4 GiB");
        let mut written = self.word(length);
        written.0.extend_from_slice(bytes);
        let padded = written.0.len().next_multiple_of(4);
        written.0.resize(padded, 0);
        written
    }

    pub(crate) fn bytes(self) -> Vec<u8> {
        self.0
    }
}

/// A call without its arguments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Call {
    pub(crate) xid: u32,
    version: u32,
    pub(crate) program: u32,
    pub(crate) program_version: u32,
    pub(crate) procedure: u32,
}

impl Call {
    /// Reads the header of a call; its arguments remain in the reader.
    pub(crate) fn read(reader: &mut Reader<'_>) -> Result<Self, MalformedArguments> {
        let xid = reader.word()?;
        if reader.word()? != CALL {
            return Err(MalformedArguments);
        }
        let call = Self {
            xid,
            version: reader.word()?,
            program: reader.word()?,
            program_version: reader.word()?,
            procedure: reader.word()?,
        };
        // Credential and verifier are ignored: any client that reaches the port may use it.
        for _ in 0..2 {
            reader.word()?;
            reader.opaque()?;
        }
        Ok(call)
    }

    /// A call without credentials, followed by its arguments.
    pub(crate) fn record(
        xid: u32,
        program: u32,
        program_version: u32,
        procedure: u32,
        arguments: &[u8],
    ) -> Vec<u8> {
        let head = [xid, CALL, RPC_VERSION, program, program_version, procedure];
        // Credential and verifier: both of flavour none and empty.
        let words = head.into_iter().chain([0; 4]);
        let mut record: Vec<u8> = words.flat_map(u32::to_be_bytes).collect();
        record.extend_from_slice(arguments);
        record
    }

    pub(crate) fn is_understood(&self) -> bool {
        self.version == RPC_VERSION
    }
}

/// Outcome of a call.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Reply {
    Done(Vec<u8>),
    NoProgram,
    NoVersion(u32),
    NoProcedure,
    GarbageArguments,
    /// Rejected: the call has another version of RPC.
    Denied,
}

/// The results in an accepted and successful reply to the call with this xid; `None` for any other record.
pub(crate) fn results(record: &[u8], xid: u32) -> Option<Reader<'_>> {
    let mut reader = Reader::new(record);
    let head = [
        reader.word().ok()?,
        reader.word().ok()?,
        reader.word().ok()?,
    ];
    let _flavour = reader.word().ok()?;
    reader.opaque().ok()?;
    let is_success = reader.word().ok()? == 0;
    (head == [xid, REPLY, 0] && is_success).then_some(reader)
}

impl Reply {
    pub(crate) fn record(&self, xid: u32) -> Vec<u8> {
        let head = Writer::default().word(xid).word(REPLY);
        if *self == Self::Denied {
            // MSG_DENIED, RPC_MISMATCH, lowest and highest version.
            let denied = head.word(1).word(0);
            return denied.word(RPC_VERSION).word(RPC_VERSION).bytes();
        }
        // MSG_ACCEPTED, an empty verifier.
        let accepted = head.word(0).word(0).word(0);
        match self {
            Self::Done(results) => {
                let mut record = accepted.word(0).bytes();
                record.extend_from_slice(results);
                record
            }
            Self::NoProgram => accepted.word(1).bytes(),
            Self::NoVersion(only) => accepted.word(2).word(*only).word(*only).bytes(),
            Self::NoProcedure => accepted.word(3).bytes(),
            Self::GarbageArguments | Self::Denied => accepted.word(4).bytes(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn fragments_are_joined_and_long_records_refused() {
        let mut bytes = vec![0, 0, 0, 2, b'a', b'b', 0, 0, 0, 0];
        bytes.extend([0x80, 0, 0, 1, b'c']);
        let record = read_record(&mut bytes.as_slice(), 8).await.unwrap();
        assert_eq!(record.unwrap(), b"abc");
        assert!(read_record(&mut bytes.as_slice(), 2).await.is_err());
        assert!(read_record(&mut [0xff; 8].as_slice(), 64).await.is_err());
        assert!(read_record(&mut [].as_slice(), 64).await.unwrap().is_none());
        // A stream that ends in the middle of a record is an error.
        assert!(read_record(&mut &bytes[..6], 8).await.is_err());
        assert_eq!(marked(b"abc"), [0x80, 0, 0, 3, b'a', b'b', b'c']);
    }

    #[test]
    fn xdr_is_padded_and_bounded() {
        let bytes = Writer::default().word(7).opaque(b"inst0").bytes();
        assert_eq!(bytes.len(), 4 + 4 + 8);
        let mut reader = Reader::new(&bytes);
        assert_eq!(reader.word(), Ok(7));
        assert_eq!(reader.opaque(), Ok(b"inst0".as_slice()));
        assert_eq!(reader.word(), Err(MalformedArguments));
        let lie = [0xff, 0xff, 0xff, 0xff, 1, 2, 3, 4];
        assert_eq!(Reader::new(&lie).opaque(), Err(MalformedArguments));
    }

    #[test]
    fn results_of_a_success_are_read_and_of_nothing_else() {
        let words = |words: &[u32]| -> Vec<u8> {
            words.iter().flat_map(|word| word.to_be_bytes()).collect()
        };
        let success = Reply::Done(words(&[703])).record(7);
        assert_eq!(results(&success, 7).unwrap().word(), Ok(703));
        let wrong_number = results(&success, 8);
        assert!(wrong_number.is_none());
        let endless_verifier = words(&[7, 1, 0, 0, u32::MAX, 0, 703]);
        let refused = Reply::Denied.record(7);
        let unknown = Reply::NoProcedure.record(7);
        for other in [
            endless_verifier.as_slice(),
            &refused,
            &unknown,
            &[],
            b"GET /",
        ] {
            assert!(results(other, 7).is_none());
        }
        for length in 0..success.len() - 4 {
            assert!(results(&success[..length], 7).is_none());
        }
    }

    #[test]
    fn a_call_reads_as_it_was_written() {
        let record = Call::record(9, 100_000, 2, 3, b"argument");
        let mut reader = Reader::new(&record);
        let call = Call::read(&mut reader).unwrap();
        assert!(call.is_understood());
        assert_eq!(
            [call.xid, call.program, call.program_version, call.procedure],
            [9, 100_000, 2, 3]
        );
        assert_eq!(reader.0, b"argument");
    }
}
