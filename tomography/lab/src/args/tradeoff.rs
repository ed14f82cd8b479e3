//! Options of `tactus-lab tradeoff` and `tactus-lab advise`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use outfile::GrowingFolder;

use super::Replacing;

/// One diagram of error against time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum PanelName {
    /// Voltages of a sheet against the size of the mesh
    Forward,
    /// Ways to solve the same system
    Solver,
    /// Methods that make maps
    Reconstruction,
    /// How the sheet is measured: millimetres against seconds
    Acquisition,
    /// Width and number format of a deep network
    Precision,
    /// Cases and epochs of a training
    Training,
    /// Stated against found coverage
    Uncertainty,
    /// What drift does to an old baseline
    Months,
}

impl PanelName {
    pub(crate) const ALL: [Self; 8] = [
        Self::Forward,
        Self::Solver,
        Self::Reconstruction,
        Self::Acquisition,
        Self::Precision,
        Self::Training,
        Self::Uncertainty,
        Self::Months,
    ];

    /// As on the command line, and as its files are called.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Forward => "forward",
            Self::Solver => "solver",
            Self::Reconstruction => "reconstruction",
            Self::Acquisition => "acquisition",
            Self::Precision => "precision",
            Self::Training => "training",
            Self::Uncertainty => "uncertainty",
            Self::Months => "months",
        }
    }
}

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
    /// Only what this number of electrodes gives
    #[arg(long, value_name = "N")]
    pub(crate) electrodes: Option<u64>,
    /// Only what this module gives, e.g. 34924A
    #[arg(long, value_name = "NAME")]
    pub(crate) module: Option<String>,
    /// Only what this current gives, mA
    #[arg(long, value_name = "MA")]
    pub(crate) current_ma: Option<f64>,
    /// A table that `tradeoff --only acquisition` made [default: the kept one]
    #[arg(long, value_name = "FILE")]
    pub(crate) table: Option<PathBuf>,
    /// Print the choice as one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}
