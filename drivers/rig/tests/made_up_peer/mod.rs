//! Included by path in the fuzz targets of the drivers: a peer whose replies come from a fuzzer, and a runtime whose
//! clock jumps to the next deadline.

use std::collections::VecDeque;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::runtime::{Builder, Runtime};

/// A peer that replies to every message with the next line of the fuzzer's data, and disconnects after the last.
pub struct Peer {
    lines: VecDeque<Vec<u8>>,
    ready: VecDeque<u8>,
}

impl Peer {
    /// Begins with these replies if the first byte is odd, so that states after a valid start are reached, too.
    pub fn new(start: &[&str], bytes: &[u8]) -> Self {
        let sound = bytes.first().is_some_and(|first| first % 2 == 1);
        let start = start
            .iter()
            .filter(|_| sound)
            .map(|line| line.as_bytes().to_vec());
        let made_up = bytes.get(1..).unwrap_or_default();
        let made_up = made_up
            .split_inclusive(|byte| *byte == b'\n')
            .map(<[u8]>::to_vec);
        Self {
            lines: start.chain(made_up).collect(),
            ready: VecDeque::new(),
        }
    }
}

impl AsyncRead for Peer {
    fn poll_read(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.ready.is_empty() && !self.lines.is_empty() {
            return Poll::Pending;
        }
        while buffer.remaining() > 0 {
            let Some(byte) = self.ready.pop_front() else {
                break;
            };
            buffer.put_slice(&[byte]);
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Peer {
    fn poll_write(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        // a line that begins with a low byte is sent together with the next one: a duplicated reply
        while let Some(line) = self.lines.pop_front() {
            let more = line.first().is_some_and(|first| *first == 2);
            self.ready.extend(line);
            if !more {
                break;
            }
        }
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

fn runtime() -> Runtime {
    Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .expect("a runtime needs no more than memory")
}

thread_local! {
    /// One runtime for all inputs of a thread.
    pub static RUNTIME: Runtime = runtime();
}
