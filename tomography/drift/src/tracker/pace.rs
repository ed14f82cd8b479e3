//! Estimates how fast this sheet drifts, relative to the built-in rates, from the likelihood of the frames without
//! load.
//!
//! A separate filter tracks the sheet at each pace of a grid, in coordinates in which drift and noise are uncorrelated.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use super::bits;
use crate::basis::Basis;

/// Paces that are compared.
pub(crate) const PACES: [f64; 6] = [0.3, 1.0, 2.0, 3.0, 5.0, 10.0];
/// Days before the first choice of a pace, and between choices.
const FIRST_DAYS: f64 = 0.5;
const EVERY_DAYS: f64 = 1.0;
/// Weight of the earlier likelihood at each choice: the pace of a sheet may change.
const REMEMBERED: f64 = 0.5;
const DAY_S: f64 = 86_400.0;

/// The filters of all paces.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Pace {
    filters: Vec<Filter>,
    /// Time of the last frame, s.
    #[serde(with = "bits::number")]
    last_s: f64,
    /// Time of the last choice, s; frames so far.
    #[serde(with = "bits::number")]
    chosen_s: f64,
    frames: u32,
    chosen_before: bool,
    #[serde(with = "bits::number")]
    pub(crate) pace: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Filter {
    #[serde(with = "bits")]
    mean: Vec<f64>,
    #[serde(with = "bits")]
    variance: Vec<f64>,
    #[serde(with = "bits::number")]
    likelihood: f64,
}

impl Filter {
    /// Updates the filter with data of noise 1, after the variances grew by `rate` times `growth`.
    fn follow(&mut self, data: &[f64], growth: &[f64], rate: f64) {
        // one logarithm for eight variances, whose product is finite at any age of a sheet
        const TOGETHER: usize = 8;
        let state = self.mean.chunks_mut(TOGETHER);
        let state = state.zip(self.variance.chunks_mut(TOGETHER));
        let input = data.chunks(TOGETHER).zip(growth.chunks(TOGETHER));
        let mut sum = 0.0;
        for ((mean, kept), (data, growth)) in state.zip(input) {
            let mut determinant = 1.0;
            for k in 0..data.len() {
                let predicted = kept[k] + rate * growth[k];
                let (variance, error) = (predicted + 1.0, data[k] - mean[k]);
                determinant *= variance;
                sum += error * error / variance;
                let gain = predicted / variance;
                mean[k] += gain * error;
                kept[k] = gain; // predicted (1 - gain), in units of the noise
            }
            sum += determinant.ln();
        }
        self.likelihood -= 0.5 * sum;
    }
}

impl Pace {
    /// Starts at a baseline (data zero, with the noise of one frame) at this time, s.
    pub(crate) fn new(rows: usize, at_s: f64) -> Self {
        let filter = Filter {
            mean: vec![0.0; rows],
            variance: vec![1.0; rows],
            likelihood: 0.0,
        };
        Self {
            filters: vec![filter; PACES.len()],
            last_s: at_s,
            chosen_s: at_s,
            frames: 0,
            chosen_before: false,
            pace: 1.0,
        }
    }

    /// Whether there is a filter for each pace, with this number of rows.
    pub(super) fn fits(&self, rows: usize) -> bool {
        let fits = |filter: &Filter| filter.mean.len() == rows && filter.variance.len() == rows;
        self.filters.len() == PACES.len() && self.filters.iter().all(fits)
    }

    /// Updates the filters with a frame without load, in the coordinates of the basis; returns the pace if it was
    /// chosen anew.
    pub(crate) fn follow(&mut self, basis: &Basis, data: &DVector<f64>, at_s: f64) -> Option<f64> {
        let days = ((at_s - self.last_s) / DAY_S).max(0.0);
        self.last_s = at_s;
        self.frames += 1;
        for (filter, pace) in self.filters.iter_mut().zip(PACES) {
            filter.follow(data.as_slice(), basis.growth.as_slice(), pace * pace * days);
        }
        let wait = if self.chosen_before {
            EVERY_DAYS
        } else {
            FIRST_DAYS
        };
        if at_s - self.chosen_s < wait * DAY_S || self.frames < 12 {
            return None;
        }
        (self.chosen_s, self.chosen_before) = (at_s, true);
        let (best, _) = self
            .filters
            .iter()
            .enumerate()
            .max_by(|a, b| a.1.likelihood.total_cmp(&b.1.likelihood))?;
        for filter in &mut self.filters {
            filter.likelihood *= REMEMBERED;
        }
        self.pace = PACES[best];
        Some(self.pace)
    }

    /// Starts again at a new baseline, given in the coordinates of the basis, with the noise of one frame: the change
    /// since the last frame is not drift.
    pub(crate) fn begin_again(&mut self, data: &DVector<f64>, at_s: f64) {
        for filter in &mut self.filters {
            filter.mean.copy_from_slice(data.as_slice());
            filter.variance.fill(1.0);
        }
        self.last_s = at_s;
    }

    /// The clock was set back to this time: the interval to the next choice starts there.
    pub(crate) fn set_back(&mut self, at_s: f64) {
        self.chosen_s = self.chosen_s.min(at_s);
    }

    /// Adds local change of this standard deviation to the variances: after a load.
    pub(crate) fn changed_locally(&mut self, basis: &Basis, size: f64) {
        for filter in &mut self.filters {
            for (variance, local) in filter.variance.iter_mut().zip(&basis.local) {
                *variance += size * size * local;
            }
        }
    }
}
