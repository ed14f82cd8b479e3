//! Work divided into shards, each of which the scheduler of a cluster can start on any machine, in any order, more than
//! once.
//!
//! [`Shard`] identifies a part of the work. [`PartFile`] is a shard's incomplete file, which one process at a time may
//! write. [`Study`] computes a list of independent items, one line of JSON each, continues interrupted shards, and
//! reads complete shards back bit for bit. [`StopRequest`] is set by SIGTERM. The callers define the items and the
//! report on all items.

mod error;
mod exact;
mod part;
mod shard;
mod stop;
mod study;

pub use error::{ShardError, difference};
pub use exact::{any_f64, decode, encode};
pub use part::{PartFile, wait_for};
pub use shard::{Shard, missing_list, parse_count};
pub use stop::StopRequest;
pub use study::{Division, Made, Outcome, Study};
