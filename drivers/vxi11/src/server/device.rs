//! The interface that the server requires of an instrument.

use std::io;

/// An instrument that clients reach through a core channel. Clones are handles of the same instrument.
pub trait Device: Clone + Send + Sync + 'static {
    /// The session that serves one link.
    type Session: Session;

    /// Called when a client has created a link; `address` is the client's address for messages. The session ends when
    /// it is dropped.
    fn open_session(&self, address: &str) -> Self::Session;

    /// Completes when the instrument's connections are to be closed; never completes if they stay open.
    fn until_cut(&self) -> impl Future<Output = ()> + Send + 'static;
}

/// One client's session with an instrument.
pub trait Session: Send + Sync + 'static {
    /// Divides bytes into messages.
    type Framer: MessageFramer;
    /// A message that the instrument has received and whose reply is still pending.
    type Received: Send;

    /// An empty framer.
    fn framer(&self) -> Self::Framer;

    /// Whether the instrument currently ignores messages and sends no replies.
    fn is_silent(&self) -> bool;

    /// Passes a message (without its terminator) to the instrument.
    ///
    /// # Errors
    /// The instrument can no longer reply; reads of the link then fail.
    fn begin(&self, message: Vec<u8>) -> impl Future<Output = io::Result<Self::Received>> + Send;

    /// Waits until the instrument has finished the message and returns the bytes of its reply; empty if it has no
    /// reply.
    fn finish(&self, received: Self::Received) -> impl Future<Output = Vec<u8>> + Send;

    /// Reports an error that occurred outside any message.
    fn refuse(&self, refusal: Refusal);

    /// A device clear: aborts the instrument's pending operations for this client.
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
    /// A reply was read although no message contained a query.
    QueryUnterminated,
}

/// A message that was too long and was dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Oversized;

/// Divides a stream of bytes into messages.
pub trait MessageFramer: Send + Sync + 'static {
    /// Adds received bytes.
    fn push(&mut self, bytes: &[u8]);

    /// The next complete message, without its terminator; an error for one that was too long.
    fn next_message(&mut self) -> Option<Result<Vec<u8>, Oversized>>;

    /// Whether an unfinished message is buffered.
    fn is_partial(&self) -> bool;

    /// Drops all buffered bytes.
    fn clear(&mut self);
}
