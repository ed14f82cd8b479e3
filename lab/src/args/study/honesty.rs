//! Options of `tactus-lab honesty`.

use clap::Args;
use outfile::OutFolder;
use studies::honesty::{MapMethod, TargetKind};

use crate::args::Replacing;

#[derive(Debug, Args)]
pub(crate) struct HonestyOptions {
    /// Number of healthy frames at each noise
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = crate::args::numbers::ANY_COUNT.counter())]
    pub(crate) count: usize,
    /// Number of frames of each fault at each noise
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = crate::args::numbers::ANY_COUNT.counter())]
    pub(crate) faults: usize,
    /// Also compare maps with the truth: number of frames of each kind of load at each noise [default: none]
    #[arg(long, value_name = "N", value_parser = crate::args::numbers::CASES.counter())]
    pub(crate) maps: Option<usize>,
    /// Kinds of load whose maps are compared (repeatable) [default: all]
    #[arg(long, value_enum, value_name = "LOAD", requires = "maps")]
    pub(crate) load: Vec<TargetKind>,
    /// Methods whose maps are compared (repeatable) [default: all]
    #[arg(long, value_enum, value_name = "METHOD", requires = "maps")]
    pub(crate) method: Vec<MapMethod>,
    /// Also compare maps made without a given noise, and with a hyper-parameter from the noise alone
    #[arg(long, requires = "maps")]
    pub(crate) unstated: bool,
    /// Noise of one reading (standard deviation), uV (repeatable) [default: 2 and 20]
    #[arg(long, value_name = "UV", value_parser = crate::args::numbers::NOISE_UV.parser(), allow_hyphen_values = true)]
    pub(crate) noise_uv: Vec<f64>,
    /// Seed of loads and noise
    #[arg(long, value_name = "N", default_value_t = 19)]
    pub(crate) seed: u64,
    /// Write the tables (honesty.txt, honesty.json)
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<OutFolder>,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print one JSON object per row
    #[arg(long)]
    pub(crate) json: bool,
}
