//! The seam between training sets and training: samples one by one, in memory, from files, or made on demand.

use std::error::Error;

use crate::inverse::learned::rbf::Sparse;

/// A case without jitter.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// (v - v0) / max|v0| of every reading (Eq. 6).
    pub input: Vec<f32>,
    /// (triangle of the region, relative change of its conductance) where it is not zero, ascending (Eq. 7).
    pub target: Vec<(u32, f32)>,
}

impl Sample {
    /// Refuses numbers that are not finite, naming place, case and number.
    ///
    /// # Errors
    /// [`SampleError::NotFinite`].
    pub fn check(&self, place: &str, case: usize) -> Result<(), SampleError> {
        let refuse = |what| SampleError::NotFinite {
            place: place.to_owned(),
            case,
            what,
        };
        if let Some(reading) = self.input.iter().position(|value| !value.is_finite()) {
            return Err(refuse(format!("reading {reading}")));
        }
        match self.target.iter().find(|(_, change)| !change.is_finite()) {
            Some((unknown, _)) => Err(refuse(format!("the change of triangle {unknown}"))),
            None => Ok(()),
        }
    }
}

/// A set of samples, however large and wherever it lies: read by number, in any order, by several threads.
///
/// A set in memory is a [`super::TrainingSet`]; one that is solved as it is read is a [`super::Simulation`]; one in
/// files is the laboratory's.
pub trait Samples: Sync {
    /// Number of cases, without jittered copies.
    fn len(&self) -> usize;
    /// Whether there is no case.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Readings of an input.
    fn inputs(&self) -> usize {
        self.baseline().len()
    }
    /// Triangles of the region.
    fn outputs(&self) -> usize;
    /// The unloaded readings at 1 A, V.
    fn baseline(&self) -> &[f64];
    /// Case `case`, below [`Self::len`]; whoever trains on it checks that it is finite ([`Sample::check`]).
    ///
    /// # Errors
    /// See [`SampleError`].
    fn sample(&self, case: usize) -> Result<Sample, SampleError>;
}

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
        cause: Box<super::TrainError>,
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

/// The target as a row of `outputs` numbers.
pub fn dense_target(target: &Sparse, outputs: usize) -> Vec<f32> {
    let mut row = vec![0.0; outputs];
    for &(unknown, change) in target {
        row[unknown as usize] = change;
    }
    row
}
