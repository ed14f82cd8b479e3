//! Options of `tactus-lab tradeoff` and `tactus-lab advise`.

use std::path::PathBuf;

use clap::Args;
use outfile::GrowingFolder;
use studies::tradeoff::PanelName;

use super::shards::StudyShards;
use crate::args::Replacing;

#[derive(Debug, Args)]
pub(crate) struct TradeoffOptions {
    /// Small meshes and few frames: a test that everything runs; the results are not accurate [default]
    #[arg(long, conflicts_with = "full")]
    pub(crate) quick: bool,
    /// The sizes of the kept results; takes about 90 minutes on two cores, an interrupted run is continued
    #[arg(long)]
    pub(crate) full: bool,
    /// Only this diagram (repeatable) [default: all]
    #[arg(long, value_enum, value_name = "NAME")]
    pub(crate) only: Vec<PanelName>,
    /// Random seed; only times differ between runs
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Folder for the page, its figures and tables, the same for all shards [default: tradeoff-quick or tradeoff-full]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<GrowingFolder>,
    #[command(flatten)]
    pub(crate) shards: StudyShards,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print every point, one JSON object per line
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct AdviseOptions {
    /// Largest acceptable location error, mm
    #[arg(long, value_name = "MM")]
    pub(crate) error_mm: f64,
    /// Longest acceptable frame time, s
    #[arg(long, value_name = "S")]
    pub(crate) max_seconds: f64,
    /// The configuration to start from: its electrodes and module are kept, and its current is not exceeded [default: config.toml
    /// in the current directory, else /etc/tactus/config.toml, if it exists]
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Only settings with this number of electrodes [default: the configuration's]
    #[arg(long, value_name = "N")]
    pub(crate) electrodes: Option<u64>,
    /// Only settings with this module, e.g. 34924A [default: the configuration's]
    #[arg(long, value_name = "NAME")]
    pub(crate) module: Option<String>,
    /// Only settings with this current, mA [default: at most the configuration's]
    #[arg(long, value_name = "MA")]
    pub(crate) current_ma: Option<f64>,
    /// Table made by `tradeoff --only acquisition` [default: the kept one]
    #[arg(long, value_name = "FILE")]
    pub(crate) table: Option<PathBuf>,
    /// Print the choice as one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}
