//! Distribution of a network's training inputs: mean and covariance, and the distance of an input from them.

use nalgebra::DMatrix;

use crate::linear_algebra::dense;

/// Share of the training inputs that count as familiar; the others have novelty 1 or more.
pub const FAMILIAR_SHARE: f64 = 0.999;

/// Principal directions of the covariance that are kept; the others are treated together.
const DIRECTIONS: usize = 128;
/// Rows per task.
const CHUNK: usize = 1000;

/// The training inputs as a normal distribution.
///
/// d^2 = (sum_j (u_j (x - m) / s_j)^2 + |r|^2 / s_r^2) / (k + 1): the Mahalanobis distance with k directions of the
/// covariance, r the rest of x - m outside of them and s_r its root mean square. Novelty is d over the distance within
/// which [`FAMILIAR_SHARE`] of the training inputs lie.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingDistribution {
    pub(crate) mean: Vec<f32>,
    /// Principal directions, one per row, divided by their deviations.
    pub(crate) directions: Vec<f32>,
    /// Deviation of each direction; the last entry is that of the remainder.
    pub(crate) deviations: Vec<f32>,
    /// Distance within which the familiar inputs lie.
    pub(crate) limit: f32,
}

impl TrainingDistribution {
    /// Estimates the distribution of inputs, rows of `width`. `None` if all are equal.
    pub fn learn(inputs: &[f32], width: usize) -> Option<Self> {
        let count = inputs.len() / width;
        if count < 2 {
            return None;
        }
        let mut mean = vec![0.0_f64; width];
        for row in inputs.chunks_exact(width) {
            for (mean, value) in mean.iter_mut().zip(row) {
                *mean += f64::from(*value) / count as f64;
            }
        }
        let mut covariance = DMatrix::zeros(width, width);
        for chunk in inputs.chunks(CHUNK * width) {
            let centred: Vec<f64> = chunk
                .chunks_exact(width)
                .flat_map(|row| row.iter().zip(&mean).map(|(v, m)| f64::from(*v) - m))
                .collect();
            let columns = DMatrix::from_vec(width, centred.len() / width, centred);
            covariance += dense::gram(&columns, |_| Some(1.0 / count as f64));
        }
        let (values, vectors) = dense::symmetric_eigen(&covariance)?;
        let top = *values.last()?;
        if !(top > 0.0 && top.is_finite()) {
            return None;
        }
        // the largest, down to the rounding error
        let kept: Vec<usize> = (0..width)
            .rev()
            .take(DIRECTIONS)
            .take_while(|&j| values[j] > 1e-12 * top)
            .collect();
        let rest: f64 = (0..width - kept.len()).map(|j| values[j].max(0.0)).sum();
        let mut deviations: Vec<f64> = kept.iter().map(|&j| values[j].sqrt()).collect();
        deviations.push(rest.sqrt().max(1e-6 * top.sqrt()));
        let directions = kept
            .iter()
            .zip(&deviations)
            .flat_map(|(&j, deviation)| {
                vectors
                    .column(j)
                    .iter()
                    .map(move |u| (u / deviation) as f32)
                    .collect::<Vec<_>>()
            })
            .collect();
        let mut familiar = Self {
            mean: mean.into_iter().map(|value| value as f32).collect(),
            directions,
            deviations: deviations.into_iter().map(|value| value as f32).collect(),
            limit: 1.0,
        };
        let mut distances: Vec<f64> = inputs
            .chunks_exact(width)
            .map(|row| familiar.distance(row))
            .collect();
        distances.sort_by(f64::total_cmp);
        let last = ((count as f64 * FAMILIAR_SHARE) as usize).min(count - 1);
        familiar.limit = distances[last] as f32;
        familiar.is_sound(width).then_some(familiar)
    }

    /// Whether the parts have consistent sizes, fit `width` readings, and are finite.
    pub(crate) fn is_sound(&self, width: usize) -> bool {
        let Some(kept) = self.deviations.len().checked_sub(1) else {
            return false;
        };
        self.mean.len() == width
            && self.directions.len() == kept * width
            && self
                .mean
                .iter()
                .chain(&self.directions)
                .all(|value| value.is_finite())
            && self
                .deviations
                .iter()
                .chain([&self.limit])
                .all(|value| value.is_finite() && *value > 0.0)
    }

    /// Novelty of an input: at most 1 within the training distribution. Missing readings are replaced by their means.
    pub fn novelty(&self, input: &[f32]) -> f64 {
        self.distance(input) / f64::from(self.limit)
    }

    /// The mean of a reading over the training.
    pub(crate) fn usual(&self, reading: usize) -> f32 {
        self.mean[reading]
    }

    fn distance(&self, input: &[f32]) -> f64 {
        let centred: Vec<f32> = input.iter().zip(&self.mean).map(|(v, m)| v - m).collect();
        // subtracted direction by direction: a difference of squares would lose the remainder to rounding
        let mut rest: Vec<f64> = centred.iter().map(|v| f64::from(*v)).collect();
        let mut within = 0.0;
        for (direction, deviation) in self
            .directions
            .chunks_exact(centred.len())
            .zip(&self.deviations)
        {
            let mut lanes = [0.0_f32; 8];
            for (u, x) in direction.chunks(8).zip(centred.chunks(8)) {
                for (lane, (u, x)) in lanes.iter_mut().zip(u.iter().zip(x)) {
                    *lane += u * x;
                }
            }
            let along = f64::from(lanes.iter().sum::<f32>());
            within += along * along;
            let part = along * f64::from(*deviation).powi(2);
            for (rest, u) in rest.iter_mut().zip(direction) {
                *rest -= part * f64::from(*u);
            }
        }
        let parts = self.deviations.len();
        let outside: f64 = rest.iter().map(|value| value * value).sum();
        let outside = outside / f64::from(self.deviations[parts - 1]).powi(2);
        ((within + outside) / parts as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use crate::inverse::learned::network::training_distribution::*;

    #[test]
    fn what_was_seen_is_familiar_and_what_was_not_is_novel() {
        // 3 directions of very different size in 12 readings, and a little noise
        let wave = |i: usize, k: usize| ((i * (2 * k + 3)) as f32 * 0.618).sin();
        let noise = |i: usize, r: usize| {
            let mixed = (i * 12 + r + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            (mixed >> 40) as f32 / (1 << 23) as f32 - 1.0
        };
        let row = |i: usize| -> Vec<f32> {
            (0..12)
                .map(|r| {
                    let part = |k: usize| wave(i, k) * ((r * (k + 1)) as f32 * 0.5).cos();
                    part(0) + 0.1 * part(1) + 0.01 * part(2) + 1e-4 * noise(i, r)
                })
                .collect()
        };
        let inputs: Vec<f32> = (0..3000).flat_map(row).collect();
        let familiar = TrainingDistribution::learn(&inputs, 12).unwrap();
        let outside = (3000..6000)
            .filter(|i| familiar.novelty(&row(*i)) > 1.0)
            .count();
        assert!(outside < 15, "{outside}");
        let mut odd = row(7);
        odd[3] += 0.01; // a hundredth of the largest direction, in a reading that never varied
        assert!(familiar.novelty(&odd) > 3.0, "{}", familiar.novelty(&odd));
        let far: Vec<f32> = row(7).iter().map(|v| 20.0 * v).collect();
        assert!(familiar.novelty(&far) > 3.0);
    }

    #[test]
    fn distribution_without_deviations_is_not_sound() {
        let of = |deviations: Vec<f32>| TrainingDistribution {
            mean: vec![0.0; 4],
            directions: Vec::new(),
            deviations,
            limit: 1.0,
        };
        assert!(of(vec![1.0]).is_sound(4));
        assert!(!of(Vec::new()).is_sound(4));
    }

    #[test]
    fn nothing_is_learnt_from_copies() {
        assert!(TrainingDistribution::learn(&[0.5; 40], 4).is_none());
        assert!(TrainingDistribution::learn(&[0.5; 4], 4).is_none());
    }
}
