//! Options of `tactus-lab stability`.

use clap::Args;
use outfile::OutFolder;

use super::shards::StudyShards;
use crate::args::Replacing;

#[derive(Debug, Args)]
pub(crate) struct StabilityOptions {
    /// Only this hard case N, 1 to 40 (repeatable) [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=40))]
    pub(crate) only: Vec<u8>,
    /// Write the table (table.txt, table.json) and the plots of contrast, contact impedance and sliver angle (PNG, SVG)
    #[arg(long, value_name = "DIR", conflicts_with_all = ["shard", "missing"])]
    pub(crate) out: Option<OutFolder>,
    #[command(flatten)]
    pub(crate) shards: StudyShards,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print one JSON object per line of the table
    #[arg(long)]
    pub(crate) json: bool,
}
