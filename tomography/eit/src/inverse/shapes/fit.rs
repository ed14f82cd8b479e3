//! Fits shapes to a frame: Levenberg-Marquardt with the full forward model.

use std::collections::BTreeMap;

use crate::ForwardError;
use nalgebra::{DMatrix, DVector};

use super::coverage::Cover;
use super::model::{SheetModel, Solved};
use super::shape::Shape;

/// A frame's change, weighted by the deviation of each reading.
pub(crate) struct Data {
    /// change / deviation.
    pub(crate) white: DVector<f64>,
    /// 1 / deviation.
    pub(crate) weights: DVector<f64>,
}

/// A fit of shapes at a local minimum.
#[derive(Clone)]
pub(crate) struct Fit {
    pub(crate) shapes: Vec<Shape>,
    /// Half the sum of squares of the whitened residual, and the same with the prior's penalty.
    pub(crate) misfit: f64,
    pub(crate) objective: f64,
    pub(crate) residual: DVector<f64>,
    /// J'J plus prior at the minimum.
    pub(crate) hessian: DMatrix<f64>,
}

pub(crate) struct Problem<'a> {
    pub(crate) model: &'a SheetModel,
    pub(crate) cover: &'a Cover,
}

impl Problem<'_> {
    /// The relative change of each triangle of the region.
    pub(crate) fn map(&self, shapes: &[Shape]) -> Vec<f64> {
        let mut kept = vec![1.0; self.model.mesh.region().len()];
        for shape in shapes {
            let loss = shape.loss();
            for (t, share) in self.cover.of(&shape.outline()) {
                kept[t as usize] *= 1.0 - loss * share;
            }
        }
        kept.iter().map(|kept| kept - 1.0).collect()
    }

    fn evaluate(
        &self,
        data: &Data,
        shapes: &[Shape],
    ) -> Result<(Solved, DVector<f64>, f64, f64), ForwardError> {
        let solved = self.model.solve(&self.map(shapes))?;
        let seen = DVector::from_column_slice(&solved.change).component_mul(&data.weights);
        let residual = &data.white - seen;
        let misfit = 0.5 * residual.norm_squared();
        let prior: f64 = shapes
            .iter()
            .flat_map(|shape| {
                shape.theta.iter().enumerate().map(|(p, value)| {
                    let (w, c) = shape.prior(p);
                    0.5 * w * (value - c).powi(2)
                })
            })
            .sum();
        Ok((solved, residual, misfit, misfit + prior))
    }

    fn sensitivity(
        &self,
        data: &Data,
        shapes: &[Shape],
        solved: &Solved,
    ) -> Result<DMatrix<f64>, ForwardError> {
        const STEP: f64 = 1e-3;
        let mut kept = vec![1.0; self.model.mesh.region().len()];
        let covers: Vec<Vec<(u32, f64)>> = shapes
            .iter()
            .map(|shape| {
                let covered = self.cover.of(&shape.outline());
                for &(t, share) in &covered {
                    kept[t as usize] *= 1.0 - shape.loss() * share;
                }
                covered
            })
            .collect();
        let mut directions: BTreeMap<u32, Vec<(usize, f64)>> = BTreeMap::new();
        let mut column = 0;
        for (shape, covered) in shapes.iter().zip(&covers) {
            let loss = shape.loss();
            let here: BTreeMap<u32, f64> = covered.iter().copied().collect();
            let others = |t: u32| {
                let own = 1.0 - loss * here.get(&t).copied().unwrap_or(0.0);
                kept[t as usize] / own
            };
            for parameter in 0..shape.theta.len() {
                if parameter + 1 == shape.theta.len() {
                    let slope = loss * (1.0 - loss);
                    for &(t, share) in covered {
                        directions
                            .entry(t)
                            .or_default()
                            .push((column, -others(t) * share * slope));
                    }
                } else {
                    let mut change: BTreeMap<u32, f64> = BTreeMap::new();
                    for sign in [1.0, -1.0] {
                        let mut moved = shape.clone();
                        moved.theta[parameter] += sign * STEP;
                        for (t, share) in self.cover.of(&moved.outline()) {
                            *change.entry(t).or_default() += sign * share / (2.0 * STEP);
                        }
                    }
                    for (t, slope) in change {
                        if slope.abs() > 1e-12 {
                            directions
                                .entry(t)
                                .or_default()
                                .push((column, -others(t) * loss * slope));
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

    /// Takes at most `steps` steps from a start, including rejected ones.
    pub(crate) fn fit(
        &self,
        data: &Data,
        start: &[Shape],
        steps: usize,
        done: f64,
    ) -> Result<Fit, ForwardError> {
        let mut shapes = start.to_vec();
        let (mut solved, mut residual, mut misfit, mut objective) = self.evaluate(data, &shapes)?;
        let count: usize = shapes.iter().map(|shape| shape.theta.len()).sum();
        let priors = |shapes: &[Shape]| -> (DVector<f64>, DVector<f64>) {
            let mut weights = Vec::with_capacity(count);
            let mut pull = Vec::with_capacity(count);
            for shape in shapes {
                for (p, value) in shape.theta.iter().enumerate() {
                    let (w, c) = shape.prior(p);
                    weights.push(w);
                    pull.push(w * (value - c));
                }
            }
            (DVector::from_vec(weights), DVector::from_vec(pull))
        };
        let mut damping = 1e-2;
        let mut j = self.sensitivity(data, &shapes, &solved)?;
        let mut hessian = DMatrix::zeros(count, count);
        for _ in 0..steps {
            let (weights, pull) = priors(&shapes);
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
            let mut next = shapes.clone();
            let mut at = 0;
            for shape in &mut next {
                let last = shape.theta.len() - 1;
                for value in &mut shape.theta {
                    *value += step[at];
                    at += 1;
                }
                shape.theta[2] = shape.theta[2].clamp(-4.5, 6.0);
                shape.theta[last] = shape.theta[last].clamp(-5.0, 7.0);
            }
            let (s, r, m, o) = self.evaluate(data, &next)?;
            if o < objective {
                let gain = objective - o;
                (shapes, solved, residual, misfit, objective) = (next, s, r, m, o);
                j = self.sensitivity(data, &shapes, &solved)?;
                damping = (damping * 0.25).max(1e-6);
                if gain < done {
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
            shapes,
            misfit,
            objective,
            residual,
            hessian,
        })
    }
}
