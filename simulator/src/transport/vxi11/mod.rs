//! VXI-11: the core channel of the mainframe, over ONC RPC on a port of choice (no port mapper, no privilege).
//!
//! Version 1 of the core program with all its procedures but the interrupt channel and docmd, and the abort program on
//! the same port. A reply that is written over is lost (-410), a read without a question times out (-420). Records,
//! links and queues are bounded.

mod core_channel;
mod link;
mod port;
mod rpc;

pub use crate::transport::vxi11::core_channel::CoreChannel;
pub(crate) use crate::transport::vxi11::core_channel::serve;
