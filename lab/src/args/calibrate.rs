//! Options of `tactus-lab calibrate`.

use std::path::PathBuf;

use clap::Args;
use imaging::recorded::BaselineRule;
use outfile::OutPath;

use super::Replacing;

#[derive(Debug, Args)]
pub(crate) struct CalibrateOptions {
    /// Case folder, with frames.csv (the baseline first, unless it has baseline.csv) and presses.csv in it; or a MAT-file of EIDORS,
    /// as for `reconstruct`, with presses.csv next to it
    #[arg(long, value_name = "DIR|FILE.mat")]
    pub(crate) case: PathBuf,
    /// Frames [default: frames.csv in the case folder]
    #[arg(long, value_name = "FILE")]
    pub(crate) frames: Option<PathBuf>,
    /// Presses, a line each: frame (1 is the file's first; of an exported session, the session's number), x_m, y_m, diameter_m, mass_kg [default: presses.csv in the case
    /// folder]
    #[arg(long, value_name = "FILE")]
    pub(crate) presses: Option<PathBuf>,
    /// Method to calibrate, with its options; "model FILE" for a trained model
    #[arg(long, value_name = "TEXT", default_value = "one-step --loss-only")]
    pub(crate) method: String,
    /// White noise of one reading, V [default: as in `reconstruct`]
    #[arg(long, value_name = "SD")]
    pub(crate) noise_v: Option<f64>,
    /// Baseline: a file or first:N [default: baseline.csv in the case folder, else the first frame]
    #[arg(long, value_name = "FILE|first:N")]
    pub(crate) baseline: Option<BaselineRule>,
    /// File to write
    #[arg(long, value_name = "FILE")]
    pub(crate) out: OutPath,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print the result as one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}
