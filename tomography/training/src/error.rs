//! Why there is no trained model.

use eit::{ModelError, SampleError, TrainError};

/// Why a model of a case could not be made.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// The set cannot be simulated, or the training fails.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// A sample of the set cannot be read.
    #[error(transparent)]
    Sample(#[from] SampleError),
    /// What was trained is no model.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// What was fitted is no network.
    #[error("{0}")]
    Network(String),
    /// Too few repeats of the baseline.
    #[error(
        "the readings' covariance is not definite: measured repeats of the baseline are too few to stand alone; give \
         --noise-v"
    )]
    Covariance,
    /// Every sample is the same.
    #[error("all samples of the training set are alike; more cases are needed")]
    Alike,
    /// Readings with several currents.
    #[error("noise in volts needs one current for all readings; protocol.csv has several")]
    Currents,
}
