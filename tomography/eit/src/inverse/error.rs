//! Errors in the preparation of linear reconstructions: of priors, solvers and the methods that share them.

use crate::ForwardError;

/// Why a one-step reconstruction cannot be prepared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OneStepError {
    /// The forward model refused its input.
    #[error("the forward model of the reconstruction")]
    Forward(#[from] ForwardError),
    /// The hyper-parameter is not positive, or negligible relative to the sensitivities.
    #[error(
        "the hyper-parameter lambda is {lambda:e}; it must be a finite number above {floor:.1e} for this geometry"
    )]
    Lambda {
        /// The value given or chosen.
        lambda: f64,
        /// The smallest value that double precision distinguishes from zero here.
        floor: f64,
    },
    /// A noise or a current that is not a positive number.
    #[error("the {what} is {value:e}; it must be a positive number")]
    NotPositive {
        /// Which setting.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A list does not have one entry per reading.
    #[error("{has} {what} for {wants} readings")]
    Count {
        /// Which list.
        what: &'static str,
        /// Entries given.
        has: usize,
        /// Entries required.
        wants: usize,
    },
    /// A map error that is not between 0 and 1.
    #[error("the map error allowed is {error:e}; it must be above 0 and below 1, e.g. 1e-3")]
    MapError {
        /// The error given.
        error: f64,
    },
    /// The prior could not be inverted, or the readings do not determine its null space.
    #[error(
        "the prior cannot be inverted on this geometry: no reading depends on some part of the region"
    )]
    Prior,
    /// A single matrix for all frames was requested from a method that chooses lambda for each frame.
    #[error("each frame has its own lambda; there is no single matrix for all frames")]
    PerFrame,
    /// A map error was given for a method that chooses lambda for each frame.
    #[error(
        "a map error can be allowed only if there is one matrix for all frames, not with a lambda for each frame"
    )]
    MapErrorPerFrame,
    /// No lambda has the requested noise figure.
    #[error(
        "no lambda gives a noise figure of {wanted}; on this geometry it can be {least:.3} to {most:.3}"
    )]
    NoiseFigure {
        /// The figure requested.
        wanted: f64,
        /// Smallest possible figure.
        least: f64,
        /// Largest possible figure.
        most: f64,
    },
}

impl OneStepError {
    /// Refuses a setting that is not a positive number.
    pub(crate) fn positive(what: &'static str, value: f64) -> Result<(), Self> {
        if value > 0.0 && value.is_finite() {
            Ok(())
        } else {
            Err(Self::NotPositive { what, value })
        }
    }
}
