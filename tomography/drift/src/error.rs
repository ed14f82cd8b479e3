//! Errors of the crate.

use eit::ForwardError;

/// Why a sheet cannot be followed.
#[derive(Debug, thiserror::Error)]
pub enum DriftError {
    /// The forward model refused the sheet.
    #[error("the sheet's model: {0}")]
    Forward(#[from] ForwardError),
    /// Another number of readings than the protocol has.
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
    /// A covariance that is not positive definite.
    #[error("the covariance of the data is not positive definite")]
    Covariance,
    /// A map before the first frame.
    #[error("no usable frame has been tracked yet")]
    NoFrame,
    /// A stored state of another sheet, mesh or build.
    #[error("the stored state is of {has}, this sheet is {wants}")]
    State {
        /// What the state was made for.
        has: String,
        /// What it is restored on.
        wants: String,
    },
    /// A stored state of this sheet with a length or an index that does not fit it.
    #[error("the stored state is damaged: its {field} does not fit the sheet")]
    DamagedState {
        /// The field of the state.
        field: &'static str,
    },
}
