//! The server of a core channel: links, locks, and the order of messages and replies.
//! What an instrument does with a message is left to [`Device`] and [`Session`].

mod core_channel;
mod device;
mod link;
mod port;

pub use core_channel::CoreChannel;
pub use device::{Device, LineFramer, MessageFramer, Oversized, Refusal, Session};
