//! Why there is no sample, and why there is no trained model.

use std::error::Error;

use eit::{ForwardError, ModelError};

/// Why there is no sample.
#[derive(Debug, thiserror::Error)]
pub enum SampleError {
    /// A sample with a number that is none: training on it would poison every weight.
    #[error(
        "{place}: {what} of case {case} is not a finite number; make this part of the set again"
    )]
    NotFinite {
        /// The file, or what else the sample came from.
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
        /// Why.
        #[source]
        cause: Box<TrainError>,
    },
    /// A file of the set cannot be read, or holds something else.
    #[error("{place}")]
    Unreadable {
        /// The file, and what is wrong with it.
        place: String,
        /// What the system says.
        #[source]
        cause: Box<dyn Error + Send + Sync>,
    },
}

/// Why there is no trained model.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The forward model refused.
    #[error("the forward model of the training set")]
    Forward(#[from] ForwardError),
    /// A sample of the set cannot be had.
    #[error("the training set")]
    Sample(#[from] SampleError),
    /// A setting without meaning.
    #[error("training setting {setting} is {value}, it must be {must}")]
    Setting {
        /// Which.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
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
    /// Readings with several currents.
    #[error("noise in volts needs one current for all readings; protocol.csv has several")]
    Currents,
    /// Every sample is the same.
    #[error("all samples of the training set are alike; more cases or a larger radius are needed")]
    Alike,
    /// The least-squares problem gave numbers that are not finite.
    #[error("the weights could not be found: the least-squares problem gave out")]
    Weights,
}
