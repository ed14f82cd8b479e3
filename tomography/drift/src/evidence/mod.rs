//! Estimates the size of each kind of change from one frame: the sizes that make its data most probable. The drift in
//! that frame is computed in `frame`.

mod any_shape;
mod frame;

use nalgebra::{DMatrix, DVector};

use crate::DriftError;
use crate::model::DriftModel;
use crate::sizes::Sizes;
use crate::whitened::Whitened;
use any_shape::Prior;
pub use frame::{FrameDrift, MapDeviation};

/// Standard deviation of the change of ln gain in one frame: practically free.
const FREE_GAIN: f64 = 0.1;
/// Number of grid points of each size, and their range.
const CONTACT: (usize, [f64; 2]) = (9, [3e-3, 0.5]);
const FIELD: (usize, [f64; 2]) = (9, [1e-5, 0.03]);
const LOAD: (usize, [f64; 2]) = (7, [3e-3, 1.0]);
/// Size used for a kind of change whose size is unknown.
const PROJECTED: f64 = 10.0;
const LOG_2PI: f64 = 1.837_877_066_409_345_3;

/// The drift since the baseline, as assessed from one frame.
#[derive(Debug, Clone)]
pub struct Assessed {
    /// Most probable sizes; `local` is the size of the load, which the covariance of the drift does not include.
    pub sizes: Sizes,
    /// Data whitened by noise and drift.
    pub whitened: Whitened,
    /// Improvement of chi squared by the best disc of the load test.
    pub score: f64,
    /// Number of evaluations of the likelihood.
    pub evaluations: usize,
}

fn grid((count, [low, high]): (usize, [f64; 2]), index: usize) -> f64 {
    low * (high / low).powf(index as f64 / (count - 1) as f64)
}

impl DriftModel {
    /// Finds the sizes of drift and load that make the data most probable, by steps along the axes of a logarithmic
    /// grid, and whitens the data by noise and drift. The noise of the baseline and that of the frame are independent.
    ///
    /// # Errors
    /// Data that are not finite.
    pub fn assess(&self, data: &DVector<f64>, rows: &[usize]) -> Result<Assessed, DriftError> {
        let noise = &self.noise * 2.0;
        let load = &self.local_gram;
        let (sizes, evaluations) = self.most_probable(Prior::Kinds, data, &noise, load, rows)?;
        let drift = Prior::Kinds.covariance(self, &sizes);
        let whitened = Whitened::new(&(noise + drift), data, rows)?;
        let score = whitened.load_test(self).map_or(0.0, |found| found.score);
        Ok(Assessed {
            sizes,
            whitened,
            score,
            evaluations,
        })
    }

    /// The sizes that make the data most probable if a load of size 1 has the covariance `load`, and the number of
    /// evaluations of the likelihood.
    fn most_probable(
        &self,
        prior: Prior<'_>,
        data: &DVector<f64>,
        noise: &DMatrix<f64>,
        load: &DMatrix<f64>,
        rows: &[usize],
    ) -> Result<(Sizes, usize), DriftError> {
        let mut known = std::collections::BTreeMap::<[usize; 3], f64>::new();
        // if the covariance of the drift is known, only the size of the load is searched
        let counts = match prior {
            Prior::Kinds => [CONTACT.0, FIELD.0, LOAD.0],
            Prior::Covariance(_) => [1, 1, LOAD.0],
        };
        let sizes = |[contact, field, load]: [usize; 3]| Sizes {
            gain: FREE_GAIN,
            contact: grid(CONTACT, contact),
            field: grid(FIELD, field),
            local: grid(LOAD, load),
        };
        let mut value = |at: [usize; 3]| -> Result<f64, DriftError> {
            if let Some(value) = known.get(&at) {
                return Ok(*value);
            }
            let covariance = noise + prior.with_load(self, &sizes(at), load);
            let found = log_likelihood(data, &covariance, rows)?;
            known.insert(at, found);
            Ok(found)
        };
        let mut best = [4.min(counts[0] - 1), 3.min(counts[1] - 1), 3];
        let mut most = value(best)?;
        loop {
            let before = best;
            for axis in 0..3 {
                for step in [1_isize, -1] {
                    loop {
                        let mut next = best;
                        let Some(moved) = best[axis].checked_add_signed(step) else {
                            break;
                        };
                        next[axis] = moved;
                        if moved >= counts[axis] {
                            break;
                        }
                        let found = value(next)?;
                        if found <= most {
                            break;
                        }
                        (best, most) = (next, found);
                    }
                }
            }
            if best == before {
                break;
            }
        }
        Ok((sizes(best), known.len()))
    }

    /// Data whitened by noise alone, after projecting out gain and contacts, whose sizes are taken as unknown.
    ///
    /// # Errors
    /// Data that are not finite.
    pub fn projected(&self, data: &DVector<f64>, rows: &[usize]) -> Result<Whitened, DriftError> {
        let v = &self.fit().readings;
        let contacts = &self.contact_gram * PROJECTED.powi(2);
        let covariance = &self.noise * 2.0 + (v * v.transpose()) * PROJECTED.powi(2) + contacts;
        Whitened::new(&covariance, data, rows)
    }
}

/// ln N(data; 0, covariance), using only these rows.
pub(crate) fn log_likelihood(
    data: &DVector<f64>,
    covariance: &DMatrix<f64>,
    rows: &[usize],
) -> Result<f64, DriftError> {
    let white = Whitened::new(covariance, data, rows)?;
    let terms = white.log_determinant() + white.data().norm_squared();
    Ok(-0.5 * (terms + rows.len() as f64 * LOG_2PI))
}
