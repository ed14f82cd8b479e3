//! What the server needs of an instrument.

use std::io;

/// An instrument that clients reach through a core channel. Clones are handles of the same instrument.
pub trait Device: Clone + Send + Sync + 'static {
    /// What a link speaks with.
    type Session: Session;

    /// A client has created a link; `address` names it for people. The session ends when it is dropped.
    fn open_session(&self, address: &str) -> Self::Session;

    /// Waits until the instrument's connections are to be closed, from this call on; for ever if they never are.
    fn until_cut(&self) -> impl Future<Output = ()> + Send + 'static;
}

/// One client's session with an instrument.
pub trait Session: Send + Sync + 'static {
    /// Divides bytes into messages.
    type Framer: MessageFramer;
    /// A message that the instrument has received and whose reply is still to be waited for.
    type Received: Send;

    /// An empty framer.
    fn framer(&self) -> Self::Framer;

    /// Whether the instrument receives nothing and replies nothing for now.
    fn is_silent(&self) -> bool;

    /// Hands a message without its end to the instrument.
    ///
    /// # Errors
    /// The instrument can no longer answer; reads of the link then fail.
    fn begin(&self, message: Vec<u8>) -> impl Future<Output = io::Result<Self::Received>> + Send;

    /// Waits as long as the instrument needs and gives the bytes of its reply; none where it has no reply.
    fn finish(&self, received: Self::Received) -> impl Future<Output = Vec<u8>> + Send;

    /// Reports an error that arose outside of any message.
    fn refuse(&self, refusal: Refusal);

    /// A device clear: what the instrument does for this client ends.
    fn clear(&self) -> impl Future<Output = ()> + Send;

    /// The status byte of a serial poll; its bit 4 (message available) is set by the server.
    fn status_byte(&self) -> impl Future<Output = u8> + Send;
}

/// An error in the exchange of messages (IEEE 488.2, section 6.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// A message was too long.
    InputOverrun,
    /// A message came before the last reply was read; that reply is lost.
    QueryInterrupted,
    /// A reply was read and no message had asked for one.
    QueryUnterminated,
}

/// A message that was too long and was dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Oversized;

/// Divides a stream of bytes into messages.
pub trait MessageFramer: Send + Sync + 'static {
    /// Takes bytes in.
    fn push(&mut self, bytes: &[u8]);

    /// The next whole message, without its end; an error for one that was too long.
    fn next_message(&mut self) -> Option<Result<Vec<u8>, Oversized>>;

    /// Whether a message has begun and not ended.
    fn is_partial(&self) -> bool;

    /// Drops what was taken in.
    fn clear(&mut self);
}

/// Messages that end by a line feed: for devices whose messages need no more than that.
#[derive(Debug)]
pub struct LineFramer {
    bytes: Vec<u8>,
    longest: usize,
}

impl LineFramer {
    /// Takes messages of at most `longest` bytes.
    pub fn new(longest: usize) -> Self {
        Self {
            bytes: Vec::new(),
            longest,
        }
    }
}

impl MessageFramer for LineFramer {
    fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        // One byte more than the bound marks a message as too long; more need not be kept.
        let ended = self.bytes.iter().rposition(|byte| *byte == b'\n');
        let begun = ended.map_or(0, |end| end + 1);
        self.bytes
            .truncate(self.bytes.len().min(begun + self.longest + 1));
    }

    fn next_message(&mut self) -> Option<Result<Vec<u8>, Oversized>> {
        let end = self.bytes.iter().position(|byte| *byte == b'\n')?;
        let mut message: Vec<u8> = self.bytes.drain(..=end).collect();
        message.pop();
        Some(if message.len() > self.longest {
            Err(Oversized)
        } else {
            Ok(message)
        })
    }

    fn is_partial(&self) -> bool {
        self.bytes.last().is_some_and(|byte| *byte != b'\n')
    }

    fn clear(&mut self) {
        self.bytes.clear();
    }
}
