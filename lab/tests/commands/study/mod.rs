//! Studies, and their division into shards.

mod division;
mod paper;
mod shards;
mod stability;
mod tradeoff;
