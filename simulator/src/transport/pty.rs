//! A pseudo-terminal: the serial port of the simulated board.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_serial::{SerialPort, SerialStream};

/// The board's end of a pseudo-terminal; the other end has a path.
#[derive(Debug)]
pub(crate) struct Pty {
    board: SerialStream,
    /// The clients' end, kept open so that the port survives a client that disconnects.
    client: SerialStream,
    path: String,
}

impl Pty {
    /// Opens a raw pseudo-terminal: no echo, no line discipline. Requires a tokio runtime.
    pub(crate) fn open() -> io::Result<Self> {
        let (board, client) = SerialStream::pair()?;
        let path = client
            .name()
            .ok_or_else(|| io::Error::other("the pseudo-terminal has no path"))?;
        Ok(Self {
            board,
            client,
            path,
        })
    }

    /// Path for clients.
    pub(crate) fn path(&self) -> &str {
        &self.path
    }
}

impl AsyncRead for Pty {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        ready!(Pin::new(&mut self.board).poll_read(context, buffer))?;
        // A client's exclusive claim would exclude the next one even after it has disconnected, because our end stays
        // open.
        self.client.set_exclusive(false).ok();
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Pty {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.board).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.board).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.board).poll_shutdown(context)
    }
}
