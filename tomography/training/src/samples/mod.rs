//! Training sets (Algorithm 1, Eq. 6 to 9 of the paper): samples one by one, in memory or made on demand, and their jitter.
//! Left to others: sets in files (`dataset`), and what is trained on them.
//!
//! Where the paper's text leaves a choice it is a setting ([`eit::OpenReadings`]). Besides: the vertices of a polygon are
//! joined in the order of their angles; a triangle belongs to a polygon that holds its centroid (even-odd rule); fewer than
//! three vertices, or no polygon, make an unchanged sample, which is kept; a loss of 100 % is floored by the forward model
//! ([`eit::FLOOR`]).

mod error;
mod noise;
mod random;
mod set;
mod simulation;

use eit::{Jitter, TrainingSettings};

pub use error::{SampleError, TrainError};
pub use noise::Noise;
pub(crate) use random::{Purpose, stream};
pub use set::TrainingSet;
pub use simulation::Simulation;

/// What a change of each sample is: (unknown, relative change) where it is not zero.
pub type Sparse = Vec<(u32, f32)>;

/// Where a training is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Solving forward problems.
    Cases,
    /// Rounds of k-means (at most so many).
    Clusters,
    /// Solving the least-squares problem.
    Weights,
}

/// Called with the stage of a training, and how much of it is done of how much.
pub type Progress<'a> = &'a (dyn Fn(Stage, usize, usize) + Sync);

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
/// A set in memory is a [`TrainingSet`]; one that is solved as it is read is a [`Simulation`]; one in files is a
/// [`DataSet`](crate::dataset::DataSet).
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

/// The target as a row of `outputs` numbers.
pub fn dense_target(target: &[(u32, f32)], outputs: usize) -> Vec<f32> {
    let mut row = vec![0.0; outputs];
    for &(unknown, change) in target {
        row[unknown as usize] = change;
    }
    row
}

/// Refuses settings without meaning.
pub(crate) fn check(settings: &TrainingSettings) -> Result<(), TrainError> {
    let refuse = |setting, value, must| {
        Err(TrainError::Setting {
            setting,
            value,
            must,
        })
    };
    for (setting, value) in [
        ("cases", settings.cases),
        ("repeats", settings.repeats),
        ("neurons", settings.neurons),
    ] {
        if value == 0 {
            return refuse(setting, 0.0, "1 or more");
        }
    }
    let samples = settings.cases * settings.repeats;
    if settings.neurons > samples {
        return refuse(
            "neurons",
            settings.neurons as f64,
            "no more than there are samples",
        );
    }
    let noise = match &settings.jitter {
        Jitter::Paper { gamma } => vec![("gamma", *gamma)],
        Jitter::Matched { noise_v, current_a } => {
            vec![("noise_v", *noise_v), ("current_a", *current_a)]
        }
        Jitter::Levels { noise_v, current_a } => noise_v
            .iter()
            .map(|level| ("noise_v", *level))
            .chain([("current_a", *current_a)])
            .collect(),
        Jitter::Measured { current_a, .. } => vec![("current_a", *current_a)],
    };
    let sizes = [
        ("radius_m", settings.radius_m),
        ("spread_times", settings.spread_times),
    ];
    for (setting, value) in noise.into_iter().chain(sizes) {
        if !(value > 0.0 && value.is_finite()) {
            return refuse(setting, value, "a positive number");
        }
    }
    Ok(())
}
