//! Connections whose far end does not know that ours is gone.
//!
//! A cable that is pulled for longer than TCP waits ends our end of a connection in silence; the instrument's end stays,
//! and where an instrument serves one client at a time that one keeps the place, some for good. Whoever connects from the
//! port of the lost connection is taken for it: the instrument's TCP asks what this is, ours answers that there is no such
//! connection, which ends it there, and the next try is let in (RFC 9293, section 3.5.1, figure 10).

use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpSocket, TcpStream};

/// The last connection to an address over which something was said, and how often one was asked for since.
#[derive(Debug, Clone, Copy)]
struct Answered {
    local: SocketAddr,
    peer: SocketAddr,
    tries: u32,
}

/// Of this process, by address: ports are the machine's.
static ANSWERED: Mutex<BTreeMap<String, Answered>> = Mutex::new(BTreeMap::new());

fn answered() -> MutexGuard<'static, BTreeMap<String, Answered>> {
    ANSWERED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Connects; every other time after a connection was lost from where that one was, if the machine lets us.
pub(crate) async fn connect(address: &str) -> io::Result<Noted> {
    let lost = {
        let mut answered = answered();
        let lost = answered.get_mut(address);
        lost.and_then(|lost| {
            lost.tries += 1;
            // first as ever: most instruments have noticed, and some refuse a port for a while after a clean end
            (lost.tries % 2 == 0).then_some(*lost)
        })
    };
    let stream = match lost {
        None => TcpStream::connect(address).await?,
        Some(lost) => match from_there(lost).await {
            // taken meanwhile, or still waiting for the end of a clean one
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
    Ok(Noted {
        address: address.to_owned(),
        stream,
        is_noted: false,
    })
}

async fn from_there(lost: Answered) -> io::Result<TcpStream> {
    let socket = match lost.local {
        SocketAddr::V4(_) => TcpSocket::new_v4()?,
        SocketAddr::V6(_) => TcpSocket::new_v6()?,
    };
    socket.set_reuseaddr(true)?;
    socket.bind(lost.local)?;
    socket.connect(lost.peer).await
}

/// A connection that is noted once something has come over it.
#[derive(Debug)]
pub(crate) struct Noted {
    address: String,
    pub(crate) stream: TcpStream,
    is_noted: bool,
}

impl Noted {
    fn note(&mut self) {
        if let (Ok(local), Ok(peer)) = (self.stream.local_addr(), self.stream.peer_addr()) {
            let now = Answered {
                local,
                peer,
                tries: 0,
            };
            answered().insert(self.address.clone(), now);
        }
        self.is_noted = true;
    }
}

impl AsyncRead for Noted {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(context, buffer);
        if !self.is_noted && buffer.filled().len() > before {
            self.note();
        }
        read
    }
}

impl AsyncWrite for Noted {
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
