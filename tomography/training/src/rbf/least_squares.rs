//! The RBF network of the paper (Eq. 12 to 15): centres by k-means, the spread, and the weights by least squares.

use eit::inverse::learned::network::FAMILIAR_SHARE;
use eit::linear_algebra::{product, squared_distance};
use eit::{DistancesChoice, RbfNetwork, TrainingReport, TrainingSettings};
use faer::MatRef;
use faer::linalg::solvers::Svd;
use nalgebra::DMatrix;
use rand::RngExt;
use rayon::prelude::*;

use super::kmeans::{self, Rows};
use crate::samples::{
    Noise, Progress, Purpose, Samples, Sparse, Stage, TrainError, TrainingSet, check, stream,
};

/// Singular values of Phi below this share of the largest are dropped (Moore-Penrose).
const CUT: f64 = 1e-10;

/// Conditioning of the least-squares problem of Eq. 15.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Conditioning {
    /// Distance from the nearest centre, in spreads, within which 99.9 % of the samples lie.
    familiar: f64,
    /// Number of singular values that were not dropped.
    rank: usize,
    /// Largest over smallest singular value of Phi, including dropped ones.
    condition: f64,
    /// Largest entry of W.
    largest_weight: f64,
}

/// Stored in place of the ratio to a median of zero (most pairs of samples are equal), because a model file contains
/// finite numbers only.
pub(super) const MEDIAN_OF_ZERO: f64 = 1e30;
const MOST_ROUNDS: usize = 100;
/// Maximum number of pairs of samples from which the spread is estimated.
const PAIRS: usize = 1_000_000;

/// Trains an RBF network (Eq. 12 to 15) on a given set; `settings` contains everything else. All jittered inputs are
/// held in memory.
///
/// # Errors
/// See [`TrainError`].
pub fn train_rbf_on(
    samples: &dyn Samples,
    settings: &TrainingSettings,
    progress: Progress<'_>,
) -> Result<(RbfNetwork, TrainingReport), TrainError> {
    check(settings)?;
    let set = TrainingSet::read(samples, progress)?;
    let noise = Noise::new(
        &settings.jitter,
        settings.open.spread,
        &set.baseline,
        settings.seed,
    )?;
    noise.check_copies(settings.repeats)?;
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
        DistancesChoice::Jittered => rows,
        DistancesChoice::Clean => Rows {
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
    let (network, conditioning) = fit(
        rows,
        &clusters.centres,
        spread,
        &set.targets,
        samples.outputs(),
    )?;
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
        spread_over_median: (spread / median).min(MEDIAN_OF_ZERO),
        familiar: conditioning.familiar,
        rank: conditioning.rank,
        condition: conditioning.condition,
        largest_weight: conditioning.largest_weight,
    };
    Ok((network, report))
}

/// Solves Eq. 15 for given centres and spread. `inputs` are `repeats` copies of the cases, one set after another, each
/// with its own jitter; `targets` has one entry per case.
fn fit(
    inputs: Rows<'_>,
    centres: &[f64],
    spread: f64,
    targets: &[Sparse],
    outputs: usize,
) -> Result<(RbfNetwork, Conditioning), TrainError> {
    let centres: Vec<f32> = centres.iter().map(|value| *value as f32).collect();
    let wide: Vec<f64> = centres.iter().map(|value| f64::from(*value)).collect();
    let neurons = centres.len() / inputs.width;
    let mut rows = vec![0.0; inputs.len() * neurons];
    let mut nearest: Vec<f64> = rows
        .par_chunks_mut(neurons)
        .enumerate()
        .map(|(sample, phi)| {
            let row = inputs.row(sample);
            let mut least = f64::INFINITY;
            for (phi, centre) in phi.iter_mut().zip(wide.chunks(inputs.width)) {
                let square = squared_distance(row, centre);
                least = least.min(square);
                *phi = (-0.5 * square / (spread * spread)).exp();
            }
            least.sqrt() / spread
        })
        .collect();
    nearest.sort_by(f64::total_cmp);
    let last = (nearest.len() as f64 * FAMILIAR_SHARE) as usize;
    let familiar = nearest[last.min(nearest.len() - 1)];
    let phi = MatRef::from_row_major_slice(&rows, inputs.len(), neurons);
    let qr = phi.qr();
    let svd = Svd::new(qr.thin_R()).map_err(|_| TrainError::Weights)?;
    let (u, s, v) = (svd.U(), svd.S(), svd.V());
    let rank = (0..neurons).filter(|&i| s[i] > CUT * s[0]).count();
    if rank == 0 {
        return Err(TrainError::Weights);
    }
    // coordinates of every case in the directions that were not dropped, summed over the repeats, which have the same
    // target
    let q = qr.compute_thin_Q();
    let cases = targets.len();
    let coordinates: Vec<f64> = (0..cases)
        .into_par_iter()
        .flat_map_iter(|case| {
            let mut sum = vec![0.0; neurons];
            for sample in (case..inputs.len()).step_by(cases) {
                for (j, sum) in sum.iter_mut().enumerate() {
                    *sum += q[(sample, j)];
                }
            }
            (0..rank)
                .map(|direction| (0..neurons).map(|j| sum[j] * u[(j, direction)]).sum())
                .collect::<Vec<f64>>()
        })
        .collect();
    let weights: Vec<Vec<f64>> = (0..rank)
        .into_par_iter()
        .map(|direction| {
            let mut row = vec![0.0; outputs];
            for (case, target) in targets.iter().enumerate() {
                let along = coordinates[case * rank + direction];
                for &(unknown, change) in target {
                    row[unknown as usize] += along * f64::from(change);
                }
            }
            row
        })
        .collect();
    let mixing: Vec<f64> = (0..rank)
        .flat_map(|direction| (0..neurons).map(move |n| v[(n, direction)] / s[direction]))
        .collect();
    let largest_weight = largest_product(&mixing, &weights, neurons);
    let network = RbfNetwork::new(
        [inputs.width, outputs],
        spread,
        centres,
        mixing,
        weights
            .iter()
            .flatten()
            .map(|value| *value as f32)
            .collect(),
    )
    .map_err(|_| TrainError::Weights)?;
    Ok((
        network,
        Conditioning {
            familiar,
            rank,
            condition: (s[0] / s[neurons - 1]).min(f64::MAX),
            largest_weight,
        },
    ))
}

/// Largest absolute entry of W = transpose(weights) mixing.
fn largest_product(mixing: &[f64], weights: &[Vec<f64>], neurons: usize) -> f64 {
    let rank = weights.len();
    let weights = DMatrix::from_fn(weights[0].len(), rank, |i, j| weights[j][i]);
    let view = MatRef::from_column_major_slice(weights.as_slice(), weights.nrows(), rank);
    let mixing = MatRef::from_row_major_slice(mixing, rank, neurons);
    product(view, mixing).amax()
}

/// Eq. 13, mean plus standard deviation of the distances of two samples, and their median: over all pairs if there are
/// at most `most`, otherwise over `most` random pairs.
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
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

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
