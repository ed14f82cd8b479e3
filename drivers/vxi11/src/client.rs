//! The client: links to a core channel, and discovery of core channels by a broadcast to port mappers.

use std::io;
use std::net::{Ipv4Addr, SocketAddr};

use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt};
use tokio::net::UdpSocket;
use tokio::time::Instant;

use crate::procedure::*;
use crate::rpc::{Call, MalformedArguments, Reader, Writer, marked, read_record, results};

/// Longest record accepted from an instrument, bytes.
const LARGEST_RECORD: usize = 64 * 1024;
/// Timeout sent to the instrument for an operation, and for another client's lock, ms. The client itself waits as long
/// as its connection lasts: callers set a limit.
const OPERATION_MS: u32 = 2000;
/// Transaction number (xid) of the first call.
const FIRST_CALL: u32 = 0x7461_6374;

/// A connection to a core channel.
#[derive(Debug)]
pub struct Client<S> {
    stream: S,
    next_call: u32,
}

/// A link to an instrument behind a core channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkId(u32);

impl<S: AsyncRead + AsyncWrite + Unpin> Client<S> {
    /// A client on a stream that is connected to a core channel.
    pub fn new(stream: S) -> Self {
        Self {
            stream,
            next_call: FIRST_CALL,
        }
    }

    /// Creates a link to the instrument of that name, such as `inst0`, without a lock.
    ///
    /// # Errors
    /// A broken connection, a record that is not a reply to the call, or an error code from the instrument.
    pub async fn create_link(&mut self, name: &str) -> io::Result<LinkId> {
        let arguments = Writer::default()
            .word(1)
            .word(0)
            .word(OPERATION_MS)
            .opaque(name.as_bytes());
        self.call(CREATE_LINK, arguments, |results| results.word().map(LinkId))
            .await
    }

    /// Sends a whole message.
    ///
    /// # Errors
    /// As [`Client::create_link`].
    pub async fn write(&mut self, link: LinkId, message: &[u8]) -> io::Result<()> {
        let arguments = Writer::default()
            .word(link.0)
            .word(OPERATION_MS)
            .word(OPERATION_MS)
            .word(END)
            .opaque(message);
        self.call(DEVICE_WRITE, arguments, |_| Ok(())).await
    }

    /// Reads a reply, or at most its first `most` bytes.
    ///
    /// # Errors
    /// As [`Client::create_link`].
    pub async fn read(&mut self, link: LinkId, most: u32) -> io::Result<Vec<u8>> {
        let arguments = Writer::default()
            .word(link.0)
            .word(most)
            .word(OPERATION_MS)
            .word(OPERATION_MS)
            .word(0)
            .word(0);
        self.call(DEVICE_READ, arguments, |results| {
            let _reason = results.word()?;
            results.opaque().map(<[u8]>::to_vec)
        })
        .await
    }

    /// Ends a link.
    ///
    /// # Errors
    /// As [`Client::create_link`].
    pub async fn destroy_link(&mut self, link: LinkId) -> io::Result<()> {
        self.call(DESTROY_LINK, Writer::default().word(link.0), |_| Ok(()))
            .await
    }

    /// Sends one call and reads its results, which follow the error code at the start of each reply.
    async fn call<T>(
        &mut self,
        procedure: u32,
        arguments: Writer,
        read: impl FnOnce(&mut Reader<'_>) -> Result<T, MalformedArguments>,
    ) -> io::Result<T> {
        let invalid = |reason: String| io::Error::new(io::ErrorKind::InvalidData, reason);
        let xid = self.next_call;
        self.next_call = xid.wrapping_add(1);
        let call = Call::record(xid, CORE, VERSION, procedure, &arguments.bytes());
        self.stream.write_all(&marked(&call)).await?;
        let record = read_record(&mut self.stream, LARGEST_RECORD)
            .await?
            .ok_or(io::ErrorKind::UnexpectedEof)?;
        let mut results = results(&record, xid)
            .ok_or_else(|| invalid(format!("no reply to VXI-11 procedure {procedure}")))?;
        let garbage = |_| {
            invalid(format!(
                "the reply to VXI-11 procedure {procedure} is cut off"
            ))
        };
        match results.word().map_err(garbage)? {
            0 => read(&mut results).map_err(garbage),
            code => Err(invalid(format!(
                "VXI-11 procedure {procedure} is refused with error {code}"
            ))),
        }
    }
}

/// Queries port mappers for their VXI-11 core channels by a broadcast from an address of this machine to a broadcast
/// address and port (port mappers listen on 111). Returns the addresses of the core channels that replied before
/// `until`; a host without a core channel replies with port 0 and is left out.
///
/// # Errors
/// The request cannot be sent from this address.
pub async fn find_core_channels(
    from: Ipv4Addr,
    to: Ipv4Addr,
    port: u16,
    until: Instant,
) -> io::Result<Vec<SocketAddr>> {
    let socket = UdpSocket::bind((from, 0)).await?;
    socket.set_broadcast(true)?;
    let arguments = Writer::default().word(CORE).word(VERSION).word(TCP).word(0);
    let call = Call::record(
        FIRST_CALL,
        PORT_MAPPER,
        PORT_MAPPER_VERSION,
        GET_PORT,
        &arguments.bytes(),
    );
    socket.send_to(&call, (to, port)).await?;
    let mut found = Vec::new();
    let mut buffer = [0; 1024];
    while let Ok(received) = tokio::time::timeout_at(until, socket.recv_from(&mut buffer)).await {
        // A host without a port mapper causes an error that concerns no other host.
        let Ok((length, peer)) = received else {
            continue;
        };
        if let Some(mut results) = results(&buffer[..length], FIRST_CALL)
            && let Ok(port) = results.word()
            && let Ok(port) = u16::try_from(port)
            && port != 0
        {
            found.push(SocketAddr::new(peer.ip(), port));
        }
    }
    Ok(found)
}
