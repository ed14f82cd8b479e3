//! Options of work in shards.

use std::path::PathBuf;

use clap::Args;
use shards::{Shard, parse_count};

/// Shards of a training set.
#[derive(Debug, Args)]
pub(crate) struct DataSetShards {
    /// Make only shard I of N, I from 0 to N - 1 [default: 0/1, the whole set]
    #[arg(long, value_name = "I/N", conflicts_with_all = ["missing", "merge"])]
    pub(crate) shard: Option<Shard>,
    /// Make nothing: print the numbers of the N shards that are not complete, in the form of `sbatch --array`
    #[arg(long, value_name = "N", value_parser = parse_count, conflicts_with = "merge")]
    pub(crate) missing: Option<usize>,
    /// Make nothing: write the N complete shards of --parts as one file, equal to that of an undivided run
    #[arg(long, value_name = "N", value_parser = parse_count, requires = "parts")]
    pub(crate) merge: Option<usize>,
    /// Folder with the shards to merge
    #[arg(long, value_name = "DIR", requires = "merge")]
    pub(crate) parts: Option<PathBuf>,
}
