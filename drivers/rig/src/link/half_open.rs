//! Half-open connections: our end is closed, the peer's end is still open.
//!
//! If a cable is unplugged for longer than TCP's timeout, our end of a connection is closed without a message to the
//! peer. The instrument's end stays open, and an instrument that serves one client at a time remains occupied, some
//! models permanently. A new connection from the same local port is taken for the lost one: the instrument's TCP
//! replies with an acknowledgement, our TCP with a reset. The reset ends the old connection, and the next attempt
//! succeeds (RFC 9293, section 3.5.1, figure 10).

use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpSocket, TcpStream};

/// The last connection to an address that received data, and the number of attempts since.
#[derive(Debug, Clone, Copy)]
struct LastConnection {
    local: SocketAddr,
    peer: SocketAddr,
    tries: u32,
}

/// The last connections of this process, by address. Shared by all links, because local ports are shared by the whole
/// machine.
static CONNECTIONS: Mutex<BTreeMap<String, LastConnection>> = Mutex::new(BTreeMap::new());

fn connections() -> MutexGuard<'static, BTreeMap<String, LastConnection>> {
    CONNECTIONS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Connects to an address. After a lost connection every other attempt uses the local port of that connection, if
/// possible.
pub(crate) async fn connect(address: &str) -> io::Result<RecordedStream> {
    let lost = {
        let mut connections = connections();
        let lost = connections.get_mut(address);
        lost.and_then(|lost| {
            lost.tries += 1;
            // the first attempt uses any port: most instruments have closed their end, and some refuse a port for a
            // while after a clean close
            (lost.tries % 2 == 0).then_some(*lost)
        })
    };
    let stream = match lost {
        None => TcpStream::connect(address).await?,
        Some(lost) => match connect_from_same_port(lost).await {
            // the port is used by another socket, or still in TIME_WAIT
            Err(fault)
                if [
                    io::ErrorKind::AddrInUse,
                    io::ErrorKind::AddrNotAvailable,
                    io::ErrorKind::InvalidInput,
                ]
                .contains(&fault.kind()) =>
            {
                TcpStream::connect(address).await?
            }
            connected => connected?,
        },
    };
    Ok(RecordedStream {
        address: address.to_owned(),
        stream,
        is_recorded: false,
    })
}

async fn connect_from_same_port(lost: LastConnection) -> io::Result<TcpStream> {
    let socket = match lost.local {
        SocketAddr::V4(_) => TcpSocket::new_v4()?,
        SocketAddr::V6(_) => TcpSocket::new_v6()?,
    };
    socket.set_reuseaddr(true)?;
    socket.bind(lost.local)?;
    socket.connect(lost.peer).await
}

/// A connection that is recorded in [`CONNECTIONS`] when it receives its first data.
#[derive(Debug)]
pub(crate) struct RecordedStream {
    address: String,
    pub(crate) stream: TcpStream,
    is_recorded: bool,
}

impl RecordedStream {
    fn note(&mut self) {
        if let (Ok(local), Ok(peer)) = (self.stream.local_addr(), self.stream.peer_addr()) {
            let now = LastConnection {
                local,
                peer,
                tries: 0,
            };
            connections().insert(self.address.clone(), now);
        }
        self.is_recorded = true;
    }
}

impl AsyncRead for RecordedStream {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(context, buffer);
        if !self.is_recorded && buffer.filled().len() > before {
            self.note();
        }
        read
    }
}

impl AsyncWrite for RecordedStream {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
