//! Options of `tactus-lab reconstruct`.

use std::path::PathBuf;

use clap::Args;
use outfile::OutPath;

use imaging::recorded::BaselineRule;
use imaging::{DepthArguments, TrackedArguments};
use studies::evaluation::MethodOptions;

use super::Replacing;

#[derive(Debug, Clone, Args)]
pub(crate) struct ReconstructOptions {
    /// Case folder, or a MAT-file of EIDORS with its model fmdl, its voltages vv and, of the baseline, v_homogeneous or vh
    #[arg(long, value_name = "DIR|FILE.mat")]
    pub(crate) case: PathBuf,
    #[command(flatten)]
    pub(crate) depth: DepthArguments,
    #[command(flatten)]
    pub(crate) method: MethodOptions,
    #[command(flatten)]
    pub(crate) tracked: TrackedArguments,
    /// Frames, a row or a column a frame; a bare name is looked for in the case folder first [default: frames.csv in the case
    /// folder, vv of a MAT-file]
    #[arg(long, value_name = "FILE")]
    pub(crate) frames: Option<PathBuf>,
    /// Baseline: a file (the mean of its frames) or first:N (the mean of the first N frames) [default: baseline.csv in the
    /// case folder, v_homogeneous or vh of a MAT-file, else the first frame]
    #[arg(long, value_name = "FILE|first:N")]
    pub(crate) baseline: Option<BaselineRule>,
    /// Negate all readings, for an instrument that returns magnitudes
    #[arg(long)]
    pub(crate) negate: bool,
    /// File for the maps: a row per frame of the file, a column per triangle of the region, without a header; NAME.frames.csv and
    /// NAME.triangles.csv next to it describe the rows and columns
    #[arg(long, value_name = "FILE")]
    pub(crate) out: OutPath,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// A calibration of this mesh and method, made by `calibrate`: maps in kPa, and each frame's load in newtons [default: none, relative loss]
    #[arg(long, value_name = "FILE")]
    pub(crate) calibration: Option<PathBuf>,
    /// Write the standard deviation of each triangle's change of ln conductance to NAME.sd.csv, nan for triangles that the frame
    /// does not determine; always from the linear model with noise and drift of the frame
    #[arg(long)]
    pub(crate) sd: bool,
    /// Print 'frame N ms', the median time, on standard error
    #[arg(long)]
    pub(crate) timing: bool,
    /// Print one JSON object per frame with the fields of `tactus replay --json`: frame, label, largest_loss, noise, found_mm and others; no_map says why a frame has no map
    #[arg(long)]
    pub(crate) json: bool,
}
