//! Studies, and work in shards.

mod paper;
mod shards;
mod stability;
mod tradeoff;
