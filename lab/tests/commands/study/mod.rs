//! Studies, and work in shards.

mod division;
mod paper;
mod shards;
mod stability;
mod tradeoff;
