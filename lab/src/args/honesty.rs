//! Options of `tactus-lab honesty`.

use clap::Args;
use outfile::OutFolder;

use super::Replacing;

#[derive(Debug, Args)]
pub(crate) struct HonestyOptions {
    /// Number of healthy frames at each noise
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = super::numbers::cases)]
    pub(crate) count: usize,
    /// Number of frames of each fault at each noise
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = super::numbers::cases)]
    pub(crate) faults: usize,
    /// Noise of one reading (standard deviation), uV (repeatable) [default: 2 and 20]
    #[arg(long, value_name = "UV", value_parser = super::numbers::noise_uv, allow_hyphen_values = true)]
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
