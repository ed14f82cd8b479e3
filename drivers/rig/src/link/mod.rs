//! The link: all waiting for an instrument's I/O.
//!
//! A message is sent in one segment; its reply is one line. Any other outcome (a timeout, a second line, a dropped
//! future) leaves the link *unsynchronised*: all further messages are refused until the peer has echoed two numbers just
//! sent to it ([`Link::resynchronise`]); otherwise a new connection needs a new link. Therefore a late reply can never be
//! taken for the next one.

mod error;
pub(crate) mod half_open;
mod synchronised;

use std::pin::Pin;
use std::task::Poll;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::time::Instant;

pub use error::LinkError;
use error::shorten;

use crate::RingTranscript;
use crate::transcript::EntryContent;

/// Default limit of a reply, bytes: 2,600 readings with all their fields; see [`Link::with_longest_reply`].
const LONGEST_REPLY: usize = 256 * 1024;

/// A byte stream to an instrument: TCP, a serial line, a pipe in memory.
pub trait Stream: AsyncRead + AsyncWrite + Unpin + Send {}

impl<S: AsyncRead + AsyncWrite + Unpin + Send + ?Sized> Stream for S {}

/// A stream of any kind.
pub type BoxStream = Box<dyn Stream>;

/// Whether the next line from the peer is certain to be the next reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Synchronised,
    /// An exchange failed; the peer may have received part of a message.
    Unsynchronised,
}

/// A line-oriented connection to one instrument.
#[derive(Debug)]
pub struct Link<S> {
    stream: S,
    instrument: String,
    deadline: Duration,
    longest_reply: usize,
    received: Vec<u8>,
    state: State,
    nonce: u8,
    /// Numbers that failed attempts to resynchronise may have left in the peer's event enable register.
    nonces: Vec<u8>,
    /// The register's value before the first attempt, once known.
    enable: Option<u8>,
    transcript: Option<RingTranscript>,
}

impl<S: AsyncRead + AsyncWrite + Unpin + Send> Link<S> {
    /// A synchronised link over a new stream. `instrument` is a name for messages, with its address (`source
    /// at 10.0.0.7:1394`); `deadline` is the default timeout of a reply.
    pub fn new(stream: S, instrument: impl Into<String>, deadline: Duration) -> Self {
        Self {
            stream,
            instrument: instrument.into(),
            deadline,
            longest_reply: LONGEST_REPLY,
            received: Vec::new(),
            state: State::Synchronised,
            nonce: 0,
            nonces: Vec::new(),
            enable: None,
            transcript: None,
        }
    }

    /// Writes every line to a transcript.
    #[must_use]
    pub fn with_transcript(mut self, transcript: RingTranscript) -> Self {
        self.transcript = Some(transcript);
        self
    }

    /// Bounds replies to this many bytes, line end included.
    #[must_use]
    pub fn with_longest_reply(mut self, bytes: usize) -> Self {
        self.longest_reply = bytes;
        self
    }

    /// Name and address for messages.
    pub fn instrument(&self) -> &str {
        &self.instrument
    }

    /// Default timeout of a reply.
    pub fn deadline(&self) -> Duration {
        self.deadline
    }

    /// Whether queries are possible; `false` after a fault until [`Link::resynchronise`].
    pub fn is_synchronised(&self) -> bool {
        self.state == State::Synchronised
    }

    /// Sends a message that has no reply, in one segment.
    ///
    /// # Errors
    /// An unsynchronised link, bytes received without a query, a line end in the message, a lost connection, or the
    /// timeout.
    pub async fn send(&mut self, message: &str) -> Result<(), LinkError> {
        let until = Instant::now() + self.deadline;
        self.begin(message).await?;
        self.write(message, self.deadline, until).await?;
        self.state = State::Synchronised;
        Ok(())
    }

    /// Sends a query and waits for its reply, returned without line end.
    ///
    /// # Errors
    /// As [`Link::send`]; a reply that is too long or is not text; [`LinkError::Unsolicited`] if a second line follows
    /// the reply, because then neither can be trusted.
    pub async fn ask(&mut self, message: &str) -> Result<String, LinkError> {
        self.ask_within(message, self.deadline).await
    }

    /// Like [`Link::ask`] with an individual timeout, such as for a scan.
    ///
    /// # Errors
    /// As [`Link::ask`].
    pub async fn ask_within(
        &mut self,
        message: &str,
        deadline: Duration,
    ) -> Result<String, LinkError> {
        let until = Instant::now() + deadline;
        self.begin(message).await?;
        self.write(message, deadline, until).await?;
        let answer = self.line(message, deadline, until).await?;
        // With two lines neither can be trusted: the first may be a late reply to an earlier query.
        self.confirm_synchronised(message).await?;
        Ok(answer)
    }

    /// Fails if the link is unsynchronised, and marks it unsynchronised until the exchange has succeeded. A future that
    /// is dropped during the exchange therefore leaves it unsynchronised.
    async fn begin(&mut self, message: &str) -> Result<(), LinkError> {
        if message.contains(['\n', '\r']) {
            return Err(LinkError::LineEnd {
                instrument: self.instrument.clone(),
                message: shorten(message),
            });
        }
        if self.state != State::Synchronised {
            return Err(LinkError::Unsynchronised {
                instrument: self.instrument.clone(),
            });
        }
        self.state = State::Unsynchronised;
        let closed = self.read_available(message).await?;
        if !self.received.is_empty() {
            return Err(self.unsolicited());
        }
        if closed {
            return Err(self.lost(message, None));
        }
        Ok(())
    }

    async fn write(
        &mut self,
        message: &str,
        deadline: Duration,
        until: Instant,
    ) -> Result<(), LinkError> {
        self.note(|| EntryContent::Sent(message.to_owned()));
        let mut segment = Vec::with_capacity(message.len() + 1);
        segment.extend_from_slice(message.as_bytes());
        segment.push(b'\n');
        let written = tokio::time::timeout_at(until, async {
            self.stream.write_all(&segment).await?;
            self.stream.flush().await
        })
        .await;
        match written {
            Ok(Ok(())) => Ok(()),
            Ok(Err(cause)) => Err(self.lost(message, Some(cause))),
            Err(_) => Err(self.timed_out(message, deadline)),
        }
    }

    async fn line(
        &mut self,
        message: &str,
        deadline: Duration,
        until: Instant,
    ) -> Result<String, LinkError> {
        loop {
            if let Some(end) = self.received.iter().position(|byte| *byte == b'\n') {
                let mut line: Vec<u8> = self.received.drain(..=end).collect();
                line.pop();
                if line.last() == Some(&b'\r') {
                    line.pop();
                }
                self.note(|| EntryContent::Received(String::from_utf8_lossy(&line).into_owned()));
                return String::from_utf8(line).map_err(|_| LinkError::NotText {
                    instrument: self.instrument.clone(),
                    message: shorten(message),
                });
            }
            if self.received.len() >= self.longest_reply {
                return Err(LinkError::TooLong {
                    instrument: self.instrument.clone(),
                    message: shorten(message),
                    most: self.longest_reply,
                });
            }
            let free = (self.longest_reply - self.received.len()).min(16 * 1024);
            let mut chunk = (&mut self.stream).take(free as u64);
            match tokio::time::timeout_at(until, chunk.read_buf(&mut self.received)).await {
                Ok(Ok(0)) => return Err(self.lost(message, None)),
                Ok(Ok(_)) => {}
                Ok(Err(cause)) => return Err(self.lost(message, Some(cause))),
                Err(_) => return Err(self.timed_out(message, deadline)),
            }
        }
    }

    /// Reads what has been received already, without waiting; returns whether the peer has closed after it.
    async fn read_available(&mut self, message: &str) -> Result<bool, LinkError> {
        // The yield lets the runtime poll its sockets; `unconstrained` keeps the cooperative budget of tokio from
        // hiding received bytes.
        tokio::task::yield_now().await;
        let mut chunk = [0; 512];
        while self.received.len() < self.longest_reply {
            let mut buffer = ReadBuf::new(&mut chunk);
            let stream = &mut self.stream;
            let polled = tokio::task::unconstrained(std::future::poll_fn(|context| {
                Poll::Ready(Pin::new(&mut *stream).poll_read(context, &mut buffer))
            }))
            .await;
            match polled {
                Poll::Pending => return Ok(false),
                Poll::Ready(Err(cause)) => return Err(self.lost(message, Some(cause))),
                Poll::Ready(Ok(())) if buffer.filled().is_empty() => return Ok(true),
                Poll::Ready(Ok(())) => self.received.extend_from_slice(buffer.filled()),
            }
        }
        Ok(false)
    }

    fn unsolicited(&mut self) -> LinkError {
        let text = String::from_utf8_lossy(&self.received).trim().to_owned();
        self.received.clear();
        self.note(|| EntryContent::Note(format!("received without a query: {text}")));
        LinkError::Unsolicited {
            instrument: self.instrument.clone(),
            text: shorten(&text),
        }
    }

    fn note(&self, content: impl FnOnce() -> EntryContent) {
        if let Some(transcript) = &self.transcript {
            transcript.write(&self.instrument, content());
        }
    }

    fn lost(&self, message: &str, cause: Option<std::io::Error>) -> LinkError {
        self.note(|| match &cause {
            Some(cause) => EntryContent::Note(format!("the connection was lost: {cause}")),
            None => EntryContent::Note("the connection was closed by the instrument".to_owned()),
        });
        LinkError::Lost {
            instrument: self.instrument.clone(),
            message: shorten(message),
            cause,
        }
    }

    fn timed_out(&self, message: &str, deadline: Duration) -> LinkError {
        self.note(|| {
            let half = String::from_utf8_lossy(&self.received);
            EntryContent::Note(match half.as_ref() {
                "" => format!("no answer within {deadline:?}"),
                half => format!("no end of the line within {deadline:?}: {half}"),
            })
        });
        LinkError::Timeout {
            instrument: self.instrument.clone(),
            message: shorten(message),
            deadline,
        }
    }
}
