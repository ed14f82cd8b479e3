//! Errors of samples and of trainings.

use std::error::Error;

use eit::{ForwardError, ModelError, OneStepError};

/// Errors of samples.
#[derive(Debug, thiserror::Error)]
pub enum SampleError {
    /// A sample with a number that is not finite, which would spoil every weight.
    #[error(
        "{place}: {what} of case {case} is not a finite number; make this part of the set again"
    )]
    NotFinite {
        /// The file or other source of the sample.
        place: String,
        /// The case, from 0.
        case: usize,
        /// Which number.
        what: String,
    },
    /// The forward model refused the case.
    #[error("case {case} of the training set cannot be solved")]
    Unsolved {
        /// The case, from 0.
        case: usize,
        /// The cause.
        #[source]
        cause: Box<TrainError>,
    },
    /// A file of the set cannot be read, or has unexpected content.
    #[error("{place}")]
    Unreadable {
        /// The file and the problem.
        place: String,
        /// The error of the operating system.
        #[source]
        cause: Box<dyn Error + Send + Sync>,
    },
}

/// Errors of trainings.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The forward model refused its input.
    #[error("the forward model of the training set")]
    Forward(#[from] ForwardError),
    /// A sample of the set cannot be read.
    #[error("the training set")]
    Sample(#[from] SampleError),
    /// An invalid setting.
    #[error("training setting {setting} is {value}, it must be {must}")]
    Setting {
        /// Its name.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// The trained result is not a valid model.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The fitted result is not a valid network.
    #[error("{0}")]
    Network(String),
    /// The model of the sheet for the misfit of maps of held-out cases cannot be prepared.
    #[error("the check of the maps of held-out cases")]
    Check(#[from] OneStepError),
    /// Too few repeats of the baseline.
    #[error(
        "the readings' covariance is not definite: there are too few measured repeats of the baseline; give --noise-v"
    )]
    Covariance,
    /// Readings with several currents.
    #[error("noise in volts needs one current for all readings; protocol.csv has several")]
    Currents,
    /// All samples are equal.
    #[error("all samples of the training set are alike; more cases or a larger radius are needed")]
    Alike,
    /// The least-squares problem gave numbers that are not finite.
    #[error("the weights could not be computed: the least-squares problem has no solution")]
    Weights,
}
