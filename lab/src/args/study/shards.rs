//! Options of work in shards.

use std::path::PathBuf;

use clap::{ArgGroup, Args};
use outfile::GrowingFolder;
use shards::{Division, Shard, parse_count};

/// Shards of a training set.
#[derive(Debug, Args)]
pub(crate) struct DataSetShards {
    /// Make only shard I of N, I from 0 to N - 1 [default: 0/1, the whole set]
    #[arg(long, value_name = "I/N", conflicts_with_all = ["missing", "merge"])]
    pub(crate) shard: Option<Shard>,
    /// Print the numbers of the N shards that are not complete, in the form of `sbatch --array` [default: make a shard]
    #[arg(long, value_name = "N", value_parser = parse_count, conflicts_with = "merge")]
    pub(crate) missing: Option<usize>,
    /// Write the N complete shards of --parts as one file, equal to that of an undivided run [default: make a shard]
    #[arg(long, value_name = "N", value_parser = parse_count, requires = "parts")]
    pub(crate) merge: Option<usize>,
    /// Folder with the shards to merge
    #[arg(long, value_name = "DIR", requires = "merge")]
    pub(crate) parts: Option<PathBuf>,
}

/// Shards of a study.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("share").args(["shard", "missing", "merge"]))]
pub(crate) struct StudyShards {
    /// Compute only shard I of N, I from 0 to N - 1, into the folder of --parts
    #[arg(long, value_name = "I/N", requires = "parts")]
    shard: Option<Shard>,
    /// Print the numbers of the N shards that are not complete, in the form of `sbatch --array` [default: compute]
    #[arg(long, value_name = "N", value_parser = parse_count, requires = "parts")]
    missing: Option<usize>,
    /// Merge the N complete shards in the folder of --parts to the result of an undivided run [default: compute]
    #[arg(long, value_name = "N", value_parser = parse_count, requires = "parts")]
    merge: Option<usize>,
    /// Folder of the shards
    #[arg(long, value_name = "DIR", requires = "share")]
    parts: Option<GrowingFolder>,
}

impl StudyShards {
    /// What is done of the study.
    pub(crate) fn division(&self) -> Division {
        let Some(folder) = self.parts.as_ref().map(|folder| folder.to_path_buf()) else {
            return Division::Whole;
        };
        match (self.shard, self.missing, self.merge) {
            (Some(shard), ..) => Division::Shard(shard, folder),
            (_, Some(of), _) => Division::Missing(of, folder),
            (.., Some(of)) => Division::Merge(of, folder),
            (None, None, None) => Division::Whole,
        }
    }
}
