//! Options of `forward`, `jacobian` and `transfer`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use outfile::OutPath;

use super::Replacing;

#[derive(Debug, Args)]
pub(crate) struct ForwardOptions {
    /// Case folder
    #[arg(long, value_name = "DIR")]
    pub(crate) case: PathBuf,
    /// Conductance: a name in the case (sigma_NAME.csv) or a file (repeatable)
    #[arg(long, value_name = "NAME|FILE", required_unless_present = "sigma_rows")]
    pub(crate) sigma: Vec<String>,
    /// Many conductances in one file: a row each, a column a triangle
    #[arg(long, value_name = "FILE", conflicts_with_all = ["sigma", "potentials"])]
    pub(crate) sigma_rows: Option<PathBuf>,
    /// Readings, V, with 17 digits: one a line; of several conductances a row each
    #[arg(long, value_name = "FILE")]
    pub(crate) out: OutPath,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Electrode voltages too, a row a drive, mean over the electrodes zero (one conductance)
    #[arg(long, value_name = "FILE")]
    pub(crate) potentials: Option<OutPath>,
    /// Leave out the refinement: some digits of fifteen for half the time
    #[arg(long)]
    pub(crate) plain: bool,
    /// Threads; the readings are the same on any number [default: all cores]
    #[arg(long, value_name = "N")]
    pub(crate) threads: Option<usize>,
    /// Print 'forward N ms', the median after set-up, on standard error
    #[arg(long)]
    pub(crate) timing: bool,
}

/// What readings are sensitive to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Of {
    /// Conductance: V per (S per square)
    Sigma,
    /// The logarithm of conductance: V
    LnSigma,
    /// Contact impedance, a column an electrode: V per ohm m
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
    /// Derivative with respect to what
    #[arg(long, value_enum, default_value_t = Of::Sigma)]
    pub(crate) of: Of,
    /// Only the triangles of the region of interest (roi.csv), in its order
    #[arg(long)]
    pub(crate) region: bool,
    /// Squares of this pitch, mm, over the region in place of triangles [default: triangles]
    #[arg(long, value_name = "MM", conflicts_with = "region")]
    pub(crate) cells_mm: Option<f64>,
    /// Centres of the squares: x_m, y_m, a row a column of the sensitivity
    #[arg(long, value_name = "FILE", requires = "cells_mm")]
    pub(crate) centres: Option<OutPath>,
    /// Sensitivity, a row a reading
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
