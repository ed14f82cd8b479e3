//! Options of `tactus-lab paper`.

use std::path::PathBuf;

use clap::Args;
use outfile::GrowingFolder;

use super::shards::StudyShards;
use crate::args::Replacing;

#[derive(Debug, Args)]
pub(crate) struct PaperOptions {
    /// Small networks and few frames, about a minute: a test that everything runs; the results are not accurate [default]
    #[arg(long, conflicts_with = "full")]
    pub(crate) quick: bool,
    /// The paper's sizes: 75,000 samples (15,000 cases, five copies of each), 30 epochs; takes hours, an interrupted run is continued
    #[arg(long)]
    pub(crate) full: bool,
    /// Only this figure N of the paper: 3 to 7 [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(3..=7))]
    pub(crate) figure: Option<u8>,
    /// Random seed; only times differ between runs
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Folder for the page, its figures and tables, the same for all shards [default: paper-quick or paper-full]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<GrowingFolder>,
    #[command(flatten)]
    pub(crate) shards: StudyShards,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print the table of claims, one JSON object per line
    #[arg(long)]
    pub(crate) json: bool,
    /// Only print by how many bytes the process grows when it loads this model; used for the table of claims
    #[arg(long, value_name = "MODEL", hide = true)]
    pub(crate) resident: Option<PathBuf>,
}
