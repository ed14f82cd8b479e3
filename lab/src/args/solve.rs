//! Options of `sheet`, `forward`, `jacobian` and `transfer`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use imaging::recorded::BaselineRule;
use outfile::{OutFolder, OutPath};

use super::Replacing;

#[derive(Debug, Args)]
pub(crate) struct SheetOptions {
    /// Case folder of the nominal sheet, with frames.csv (the baseline first, unless it has baseline.csv); or a MAT-file of EIDORS,
    /// as for `reconstruct`
    #[arg(long, value_name = "DIR|FILE.mat")]
    pub(crate) case: PathBuf,
    /// Frames [default: frames.csv in the case folder]
    #[arg(long, value_name = "FILE", conflicts_with = "session")]
    pub(crate) frames: Option<PathBuf>,
    /// Take the baseline of this session file
    #[arg(long, value_name = "FILE")]
    pub(crate) session: Option<PathBuf>,
    /// Baseline: a file or first:N [default: baseline.csv in the case folder, else the first frame; of a session its own]
    #[arg(long, value_name = "FILE|first:N")]
    pub(crate) baseline: Option<BaselineRule>,
    /// Case folder to write, new or empty
    #[arg(long, value_name = "DIR")]
    pub(crate) out: OutFolder,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct ForwardOptions {
    /// Case folder
    #[arg(long, value_name = "DIR")]
    pub(crate) case: PathBuf,
    /// Conductance: a name in the case (sigma_NAME.csv) or a file (repeatable)
    #[arg(long, value_name = "NAME|FILE", required_unless_present = "sigma_rows")]
    pub(crate) sigma: Vec<String>,
    /// Conductances in one file: one row each, one column per triangle
    #[arg(long, value_name = "FILE", conflicts_with_all = ["sigma", "potentials"])]
    pub(crate) sigma_rows: Option<PathBuf>,
    /// File for the readings, V, with 17 digits: one per line; for several conductances one row each
    #[arg(long, value_name = "FILE")]
    pub(crate) out: OutPath,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// File for the electrode voltages, one row per drive, with zero mean over the electrodes (one conductance only)
    #[arg(long, value_name = "FILE")]
    pub(crate) potentials: Option<OutPath>,
    /// Omit the iterative refinement: a few digits less in half the time
    #[arg(long)]
    pub(crate) plain: bool,
    /// Number of threads; does not change the readings [default: all cores]
    #[arg(long, value_name = "N")]
    pub(crate) threads: Option<usize>,
    /// Print 'forward N ms', the median after set-up, on standard error
    #[arg(long)]
    pub(crate) timing: bool,
}

/// Variables of the sensitivity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Of {
    /// Conductance: V per (S per square)
    Sigma,
    /// The logarithm of conductance: V
    LnSigma,
    /// Contact impedance, one column per electrode: V per ohm m
    Contact,
}

#[derive(Debug, Args)]
pub(crate) struct JacobianOptions {
    /// Case folder
    #[arg(long, value_name = "DIR")]
    pub(crate) case: PathBuf,
    /// Conductance: a name in the case (sigma_NAME.csv) or a file
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) sigma: String,
    /// Variable of the derivative
    #[arg(long, value_enum, default_value_t = Of::Sigma)]
    pub(crate) of: Of,
    /// Only the triangles of the region of interest (roi.csv), in its order
    #[arg(long)]
    pub(crate) region: bool,
    /// Squares of this pitch, mm, over the region instead of triangles [default: triangles]
    #[arg(long, value_name = "MM", conflicts_with = "region")]
    pub(crate) cells_mm: Option<f64>,
    /// File for the centres of the squares: x_m, y_m, one row per column of the sensitivity
    #[arg(long, value_name = "FILE", requires = "cells_mm")]
    pub(crate) centres: Option<OutPath>,
    /// File for the sensitivity, one row per reading
    #[arg(long, value_name = "FILE")]
    pub(crate) out: OutPath,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
}

#[derive(Debug, Args)]
pub(crate) struct TransferOptions {
    /// Case folder
    #[arg(long, value_name = "DIR")]
    pub(crate) case: PathBuf,
    /// Conductance: a name in the case (sigma_NAME.csv) or a file
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) sigma: String,
    /// Transfer admittance Y, siemens: i = Y v
    #[arg(long, value_name = "FILE", required_unless_present = "impedance")]
    pub(crate) admittance: Option<OutPath>,
    /// Transfer impedance Z, ohm: v = Z i where the currents sum to zero, mean of v zero
    #[arg(long, value_name = "FILE")]
    pub(crate) impedance: Option<OutPath>,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
}
