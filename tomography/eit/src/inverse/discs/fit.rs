//! Fits discs to a frame: Levenberg-Marquardt with the full forward model.

use std::collections::BTreeMap;

use crate::ForwardError;
use nalgebra::{DMatrix, DVector};

use super::coverage::Cover;
use super::disc::{Disc, PARAMETERS};
use super::model::{SheetModel, Solved};

/// Most steps of a fit.
const STEPS: usize = 12;
/// A fit ends when a step improves the objective by less than this.
const DONE: f64 = 0.05;
/// A fit is given up if it leaves more than this many times the misfit that is wanted, and a step improves it by less than the
/// share `SLOW`.
const FAR: f64 = 4.0;
const SLOW: f64 = 0.1;

/// The change of a frame in deviations of a reading; missing readings are 0.
pub(crate) struct Data {
    pub(crate) white: DVector<f64>,
    /// 1 / deviation; 0 for missing readings.
    pub(crate) weights: DVector<f64>,
}

/// A fit of discs at a local minimum.
#[derive(Clone)]
pub(crate) struct Fit {
    pub(crate) discs: Vec<Disc>,
    /// Half the sum of squares of the whitened residual.
    pub(crate) misfit: f64,
    /// J'J plus prior at the minimum.
    pub(crate) hessian: DMatrix<f64>,
}

pub(crate) struct Problem<'a> {
    pub(crate) model: &'a SheetModel,
    pub(crate) cover: &'a Cover,
}

impl Problem<'_> {
    /// The relative change of each triangle of the region. A triangle that is covered in part has the geometric mean of both
    /// conductances: current crosses borders in all directions, and the arithmetic mean would leave four times the error.
    pub(crate) fn map(&self, discs: &[Disc]) -> Vec<f64> {
        let mut kept = vec![1.0; self.model.mesh.region().len()];
        for disc in discs {
            for (t, share) in self.cover.of(&disc.outline()) {
                kept[t as usize] *= (1.0 - disc.loss()).powf(share);
            }
        }
        kept.iter().map(|kept| kept - 1.0).collect()
    }

    fn evaluate(
        &self,
        data: &Data,
        discs: &[Disc],
    ) -> Result<(Solved, DVector<f64>, f64, f64), ForwardError> {
        let solved = self.model.solve(&self.map(discs))?;
        let seen = DVector::from_column_slice(&solved.change).component_mul(&data.weights);
        let residual = &data.white - seen;
        let misfit = 0.5 * residual.norm_squared();
        let prior: f64 = discs
            .iter()
            .flat_map(|disc| {
                disc.theta.iter().enumerate().map(|(p, value)| {
                    let (w, c) = Disc::prior(p);
                    0.5 * w * (value - c).powi(2)
                })
            })
            .sum();
        Ok((solved, residual, misfit, misfit + prior))
    }

    fn sensitivity(
        &self,
        data: &Data,
        discs: &[Disc],
        solved: &Solved,
    ) -> Result<DMatrix<f64>, ForwardError> {
        const STEP: f64 = 1e-3;
        let mut kept = vec![1.0; self.model.mesh.region().len()];
        let covers: Vec<Vec<(u32, f64)>> = discs
            .iter()
            .map(|disc| {
                let covered = self.cover.of(&disc.outline());
                for &(t, share) in &covered {
                    kept[t as usize] *= (1.0 - disc.loss()).powf(share);
                }
                covered
            })
            .collect();
        let mut directions: BTreeMap<u32, Vec<(usize, f64)>> = BTreeMap::new();
        let mut column = 0;
        for (disc, covered) in discs.iter().zip(&covers) {
            let log = (1.0 - disc.loss()).ln();
            for parameter in 0..PARAMETERS {
                if parameter + 1 == PARAMETERS {
                    for &(t, share) in covered {
                        let slope = -kept[t as usize] * share * disc.loss();
                        directions.entry(t).or_default().push((column, slope));
                    }
                } else {
                    let mut change: BTreeMap<u32, f64> = BTreeMap::new();
                    for sign in [1.0, -1.0] {
                        let mut moved = disc.clone();
                        moved.theta[parameter] += sign * STEP;
                        for (t, share) in self.cover.of(&moved.outline()) {
                            *change.entry(t).or_default() += sign * share / (2.0 * STEP);
                        }
                    }
                    for (t, slope) in change {
                        if slope.abs() > 1e-12 {
                            let slope = kept[t as usize] * log * slope;
                            directions.entry(t).or_default().push((column, slope));
                        }
                    }
                }
                column += 1;
            }
        }
        let mut j = self.model.along(solved, &directions, column)?;
        for mut column in j.column_iter_mut() {
            column.component_mul_assign(&data.weights);
        }
        Ok(j)
    }

    /// Takes at most [`STEPS`] steps from a start, including rejected ones; fewer where the misfit will not become as small as
    /// `wanted`.
    pub(crate) fn fit(
        &self,
        data: &Data,
        start: &[Disc],
        wanted: f64,
    ) -> Result<Fit, ForwardError> {
        let mut discs = start.to_vec();
        let (mut solved, mut residual, mut misfit, mut objective) = self.evaluate(data, &discs)?;
        let count = PARAMETERS * discs.len();
        let priors = |discs: &[Disc]| -> (DVector<f64>, DVector<f64>) {
            let mut weights = Vec::with_capacity(count);
            let mut pull = Vec::with_capacity(count);
            for disc in discs {
                for (p, value) in disc.theta.iter().enumerate() {
                    let (w, c) = Disc::prior(p);
                    weights.push(w);
                    pull.push(w * (value - c));
                }
            }
            (DVector::from_vec(weights), DVector::from_vec(pull))
        };
        let mut damping = 1e-2;
        let mut j = self.sensitivity(data, &discs, &solved)?;
        let mut hessian = DMatrix::zeros(count, count);
        for _ in 0..STEPS {
            let (weights, pull) = priors(&discs);
            hessian = j.tr_mul(&j);
            for p in 0..count {
                hessian[(p, p)] += weights[p];
            }
            let right = j.tr_mul(&residual) - pull;
            let mut damped = hessian.clone();
            for p in 0..count {
                damped[(p, p)] += damping * hessian[(p, p)] + 1e-3 + damping;
            }
            let Some(factor) = damped.cholesky() else {
                break;
            };
            let mut step = factor.solve(&right);
            // at most 1.5 cm, one unit of a logit or one radian per step
            let largest = step.amax();
            if largest > 1.5 {
                step *= 1.5 / largest;
            }
            let mut next = discs.clone();
            let mut at = 0;
            for disc in &mut next {
                for value in &mut disc.theta {
                    *value += step[at];
                    at += 1;
                }
                disc.theta[2] = disc.theta[2].clamp(-4.5, 6.0);
                disc.theta[3] = disc.theta[3].clamp(-5.0, 7.0);
            }
            let (s, r, m, o) = self.evaluate(data, &next)?;
            if o < objective {
                let gain = objective - o;
                (discs, solved, residual, misfit, objective) = (next, s, r, m, o);
                j = self.sensitivity(data, &discs, &solved)?;
                damping = (damping * 0.25).max(1e-6);
                if gain < DONE || misfit > FAR * wanted && gain < SLOW * misfit {
                    break;
                }
            } else {
                damping *= 6.0;
                if damping > 1e4 {
                    break;
                }
            }
        }
        Ok(Fit {
            discs,
            misfit,
            hessian,
        })
    }
}
