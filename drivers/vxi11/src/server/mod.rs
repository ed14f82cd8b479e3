//! The server of a core channel: links, locks, and the order of messages and replies. The instrument's behaviour is
//! behind [`Device`] and [`Session`].

mod core_channel;
mod device;
mod link;
mod port;

pub use core_channel::CoreChannel;
pub use device::{Device, MessageFramer, Oversized, Refusal, Session};
