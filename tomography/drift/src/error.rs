//! Errors of the crate.

use eit::ForwardError;

/// Errors of the drift model and the tracker.
#[derive(Debug, thiserror::Error)]
pub enum DriftError {
    /// The forward model refused the sheet.
    #[error("the sheet's model: {0}")]
    Forward(#[from] ForwardError),
    /// Wrong number of readings for the protocol.
    #[error("{has} readings, the protocol has {wants}")]
    Readings {
        /// Readings given.
        has: usize,
        /// Readings of the protocol.
        wants: usize,
    },
    /// A baseline with readings that are missing, zero or not numbers.
    #[error(
        "reading {reading} of the baseline has no value to compare with; record the baseline again"
    )]
    Baseline {
        /// Index of the reading.
        reading: usize,
    },
    /// Fewer reciprocal pairs than a covariance needs.
    #[error("{rows} of {wants} pairs of readings are left, at least half are needed")]
    TooFew {
        /// Pairs with both readings.
        rows: usize,
        /// Pairs of the protocol.
        wants: usize,
    },
    /// Fewer readings of the last injections than a fit needs.
    #[error("{has} of {wants} readings of the last injections are left, at least half are needed")]
    FewReadings {
        /// Readings with a value that is not nearly 0 V.
        has: usize,
        /// Readings of these injections.
        wants: usize,
    },
    /// A covariance that is not positive definite.
    #[error("the covariance of the data is not positive definite")]
    Covariance,
    /// A map before the first frame.
    #[error("no usable frame has been tracked yet")]
    NoFrame,
    /// A stored state of a different sheet, mesh or build.
    #[error("the stored state is of {has}, this sheet is {wants}")]
    State {
        /// Identity of the sheet for which the state was stored.
        has: String,
        /// Identity of the sheet on which the state is restored.
        wants: String,
    },
    /// A stored state of this sheet with an array length or an index that does not fit the sheet.
    #[error("the stored state is damaged: its {field} does not fit the sheet")]
    DamagedState {
        /// The field of the state.
        field: &'static str,
    },
}
