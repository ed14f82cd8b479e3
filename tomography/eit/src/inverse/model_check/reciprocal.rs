//! The differences of reciprocal readings: noise, pairs that are noisier than the others, and gains of injections.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use survey::{Doubt, Protocol};

use super::NOISE_RATIO;
use crate::inverse::learned::linear::Linear;

/// Fewest differences from which anything is concluded.
const FEWEST: usize = 30;
/// Median of the square of a standard normal number.
const MEDIAN_SQUARE: f64 = 0.454_936;
/// Mean square of a pair's differences over that of all above which the pair is noisier: once in 10^9 frames of 23 white
/// differences a pair.
const NOISY_PAIR: f64 = 5.0;
/// Mean square of the components that gains explain, over the noise's, above which gains have changed: with 25 gains and
/// white noise of 274 degrees of freedom, once in 10^8 frames.
const GAINS: f64 = 4.0;

/// The rotated differences of the twins that are both valid.
pub(super) struct Reciprocal {
    /// Indices of both twins, and their shares in the difference.
    pairs: Vec<([usize; 2], [f64; 2])>,
    /// Index of the pair of electrodes that drives the first, and the second.
    drives: Vec<[usize; 2]>,
    /// First electrode of each pair.
    electrodes: Vec<survey::Electrode>,
    /// Orthonormal basis of the changes by gains, and the pseudo-inverse that gives them.
    basis: DMatrix<f64>,
    inverse: DMatrix<f64>,
}

/// What the differences say.
pub(super) struct Found {
    /// Standard deviation of a difference; `None` if there are too few.
    pub(super) noise: Option<f64>,
    pub(super) doubts: Vec<Doubt>,
}

impl Reciprocal {
    /// Noise of the most exact instruments, as a share of the readings' rms: less is rounding.
    pub(super) const RESOLUTION: f64 = 1e-7;

    pub(super) fn new(protocol: &Protocol, linear: &Linear, missing: &[usize]) -> Self {
        let twins = protocol.reciprocal_twins();
        let valid = |reading: usize| missing.binary_search(&reading).is_err();
        let mut numbers = BTreeMap::new();
        let mut electrodes = Vec::new();
        let (mut pairs, mut drives) = (Vec::new(), Vec::new());
        for (first, question) in protocol.measurements().iter().enumerate() {
            let Some(second) = twins[first].filter(|&second| second > first) else {
                continue;
            };
            if !(valid(first) && valid(second)) || twins[second] != Some(first) {
                continue;
            }
            let (_, share) = linear.fold.row(first);
            let (_, other) = linear.fold.row(second);
            pairs.push(([first, second], [other, -share]));
            let reverse = protocol.measurements()[second];
            drives.push([question.drive, reverse.drive].map(|drive| {
                let next = numbers.len();
                *numbers.entry(drive).or_insert_with(|| {
                    electrodes.push(drive.plus);
                    next
                })
            }));
        }
        let model = linear.readings();
        let mut gains = DMatrix::zeros(pairs.len(), electrodes.len());
        for (row, ((readings, shares), drives)) in pairs.iter().zip(&drives).enumerate() {
            for k in 0..2 {
                gains[(row, drives[k])] += shares[k] * model[readings[k]];
            }
        }
        let (basis, inverse) = match pairs.len() < FEWEST + electrodes.len() {
            true => (
                DMatrix::zeros(pairs.len(), 0),
                DMatrix::zeros(electrodes.len(), pairs.len()),
            ),
            false => by_gains(gains),
        };
        Self {
            pairs,
            drives,
            electrodes,
            basis,
            inverse,
        }
    }

    /// `change` at the model's scale; `stated`: standard deviation of a change; `least`: the smallest noise that is not
    /// rounding; `size`: rms of the change.
    pub(super) fn of(&self, change: &[f64], stated: Option<f64>, least: f64, size: f64) -> Found {
        let mut found = Found {
            noise: None,
            doubts: Vec::new(),
        };
        if self.pairs.len() < FEWEST + self.electrodes.len() {
            return found;
        }
        let differences = DVector::from_iterator(
            self.pairs.len(),
            self.pairs
                .iter()
                .map(|([a, b], [p, q])| p * change[*a] + q * change[*b]),
        );
        let along = self.basis.tr_mul(&differences);
        let left = &differences - &self.basis * &along;
        let mut squares: Vec<f64> = left.iter().map(|value| value * value).collect();
        squares.sort_unstable_by(f64::total_cmp);
        // gains take degrees of freedom from every difference alike
        let free = 1.0 - along.len() as f64 / left.len() as f64;
        let noise = (squares[squares.len() / 2] / (MEDIAN_SQUARE * free)).sqrt();
        let known = noise.max(least);
        found.noise = Some(known);
        if let Some(stated) = stated {
            let ratio = noise / stated;
            if !(NOISE_RATIO.recip()..=NOISE_RATIO).contains(&ratio) {
                found.doubts.push(Doubt::Noise { ratio });
            }
        }
        if let Some((pair, ratio)) = self.noisiest(&left, known).filter(|one| one.1 > NOISY_PAIR) {
            found.doubts.push(Doubt::NoisyPair {
                electrode: self.electrodes[pair],
                ratio: ratio.sqrt(),
            });
            return found; // such a pair looks like a gain too
        }
        let gains = along.norm_squared() / along.len() as f64;
        if !along.is_empty() && gains > GAINS * known * known {
            let gains = &self.inverse * &differences;
            let most = gains.iamax();
            let beyond = along.norm_squared() - along.len() as f64 * known * known;
            found.doubts.push(Doubt::Gains {
                electrode: self.electrodes[most],
                gain: gains[most],
                share: (beyond / differences.len() as f64).sqrt() / size,
            });
        }
        found
    }

    /// The pair of electrodes with the largest mean square of its differences, over that of the noise.
    fn noisiest(&self, left: &DVector<f64>, noise: f64) -> Option<(usize, f64)> {
        let mut sums = vec![(0.0, 0); self.electrodes.len()];
        for (value, drives) in left.iter().zip(&self.drives) {
            for &drive in drives {
                sums[drive].0 += value * value;
                sums[drive].1 += 1;
            }
        }
        sums.into_iter()
            .enumerate()
            .filter(|(_, (_, count))| *count > 0)
            .map(|(pair, (sum, count))| (pair, sum / (f64::from(count) * noise * noise)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// An orthonormal basis of the differences that gains make (columns of `gains`), and the matrix that gives the gains.
fn by_gains(gains: DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
    let (rows, columns) = gains.shape();
    // a gain common to all injections is reciprocal: the singular value of that direction is zero
    let svd = gains.svd(true, true);
    let top = svd.singular_values.max();
    let kept: Vec<usize> = (0..svd.singular_values.len())
        .filter(|&k| svd.singular_values[k] > 1e-6 * top)
        .collect();
    let (Some(u), Some(v_t)) = (&svd.u, &svd.v_t) else {
        return (DMatrix::zeros(rows, 0), DMatrix::zeros(columns, rows));
    };
    let basis = u.select_columns(&kept);
    let mut scaled = v_t.select_rows(&kept);
    for (row, &k) in kept.iter().enumerate() {
        scaled.row_mut(row).unscale_mut(svd.singular_values[k]);
    }
    let inverse = scaled.tr_mul(&basis.transpose());
    (basis, inverse)
}
