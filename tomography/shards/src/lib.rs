//! Work that is divided into shards, so that the scheduler of a cluster can start each of them on any machine, in any
//! order, more than once.
//!
//! [`Shard`] names a part of the work. [`PartFile`] is a shard's incomplete file, which one process at a time may write.
//! [`Study`] computes a list of independent items, one line of JSON each, continues what was interrupted and reads the
//! complete parts again, to the same bits. [`StopRequest`] is SIGTERM. What an item is, and what is made of all items, is
//! left to the callers.

mod error;
mod exact;
mod part;
mod shard;
mod stop;
mod study;

pub use error::{ShardError, difference};
pub use exact::any_f64;
pub use part::{PartFile, wait_for};
pub use shard::{Shard, missing_list, parse_count};
pub use stop::StopRequest;
pub use study::{Division, Made, Outcome, Study};
