//! Options of `tactus-lab paper`.

use std::path::PathBuf;

use clap::Args;
use outfile::GrowingFolder;

use super::Replacing;

#[derive(Debug, Args)]
pub(crate) struct PaperOptions {
    /// Small networks and few frames, in about a minute: shows that all of it works, not what it finds [default]
    #[arg(long, conflicts_with = "full")]
    pub(crate) quick: bool,
    /// The paper's own sizes: 75,000 cases, 30 epochs; hours, and goes on where it was stopped
    #[arg(long)]
    pub(crate) full: bool,
    /// Only this figure of the paper: 3 to 7
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(3..=7))]
    pub(crate) figure: Option<u8>,
    /// The same seed gives the same numbers, times apart
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Folder of the page, its figures and tables [default: paper-quick or paper-full]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<GrowingFolder>,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print the table of claims as one JSON object a line
    #[arg(long)]
    pub(crate) json: bool,
    /// Only print by how many bytes loading this model makes a process larger; what the table of claims asks
    #[arg(long, value_name = "MODEL", hide = true)]
    pub(crate) resident: Option<PathBuf>,
}
