//! Options of `tactus-lab train`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use outfile::OutPath;

use super::Replacing;
use super::numbers::{CASES, EPOCHS, NEURONS, REPEATS, SPREAD_TIMES, gamma, noise_v};

#[derive(Debug, Subcommand)]
pub(crate) enum Network {
    /// A radial-basis-function network (the paper's section 4.3)
    Rbf(TrainOptions),
    /// A deep network of fully connected layers (the paper's section 4.2)
    Dnn(DeepOptions),
    /// A linear map: the matrix of least mean square error over the training set and its noise
    Linear(LinearOptions),
}

/// Number format of the weights of a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum PrecisionName {
    /// Four bytes per weight
    F32,
    /// Two bytes per weight
    F16,
    /// One byte per weight, one scale per row
    Int8,
}

impl From<PrecisionName> for eit::Precision {
    fn from(name: PrecisionName) -> Self {
        match name {
            PrecisionName::F32 => Self::F32,
            PrecisionName::F16 => Self::F16,
            PrecisionName::Int8 => Self::Int8,
        }
    }
}

#[derive(Debug, Args)]
pub(crate) struct DeepOptions {
    #[command(flatten)]
    pub(crate) data: DataOptions,
    /// Settings that differ from the profile's: a TOML file with tables [data] and [deep]
    #[arg(long, value_name = "FILE")]
    pub(crate) settings: Option<PathBuf>,
    /// One setting, after the file: width=512, hidden_layers=3, learning_rate=5e-4, data.radius_m=0.05 (repeatable)
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) set: Vec<String>,
    /// Simulated cases [default: 15000]
    #[arg(long, value_name = "N", value_parser = CASES.counter())]
    pub(crate) cases: Option<usize>,
    /// Jittered copies of each case [default: 5]
    #[arg(long, value_name = "N", value_parser = REPEATS.counter())]
    pub(crate) repeats: Option<usize>,
    /// Passes over the training set [default: 30]
    #[arg(long, value_name = "N", value_parser = EPOCHS.counter())]
    pub(crate) epochs: Option<usize>,
    /// The same seed gives the same file [default: 1]
    #[arg(long, value_name = "S")]
    pub(crate) seed: Option<u64>,
    /// Number format of the weights
    #[arg(long, value_enum, default_value_t = PrecisionName::F32)]
    pub(crate) precision: PrecisionName,
    /// Checkpoint file, written after each epoch; the same command continues from it [default: OUT with .checkpoint]
    #[arg(long, value_name = "FILE")]
    pub(crate) checkpoint: Option<PathBuf>,
    /// Model file to write
    #[arg(long, value_name = "FILE")]
    pub(crate) out: OutPath,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print the results of the training as one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}

/// Noise that a model is trained for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Profile {
    /// The paper's jitter: gamma times the standard deviation of the normalised baseline
    Paper,
    /// Jitter like the real noise, on baseline and frame: white, in volts, or the measured noise of unloaded frames
    Matched,
    /// Jitter like white noise (one --noise-v) and months of drift: gain 5 %, contacts 14 %, smooth fields 0.3 %
    Months,
}

impl Profile {
    /// Name of the profile on the command line and in the names of models.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Matched => "matched",
            Self::Months => "months",
        }
    }
}

/// Options of every training: noise, case, training set.
#[derive(Debug, Args)]
pub(crate) struct DataOptions {
    /// Kind of jitter, with its settings
    #[arg(long, value_enum)]
    pub(crate) profile: Profile,
    /// gamma of the profile `paper`, a number: share of the standard deviation of the normalised baseline [default: 0.01]
    #[arg(long, value_parser = gamma)]
    pub(crate) gamma: Option<f64>,
    /// Noise of one reading for the profiles `matched` and `months`, V: less than the largest reading of the case, and more than 1 mV only with --yes. For `matched` repeatable: the copies of a case use the levels in turn [default: 2e-6]
    #[arg(long, value_name = "SD", value_parser = noise_v)]
    pub(crate) noise_v: Vec<f64>,
    /// Allow training for more than 1 mV of noise, and write a model even if it is no better than empty maps
    #[arg(long)]
    pub(crate) yes: bool,
    /// Frames of the unloaded sheet: the profile `matched` uses their covariance instead of --noise-v
    #[arg(long, value_name = "FILE")]
    pub(crate) noise_frames: Option<PathBuf>,
    /// Add the mirror images of every case, if mesh and contacts are symmetric
    #[arg(long)]
    pub(crate) symmetric: bool,
    /// Folder of a training set made by `dataset`, instead of newly simulated cases
    #[arg(long, value_name = "DIR", conflicts_with = "cases")]
    pub(crate) dataset: Option<PathBuf>,
    /// Case folder to train for [default: the preset of the paper's sheet at 1 mA]
    #[arg(long, value_name = "DIR")]
    pub(crate) case: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct TrainOptions {
    #[command(flatten)]
    pub(crate) data: DataOptions,
    /// Simulated cases
    #[arg(long, value_name = "N", default_value_t = 15_000, value_parser = CASES.counter())]
    pub(crate) cases: usize,
    /// Jittered copies of each case
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = REPEATS.counter())]
    pub(crate) repeats: usize,
    /// Neurons
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = NEURONS.counter())]
    pub(crate) neurons: usize,
    /// The same seed gives the same file
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Width of the neurons as a multiple of the spread of Eq. 13
    #[arg(long, value_name = "X", default_value_t = 1.0, value_parser = SPREAD_TIMES.parser())]
    pub(crate) spread_times: f64,
    /// Model file to write
    #[arg(long, value_name = "FILE")]
    pub(crate) out: OutPath,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print the results of the training as one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct LinearOptions {
    #[command(flatten)]
    pub(crate) data: DataOptions,
    /// Simulated cases
    #[arg(long, value_name = "N", default_value_t = 15_000, value_parser = CASES.counter())]
    pub(crate) cases: usize,
    /// The same seed gives the same file
    #[arg(
        long,
        value_name = "S",
        default_value_t = 1,
        conflicts_with = "dataset"
    )]
    pub(crate) seed: u64,
    /// Number format of the weights
    #[arg(long, value_enum, default_value_t = PrecisionName::F32)]
    pub(crate) precision: PrecisionName,
    /// Model file to write
    #[arg(long, value_name = "FILE")]
    pub(crate) out: OutPath,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print the results of the training as one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}
