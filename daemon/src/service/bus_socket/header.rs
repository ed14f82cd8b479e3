//! Parses the fields of a message header that the queue needs (D-Bus specification, message protocol).

/// Number of bytes from which a message's length can be computed.
pub(super) const FIXED: usize = 16;
/// Maximum length of a message by the specification, bytes.
const LONGEST: usize = 1 << 27;

const METHOD_CALL: u8 = 1;
const SIGNAL: u8 = 4;
const FLAGS: usize = 2;
const NO_REPLY_EXPECTED: u8 = 1;

/// Data before the first message are lines of the authentication, which never begin with these bytes.
const ENDIAN: [u8; 2] = [b'l', b'B'];

/// Not a valid message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the bus sent bytes that are not a message")]
pub(super) struct Malformed;

/// Type and origin of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Header<'a> {
    kind: u8,
    flags: u8,
    /// Serial number given by the sender.
    pub(super) serial: u32,
    /// The unique name added by the bus; empty if there is none.
    pub(super) sender: &'a str,
    pub(super) interface: &'a str,
    pub(super) member: &'a str,
    /// Number of attached file descriptors.
    pub(super) descriptors: usize,
}

impl Header<'_> {
    pub(super) fn is_call(&self) -> bool {
        self.kind == METHOD_CALL
    }

    pub(super) fn is_signal(&self) -> bool {
        self.kind == SIGNAL
    }

    /// Whether its sender expects a reply.
    pub(super) fn wants_answer(&self) -> bool {
        self.flags & NO_REPLY_EXPECTED == 0
    }
}

/// Clears the no-reply flag of a call, so that the reply shows when the call has been served.
pub(super) fn ask_for_answer(message: &mut [u8]) {
    message[FLAGS] &= !NO_REPLY_EXPECTED;
}

/// Length in bytes of the first message, or of a line of the authentication; `None` if more bytes are needed.
///
/// # Errors
/// The bytes are neither a message nor a line.
pub(super) fn length(bytes: &[u8]) -> Result<Option<usize>, Malformed> {
    let Some(first) = bytes.first() else {
        return Ok(None);
    };
    if !ENDIAN.contains(first) {
        return match bytes.iter().position(|byte| *byte == b'\n') {
            Some(end) => Ok(Some(end + 1)),
            None if bytes.len() > LONGEST_LINE => Err(Malformed),
            None => Ok(None),
        };
    }
    if bytes.len() < FIXED {
        return Ok(None);
    }
    let cursor = Cursor::new(bytes);
    let (body, fields) = (cursor.number_at(4)?, cursor.number_at(12)?);
    let length = fields
        .checked_add(FIXED)
        .map(|header| header.next_multiple_of(8))
        .and_then(|header| header.checked_add(body))
        .filter(|length| *length <= LONGEST);
    length.map(Some).ok_or(Malformed)
}

/// Maximum length of an authentication line, bytes.
const LONGEST_LINE: usize = 16 * 1024;

/// Parses the header of a complete message; `None` for a line of the authentication.
pub(super) fn read(message: &[u8]) -> Option<Header<'_>> {
    if message.len() < FIXED || !ENDIAN.contains(&message[0]) {
        return None;
    }
    let mut header = Header {
        kind: message[1],
        flags: message[FLAGS],
        serial: Cursor::new(message).number_at(8).unwrap_or_default() as u32,
        sender: "",
        interface: "",
        member: "",
        descriptors: 0,
    };
    // fields after an invalid one are unknown: zbus refuses such a message
    let _ = fields(message, &mut header);
    Some(header)
}

fn fields<'a>(message: &'a [u8], header: &mut Header<'a>) -> Result<(), Malformed> {
    let mut cursor = Cursor::new(message);
    let end = cursor.number_at(12)?.saturating_add(FIXED);
    cursor.at = FIXED;
    while cursor.at < end {
        cursor.align(8);
        let code = cursor.byte()?;
        match (code, cursor.short_text()?) {
            (2, "s") => header.interface = cursor.text()?,
            (3, "s") => header.member = cursor.text()?,
            (7, "s") => header.sender = cursor.text()?,
            (9, "u") => header.descriptors = cursor.number()?,
            (_, "s" | "o") => drop(cursor.text()?),
            (_, "g") => drop(cursor.short_text()?),
            (_, "u") => drop(cursor.number()?),
            _ => return Err(Malformed),
        }
    }
    Ok(())
}

/// A position in a message.
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    fn align(&mut self, to: usize) {
        self.at = self.at.next_multiple_of(to);
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], Malformed> {
        let end = self.at.checked_add(count).ok_or(Malformed)?;
        let taken = self.bytes.get(self.at..end).ok_or(Malformed)?;
        self.at = end;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, Malformed> {
        self.take(1).map(|taken| taken[0])
    }

    fn number_at(&self, at: usize) -> Result<usize, Malformed> {
        let four = self
            .bytes
            .get(at..at + 4)
            .and_then(|four| four.try_into().ok());
        let four: [u8; 4] = four.ok_or(Malformed)?;
        Ok(match self.bytes[0] {
            b'l' => u32::from_le_bytes(four),
            _ => u32::from_be_bytes(four),
        } as usize)
    }

    fn number(&mut self) -> Result<usize, Malformed> {
        self.align(4);
        let number = self.number_at(self.at)?;
        self.at += 4;
        Ok(number)
    }

    /// A string: its length in four bytes, its text, a zero byte.
    fn text(&mut self) -> Result<&'a str, Malformed> {
        let length = self.number()?;
        self.terminated(length)
    }

    /// A string: its length in one byte, its text, a zero byte.
    fn short_text(&mut self) -> Result<&'a str, Malformed> {
        let length = self.byte()?;
        self.terminated(length.into())
    }

    fn terminated(&mut self, length: usize) -> Result<&'a str, Malformed> {
        let text = self.take(length)?;
        self.take(1)?;
        std::str::from_utf8(text).map_err(|_| Malformed)
    }
}

#[cfg(test)]
mod tests {
    use zbus::Message;
    use zbus::message::Flags;

    use super::*;

    #[test]
    fn a_header_is_read_as_zbus_wrote_it() {
        let call = Message::method_call("/org/tactus", "Stop")
            .interface("org.tactus.Tactus1.Session1")
            .sender(":1.42")
            .with_flags(Flags::NO_REPLY_EXPECTED)
            .build(&("a body", 7_u32))
            .unwrap();
        let bytes = call.data().bytes();
        assert_eq!(length(bytes), Ok(Some(bytes.len())));
        let header = read(bytes).unwrap();
        assert!(header.is_call() && !header.is_signal() && !header.wants_answer());
        assert_eq!(header.sender, ":1.42");
        assert_eq!(header.interface, "org.tactus.Tactus1.Session1");
        assert_eq!(header.member, "Stop");
        assert_eq!(header.descriptors, 0);
        assert_eq!(header.serial, call.primary_header().serial_num().get());
        let mut requested = bytes.to_vec();
        ask_for_answer(&mut requested);
        assert!(read(&requested).unwrap().wants_answer());
        for shorter in 0..FIXED {
            assert_eq!(length(&bytes[..shorter]), Ok(None));
        }
    }

    #[test]
    fn damaged_headers_are_refused_or_read_in_part() {
        let signal = Message::signal("/org/tactus", "org.tactus.Tactus1", "Pulse")
            .sender(":1.7")
            .build(&())
            .unwrap();
        let good = signal.data().bytes().to_vec();
        assert!(read(&good).unwrap().is_signal());
        for at in 0..good.len() {
            for value in [0, 1, 0x7f, 0xff] {
                let mut bad = good.clone();
                bad[at] = value;
                // for any input: no panic, and no length beyond the specification's limit
                if let Ok(Some(length)) = length(&bad) {
                    assert!(length <= LONGEST);
                }
                let _ = read(&bad);
            }
        }
        let mut long = good;
        long[4..8].fill(0xff);
        assert_eq!(length(&long), Err(Malformed));
    }

    #[test]
    fn lines_of_the_authentication_end_with_a_line_feed() {
        assert_eq!(length(b"OK 0123\r\nAGREE"), Ok(Some(9)));
        assert_eq!(length(b"AGREE_UNIX_FD"), Ok(None));
        assert_eq!(length(&[b'O'; LONGEST_LINE + 1]), Err(Malformed));
        assert_eq!(read(b"OK 0123456789abcdef\r\n"), None);
    }
}
