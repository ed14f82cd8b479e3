//! Tests on the differences of reciprocal readings: noise, pairs that are noisier than the others, and gains of
//! injections.
//!
//! The noise of a difference has a white part and a part proportional to the reading, which is the noise of the
//! source's current.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use survey::{Doubt, Electrode, Protocol};

use super::NOISE_RATIO;
use crate::inverse::reciprocity::Fold;
use crate::linear_algebra::dense;

/// Smallest number of differences for any conclusion, in addition to those used up by the gains.
const FEWEST: usize = 30;
/// Median of the square of a standard normal number.
const MEDIAN_SQUARE: f64 = 0.454_936;
/// Largest proportional noise of a reading that does not indicate a fault.
const PROPORTIONAL: f64 = 3e-4;
/// Mean square of a pair's differences, in units of their noise, above which the pair is noisy. White noise with 23
/// differences per pair exceeds it once in 10^9 frames.
const NOISY_PAIR: f64 = 5.0;
/// Mean square of the components that gains explain, in units of their noise, above which gains have changed. With 25
/// gains, noise exceeds it once in 10^8 frames.
const GAINS: f64 = 4.0;

/// The rotated difference of two twins that are both valid.
struct Difference {
    readings: [usize; 2],
    /// Shares of the readings in the difference.
    shares: [f64; 2],
    /// Indices of the pairs of electrodes that drive the readings.
    drives: [usize; 2],
    /// Change of the difference per relative change of each drive's gain.
    slopes: [f64; 2],
    /// Noise of the difference for a proportional noise of 1.
    size: f64,
}

/// The differences of a protocol.
pub(super) struct Reciprocal {
    /// Ordered by the size of the readings, smallest first.
    differences: Vec<Difference>,
    /// First electrode of each pair of electrodes that drives.
    electrodes: Vec<Electrode>,
}

/// Conclusions from the differences.
pub(super) struct Found {
    /// White noise of a difference; `None` if there are too few.
    pub(super) noise: Option<f64>,
    /// Root mean square of the largest proportional noise that does not indicate a fault.
    pub(super) proportional: f64,
    pub(super) doubts: Vec<Doubt>,
}

/// Gains fitted to the differences.
struct GainFit {
    gains: Vec<f64>,
    /// Sum of squares that the gains explain, in units of the noise.
    explained: f64,
    left: Vec<f64>,
}

impl Reciprocal {
    /// `model`: the model's readings, in the scale of the data.
    pub(super) fn new(protocol: &Protocol, fold: &Fold, model: &[f64], missing: &[usize]) -> Self {
        let twins = protocol.reciprocal_twins();
        let valid = |reading: usize| missing.binary_search(&reading).is_err();
        let mut numbers = BTreeMap::new();
        let mut electrodes = Vec::new();
        let mut differences = Vec::new();
        for (first, question) in protocol.measurements().iter().enumerate() {
            let Some(second) = twins[first].filter(|&second| second > first) else {
                continue;
            };
            if !(valid(first) && valid(second)) || twins[second] != Some(first) {
                continue;
            }
            let readings = [first, second];
            let shares = [fold.row(second).1, -fold.row(first).1];
            let reverse = protocol.measurements()[second];
            let drives = [question.drive, reverse.drive].map(|drive| {
                let next = numbers.len();
                *numbers.entry(drive).or_insert_with(|| {
                    electrodes.push(drive.plus);
                    next
                })
            });
            let slopes = [0, 1].map(|k| shares[k] * model[readings[k]]);
            differences.push(Difference {
                readings,
                shares,
                drives,
                slopes,
                size: slopes[0].hypot(slopes[1]),
            });
        }
        differences.sort_by(|a, b| a.size.total_cmp(&b.size));
        Self {
            differences,
            electrodes,
        }
    }

    /// `change` at the model's scale; `stated`: standard deviation of a change; `least`: the smallest noise that is not
    /// rounding; `size`: rms of the change.
    pub(super) fn of(&self, change: &[f64], stated: Option<f64>, least: f64, size: f64) -> Found {
        let count = self.differences.len();
        let squares = self.differences.iter().map(|one| one.size * one.size);
        let mut found = Found {
            noise: None,
            proportional: PROPORTIONAL * (squares.sum::<f64>() / count.max(1) as f64).sqrt(),
            doubts: Vec::new(),
        };
        if count < FEWEST + self.electrodes.len() {
            return found;
        }
        let values: Vec<f64> = self
            .differences
            .iter()
            .map(|one| {
                (0..2)
                    .map(|k| one.shares[k] * change[one.readings[k]])
                    .sum()
            })
            .collect();
        let Some(first) = self.fit(&values, stated.unwrap_or(least).max(least)) else {
            return found;
        };
        // the white noise is estimated from the smaller half of the readings, which have the least proportional noise
        let mut squares: Vec<f64> = first.left[..count / 2].iter().map(|v| v * v).collect();
        squares.sort_unstable_by(f64::total_cmp);
        let free = 1.0 - self.electrodes.len() as f64 / count as f64;
        let noise = (squares[squares.len() / 2] / (MEDIAN_SQUARE * free)).sqrt();
        let known = noise.max(least);
        found.noise = Some(known);
        if let Some(stated) = stated {
            let ratio = noise / stated;
            if !(NOISE_RATIO.recip()..=NOISE_RATIO).contains(&ratio) {
                found.doubts.push(Doubt::Noise { ratio });
            }
        }
        let Some(fit) = self.fit(&values, known) else {
            return found;
        };
        let noisiest = self.noisiest(&fit.left, known);
        if let Some((pair, ratio)) = noisiest.filter(|one| one.1 > NOISY_PAIR) {
            found.doubts.push(Doubt::NoisyPair {
                electrode: self.electrodes[pair],
                ratio: ratio.sqrt(),
            });
            return found; // a noisy pair would also look like a gain
        }
        if fit.explained > GAINS * self.electrodes.len() as f64 {
            let gains = DVector::from_vec(fit.gains);
            let most = gains.iamax();
            let energy: f64 = self
                .differences
                .iter()
                .map(|one| {
                    (0..2)
                        .map(|k| one.slopes[k] * gains[one.drives[k]])
                        .sum::<f64>()
                        .powi(2)
                })
                .sum();
            found.doubts.push(Doubt::Gains {
                electrode: self.electrodes[most],
                gain: gains[most],
                share: (energy / count as f64).sqrt() / size,
            });
        }
        found
    }

    fn variance(&self, one: &Difference, noise: f64) -> f64 {
        noise * noise + (PROPORTIONAL * one.size).powi(2)
    }

    /// The gains that explain the differences best, at this white noise; `None` if they cannot be computed.
    fn fit(&self, values: &[f64], noise: f64) -> Option<GainFit> {
        let count = self.electrodes.len();
        let mut normal = DMatrix::zeros(count, count);
        let mut right = vec![0.0; count];
        for (one, value) in self.differences.iter().zip(values) {
            let weight = self.variance(one, noise).recip();
            for k in 0..2 {
                right[one.drives[k]] += weight * one.slopes[k] * value;
                for l in 0..2 {
                    normal[(one.drives[k], one.drives[l])] +=
                        weight * one.slopes[k] * one.slopes[l];
                }
            }
        }
        // a gain common to all injections is reciprocal, so no difference determines it
        let ridge = 1e-9 * normal.trace() / count as f64;
        for k in 0..count {
            normal[(k, k)] += ridge;
        }
        let gains = dense::solve_definite(&normal, &right)?;
        let left = self
            .differences
            .iter()
            .zip(values)
            .map(|(one, value)| {
                value
                    - (0..2)
                        .map(|k| one.slopes[k] * gains[one.drives[k]])
                        .sum::<f64>()
            })
            .collect();
        Some(GainFit {
            explained: gains.iter().zip(&right).map(|(gain, b)| gain * b).sum(),
            gains,
            left,
        })
    }

    /// The pair of electrodes with the largest mean square of its differences, in units of their noise.
    fn noisiest(&self, left: &[f64], noise: f64) -> Option<(usize, f64)> {
        let mut sums = vec![(0.0, 0_u32); self.electrodes.len()];
        for (one, value) in self.differences.iter().zip(left) {
            for &drive in &one.drives {
                sums[drive].0 += value * value / self.variance(one, noise);
                sums[drive].1 += 1;
            }
        }
        sums.into_iter()
            .enumerate()
            .filter(|(_, (_, count))| *count > 0)
            .map(|(pair, (sum, count))| (pair, sum / f64::from(count)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
    }
}
