//! Options of `tactus-lab tradeoff` and `tactus-lab advise`.

use std::path::PathBuf;

use clap::Args;
use outfile::GrowingFolder;
use studies::tradeoff::PanelName;

use super::Replacing;

#[derive(Debug, Args)]
pub(crate) struct TradeoffOptions {
    /// Small meshes, few frames: shows that all of it works, not what it finds [default]
    #[arg(long, conflicts_with = "full")]
    pub(crate) quick: bool,
    /// The sizes whose results are kept; tens of minutes, and goes on where it was stopped
    #[arg(long)]
    pub(crate) full: bool,
    /// Only this diagram (repeatable)
    #[arg(long, value_enum, value_name = "NAME")]
    pub(crate) only: Vec<PanelName>,
    /// The same seed gives the same numbers, times apart
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Folder of the page, its figures and tables [default: tradeoff-quick or tradeoff-full]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<GrowingFolder>,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print every point as one JSON object a line
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct AdviseOptions {
    /// The location error that is enough, mm
    #[arg(long, value_name = "MM")]
    pub(crate) error_mm: f64,
    /// The longest frame that is short enough, s
    #[arg(long, value_name = "S")]
    pub(crate) max_seconds: f64,
    /// The configuration to start from: its electrodes and module are kept, and its current is not exceeded [default: config.toml
    /// here, else /etc/tactus/config.toml, where there is one]
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Only what this number of electrodes gives [default: the configuration's]
    #[arg(long, value_name = "N")]
    pub(crate) electrodes: Option<u64>,
    /// Only what this module gives, e.g. 34924A [default: the configuration's]
    #[arg(long, value_name = "NAME")]
    pub(crate) module: Option<String>,
    /// Only what this current gives, mA [default: at most the configuration's]
    #[arg(long, value_name = "MA")]
    pub(crate) current_ma: Option<f64>,
    /// A table that `tradeoff --only acquisition` made [default: the kept one]
    #[arg(long, value_name = "FILE")]
    pub(crate) table: Option<PathBuf>,
    /// Print the choice as one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}
