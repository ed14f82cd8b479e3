//! The training set of the paper (Algorithm 1, Eq. 6 to 9), and the training of the RBF network on it.
//!
//! Where the paper's text leaves a choice it is a setting ([`OpenReadings`]). Besides: the vertices of a polygon are joined
//! in the order of their angles; a triangle belongs to a polygon that holds its centroid (even-odd rule); fewer than three
//! vertices, or no polygon, make an unchanged sample, which is kept; a loss of 100 % is floored by the forward model
//! ([`crate::FLOOR`]).

mod algorithm;
mod noise;
mod samples;
mod set;

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use survey::Protocol;

pub use algorithm::{
    CentresReading, ChangeReading, DistancesReading, LossReading, OpenReadings, PointsReading,
    Simulation, SizeReading, SpreadReading,
};
pub use noise::{Jitter, Noise};
pub use samples::{Sample, SampleError, Samples, dense_target};
pub use set::TrainingSet;

use crate::inverse::learned::kmeans;
use crate::inverse::learned::kmeans::Rows;
use crate::inverse::learned::rbf::RbfNetwork;
use crate::linear_algebra::simd::squared_distance;
use crate::{ForwardError, Mesh};

/// Settings of a training; the defaults are the paper's (section 5.3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainingSettings {
    /// C: simulated cases.
    pub cases: usize,
    /// S: jittered copies of each.
    pub repeats: usize,
    /// P: at most so many polygons a case.
    pub polygons: usize,
    /// R_p: largest radius of the circle round a polygon, m.
    pub radius_m: f64,
    /// K_p: at most so many vertices.
    pub vertices: usize,
    /// The jitter.
    pub jitter: Jitter,
    /// N: neurons.
    pub neurons: usize,
    /// Width of the neurons in times of Eq. 13's spread.
    #[serde(skip_serializing_if = "is_one")]
    pub spread_times: f64,
    /// The same seed gives the same network.
    pub seed: u64,
    /// How the paper's text is read where it is open.
    #[serde(skip_serializing_if = "OpenReadings::is_default")]
    pub open: OpenReadings,
}

impl Default for TrainingSettings {
    fn default() -> Self {
        Self {
            cases: 15_000,
            repeats: 5,
            polygons: 4,
            radius_m: 0.070,
            vertices: 5,
            jitter: Jitter::paper(),
            neurons: 100,
            spread_times: 1.0,
            seed: 1,
            open: OpenReadings::default(),
        }
    }
}

fn is_one(value: &f64) -> bool {
    *value == 1.0
}

/// What a training found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainingReport {
    /// Cases in which no triangle changed.
    pub unchanged: usize,
    /// Standard deviation of the jitter, in units of the normalised input.
    pub jitter: f64,
    /// Rounds of k-means.
    pub rounds: usize,
    /// Clusters that ran empty and were begun again.
    pub reseeded: usize,
    /// b of Eq. 13.
    pub spread: f64,
    /// b over the median distance of two samples; above 10 a few samples rule it.
    pub spread_over_median: f64,
    /// Distance from the nearest centre, in spreads, within which 99.9 % of the samples lie.
    pub familiar: f64,
    /// Directions of Phi that were kept.
    pub rank: usize,
    /// Condition number of Phi.
    pub condition: f64,
    /// Largest entry of W.
    pub largest_weight: f64,
}

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

/// Why there is no network.
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
    /// Every sample is the same.
    #[error("all samples of the training set are alike; more cases or a larger radius are needed")]
    Alike,
    /// The least-squares problem gave numbers that are not finite.
    #[error("the weights could not be found: the least-squares problem gave out")]
    Weights,
}

const MOST_ROUNDS: usize = 100;
/// Pairs of samples from which the spread is estimated, where there are more.
const PAIRS: usize = 1_000_000;

/// Trains an RBF network (Eq. 12 to 15).
///
/// # Errors
/// See [`TrainError`].
pub fn train_rbf(
    mesh: &Arc<Mesh>,
    contact_ohm_m: &[f64],
    sigma0: &[f64],
    protocol: &Protocol,
    settings: &TrainingSettings,
    progress: &(dyn Fn(Stage, usize, usize) + Sync),
) -> Result<(RbfNetwork, TrainingReport), TrainError> {
    let simulation = Simulation::new(mesh, contact_ohm_m, sigma0, protocol, settings)?;
    train_rbf_on(&simulation, settings, progress)
}

/// Trains an RBF network on a set that is there; `settings` say the rest. All inputs with their jitter are held in memory.
///
/// # Errors
/// See [`TrainError`].
pub fn train_rbf_on(
    samples: &dyn Samples,
    settings: &TrainingSettings,
    progress: &(dyn Fn(Stage, usize, usize) + Sync),
) -> Result<(RbfNetwork, TrainingReport), TrainError> {
    check(settings)?;
    let set = TrainingSet::read(samples, progress)?;
    let noise = Noise::new(
        &settings.jitter,
        settings.open.spread,
        &set.baseline,
        settings.seed,
    )?;
    let inputs = set.jittered(settings.repeats, &noise);
    let rows = Rows {
        values: &inputs,
        width: set.baseline.len(),
    };
    let clusters = kmeans::cluster(
        rows,
        settings.neurons,
        settings.seed,
        MOST_ROUNDS,
        &|round| {
            progress(Stage::Clusters, round, MOST_ROUNDS);
        },
    );
    let measured = match settings.open.distances {
        DistancesReading::Jittered => rows,
        DistancesReading::Clean => Rows {
            values: &set.inputs,
            width: rows.width,
        },
    };
    let (spread, median) = spread(measured, settings.seed, PAIRS);
    let spread = spread * settings.spread_times;
    if spread <= 0.0 || !spread.is_finite() {
        return Err(TrainError::Alike);
    }
    progress(Stage::Weights, 0, 1);
    let (network, conditioning) = RbfNetwork::fit(
        rows,
        &clusters.centres,
        spread,
        &set.targets,
        samples.outputs(),
    )
    .ok_or(TrainError::Weights)?;
    progress(Stage::Weights, 1, 1);
    let report = TrainingReport {
        unchanged: set
            .targets
            .iter()
            .filter(|target| target.is_empty())
            .count(),
        jitter: noise.size(),
        rounds: clusters.rounds,
        reseeded: clusters.reseeded,
        spread,
        spread_over_median: spread / median,
        familiar: conditioning.familiar,
        rank: conditioning.rank,
        condition: conditioning.condition,
        largest_weight: conditioning.largest_weight,
    };
    Ok((network, report))
}

fn check(settings: &TrainingSettings) -> Result<(), TrainError> {
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

/// What a random stream is for: streams of different purposes never meet.
#[derive(Clone, Copy)]
enum Purpose {
    Case = 1,
    Jitter = 2,
    Pairs = 3,
}

fn stream(seed: u64, purpose: Purpose, item: usize) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(((purpose as u64) << 48) | item as u64);
    random
}

/// Eq. 13, mean plus standard deviation of the distances of two samples, and their median: over all pairs where there are
/// no more than `most`, else over `most` of them drawn at random.
fn spread(rows: Rows<'_>, seed: u64, most: usize) -> (f64, f64) {
    const CHUNK: usize = 10_000;
    let n = rows.len();
    let all = n * n.saturating_sub(1) / 2;
    let distance = |a: usize, b: usize| {
        let other: Vec<f64> = rows.row(b).iter().map(|value| f64::from(*value)).collect();
        squared_distance(rows.row(a), &other).sqrt()
    };
    let mut distances: Vec<f64> = if all <= most {
        (0..n)
            .into_par_iter()
            .flat_map_iter(|a| (a + 1..n).map(move |b| distance(a, b)))
            .collect()
    } else {
        (0..most.div_ceil(CHUNK))
            .into_par_iter()
            .flat_map_iter(|chunk| {
                let mut random = stream(seed, Purpose::Pairs, chunk);
                (0..CHUNK.min(most - chunk * CHUNK)).map(move |_| {
                    let a = random.random_range(0..n);
                    let b = random.random_range(0..n - 1);
                    distance(a, if b < a { b } else { b + 1 })
                })
            })
            .collect()
    };
    if distances.is_empty() {
        return (0.0, 0.0);
    }
    let count = distances.len() as f64;
    let mean = distances.iter().sum::<f64>() / count;
    let square: f64 = distances.iter().map(|d| (d - mean).powi(2)).sum();
    let deviation = (square / (count - 1.0).max(1.0)).sqrt();
    distances.sort_by(f64::total_cmp);
    (mean + deviation, distances[distances.len() / 2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sampled_spread_is_within_a_percent_of_the_exact_one() {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let values: Vec<f32> = (0..2000 * 20)
            .map(|_| (random.random::<f64>() * 4.0).exp() as f32)
            .collect();
        let rows = Rows {
            values: &values,
            width: 20,
        };
        let (exact, _) = spread(rows, 1, usize::MAX);
        let (sampled, _) = spread(rows, 1, 200_000);
        assert!((sampled / exact - 1.0).abs() < 0.01, "{sampled} {exact}");
    }
}
