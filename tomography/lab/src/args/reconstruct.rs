//! Options of `tactus-lab reconstruct`.

use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;
use outfile::OutPath;

use super::{Method, Replacing};

/// How lambda is chosen where nobody says the noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Choose {
    /// The one that makes the frames most probable, doubled.
    Evidence,
    /// At the corner of the frames' L-curve.
    LCurve,
    /// The one with this noise figure.
    NoiseFigure(f64),
}

impl FromStr for Choose {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let figure = text.strip_prefix("noise-figure:");
        match (text, figure.map(str::parse::<f64>)) {
            ("evidence", _) => Ok(Self::Evidence),
            ("l-curve", _) => Ok(Self::LCurve),
            (_, Some(Ok(figure))) if figure > 0.0 && figure.is_finite() => {
                Ok(Self::NoiseFigure(figure))
            }
            _ => Err(
                "evidence, l-curve or noise-figure:X with a number above 0 is expected".to_owned(),
            ),
        }
    }
}

#[derive(Debug, Clone, Args)]
pub(crate) struct ReconstructOptions {
    /// Case folder
    #[arg(long, value_name = "DIR")]
    pub(crate) case: PathBuf,
    /// Method
    #[arg(long, value_enum, default_value_t = Method::Best, conflicts_with = "model")]
    pub(crate) method: Method,
    /// Model file in place of a method
    #[arg(long, value_name = "FILE")]
    pub(crate) model: Option<PathBuf>,
    /// Prior of the one-step method: tikhonov, noser (p = 0.5), noser:P, laplace, gaussian (10 mm), gaussian:MM
    /// [default: noser:0.25]
    #[arg(long, value_name = "P")]
    pub(crate) prior: Option<String>,
    /// White noise of one reading, V
    #[arg(long, value_name = "SD", conflicts_with = "lambda")]
    pub(crate) noise_v: Option<f64>,
    /// Hyper-parameter: lambda of the one-step method, alpha of total variation (readings as they are, V)
    #[arg(long, value_name = "X")]
    pub(crate) lambda: Option<f64>,
    /// How the one-step method's lambda is chosen where neither --noise-v nor --lambda is given: evidence (the most probable
    /// one for the frames, doubled), l-curve (the corner of the frames' own), noise-figure:X [default: evidence]
    #[arg(long, value_name = "RULE", conflicts_with_all = ["lambda", "noise_v"])]
    pub(crate) choose: Option<Choose>,
    /// One-step: make frames quicker where a map is proved to be within this share of its largest value, e.g. 1e-3
    #[arg(long, value_name = "X", conflicts_with = "loss_only")]
    pub(crate) map_error: Option<f64>,
    /// Total variation: stop within this share of the minimum [default: 1e-3]
    #[arg(long, value_name = "X")]
    pub(crate) gap: Option<f64>,
    /// Bound the map to losses, -1 <= x <= 0: one-step and tv find the best map within the bounds, maps of trained networks and
    /// of the linear matrix are cut
    #[arg(long)]
    pub(crate) loss_only: bool,
    /// Unloaded conductance: a name in the case or a file [default: homog if there is one, else fitted to the baseline]
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) sigma0: Option<String>,
    /// Frames: a row or a column a frame
    #[arg(long, value_name = "FILE")]
    pub(crate) frames: PathBuf,
    /// Baseline: a file (the mean of its frames) or first:N (the mean of the first N frames)
    #[arg(long, value_name = "FILE|first:N", default_value = "first:1")]
    pub(crate) baseline: String,
    /// Negate all readings: the instrument gives magnitudes
    #[arg(long)]
    pub(crate) negate: bool,
    /// Simulated cases where a network is trained for the case
    #[arg(long, value_name = "N", default_value_t = 15_000)]
    pub(crate) cases: usize,
    /// Maps: a row for each frame of the file, a column a triangle of the region
    #[arg(long, value_name = "FILE")]
    pub(crate) out: OutPath,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// A calibration of this mesh and method, made by `calibrate`: maps in kPa, and each frame's load in newtons
    #[arg(long, value_name = "FILE")]
    pub(crate) calibration: Option<PathBuf>,
    /// Print 'frame N ms', the median, on standard error
    #[arg(long)]
    pub(crate) timing: bool,
    /// Print one JSON object a frame: frame, largest_loss, found_m, masked; with a calibration newtons and largest_kpa
    #[arg(long)]
    pub(crate) json: bool,
}
