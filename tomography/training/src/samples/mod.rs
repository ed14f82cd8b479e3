//! Training sets (Algorithm 1, Eq. 6 to 9 of the paper): samples by index, in memory or computed on demand, and their
//! jitter. Sets in files are in `dataset`.
//!
//! Choices that the paper leaves open are settings ([`eit::OpenChoices`]). In addition: the vertices of a polygon are
//! connected in the order of their angles; a triangle belongs to a polygon that contains its centroid (even-odd rule);
//! a polygon with fewer than three vertices changes nothing, and cases without any change remain in the set; the
//! forward model limits a loss of 100 % ([`eit::FLOOR`]).

mod error;
mod noise;
mod random;
mod set;
mod simulation;

use eit::TrainingSettings;

pub use error::{SampleError, TrainError};
pub use noise::Noise;
pub(crate) use random::{Purpose, stream};
pub use set::TrainingSet;
pub use simulation::Simulation;

/// The non-zero changes of a sample: (triangle, relative change).
pub type Sparse = Vec<(u32, f32)>;

/// Stage of a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Solving forward problems.
    Cases,
    /// Iterations of k-means (at most this many).
    Clusters,
    /// Solving the least-squares problem.
    Weights,
}

/// Called with the stage of a training, the completed units and the total.
pub type Progress<'a> = &'a (dyn Fn(Stage, usize, usize) + Sync);

/// A case without jitter.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// (v - v0) / max|v0| of every reading (Eq. 6).
    pub input: Vec<f32>,
    /// The non-zero changes (Eq. 7), in ascending order: (triangle of the region, relative change of its conductance,
    /// or with [`eit::ChangeChoice::Absolute`] the change over the mean conductance of the region).
    pub target: Vec<(u32, f32)>,
}

impl Sample {
    /// Refuses numbers that are not finite; the error names place, case and number.
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

/// A set of samples of any size, in memory or elsewhere: read by index, in any order, by several threads.
///
/// A [`TrainingSet`] is in memory; a [`Simulation`] solves cases on demand; a [`DataSet`](crate::dataset::DataSet) is
/// in files.
pub trait Samples: Sync {
    /// Number of cases, without jittered copies.
    fn len(&self) -> usize;
    /// Whether there is no case.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Number of readings of an input.
    fn inputs(&self) -> usize {
        self.baseline().len()
    }
    /// Number of triangles of the region.
    fn outputs(&self) -> usize;
    /// The unloaded readings at 1 A, V.
    fn baseline(&self) -> &[f64];
    /// Case `case`, below [`Self::len`]; the caller checks that it is finite ([`Sample::check`]).
    ///
    /// # Errors
    /// See [`SampleError`].
    fn sample(&self, case: usize) -> Result<Sample, SampleError>;
}

/// The target as a row of `outputs` numbers, zero where nothing changed.
pub fn dense_target(target: &[(u32, f32)], outputs: usize) -> Vec<f32> {
    let mut row = vec![0.0; outputs];
    for &(unknown, change) in target {
        row[unknown as usize] = change;
    }
    row
}

/// Refuses invalid settings.
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
    noise::check(&settings.jitter)?;
    positive([
        ("radius_m", settings.radius_m),
        ("spread_times", settings.spread_times),
    ])
}

/// Refuses the first setting that is not a positive number.
fn positive(settings: impl IntoIterator<Item = (&'static str, f64)>) -> Result<(), TrainError> {
    let mut settings = settings.into_iter();
    match settings.find(|(_, value)| !(*value > 0.0 && value.is_finite())) {
        None => Ok(()),
        Some((setting, value)) => Err(TrainError::Setting {
            setting,
            value,
            must: "a positive number",
        }),
    }
}
