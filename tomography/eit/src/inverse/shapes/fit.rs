//! Fits shapes to a frame: Levenberg-Marquardt with the full forward model.

use crate::ForwardError;
use nalgebra::{DMatrix, DVector};

use super::coverage::Cover;
use super::model::{SheetModel, Solved};
use super::shape::{LOSS, Shape};

/// Most steps of a fit.
const STEPS: usize = 12;
/// A fit ends when a step improves the objective by less than this.
const DONE: f64 = 0.05;
/// A fit is abandoned if its misfit exceeds `FAR` times the wanted one and a step reduces the misfit by less than the
/// share `SLOW`.
const FAR: f64 = 4.0;
const SLOW: f64 = 0.1;
/// The likelihood is raised to the power 1 / `TEMPER`, because errors of the model are correlated between readings.
pub(super) const TEMPER: f64 = 4.0;
/// Logarithm of the number of folded readings of a frame with 26 electrodes.
const PARAMETER_COST: f64 = 5.7;

/// The change of a frame in deviations of a reading; missing readings are 0.
pub(crate) struct Data {
    pub(crate) white: DVector<f64>,
    /// 1 / deviation; 0 for missing readings.
    pub(crate) weights: DVector<f64>,
}

/// A fit is abandoned if its misfit exceeds a limit after this number of steps.
#[derive(Clone, Copy)]
pub(super) struct Hopeless {
    pub(super) after: usize,
    pub(super) misfit: f64,
}

impl Hopeless {
    pub(super) const NEVER: Self = Self {
        after: STEPS,
        misfit: f64::INFINITY,
    };
}

/// A fit of shapes at a local minimum.
#[derive(Clone)]
pub(crate) struct Fit {
    pub(crate) shapes: Vec<Shape>,
    /// Half the sum of squares of the whitened residual.
    pub(crate) misfit: f64,
    /// J'J plus prior at the minimum.
    pub(crate) hessian: DMatrix<f64>,
}

impl Fit {
    /// The name of the shapes in maps.
    pub(crate) fn name(&self) -> String {
        self.shapes[0].kind.name(self.shapes.len())
    }

    /// Negative logarithm of the fit's probability: its misfit, tempered like the posterior, and half of ln n for each
    /// parameter.
    pub(crate) fn cost(&self) -> f64 {
        self.misfit / TEMPER + 0.5 * self.hessian.nrows() as f64 * PARAMETER_COST
    }
}

pub(crate) struct Problem<'a> {
    pub(crate) model: &'a SheetModel,
    pub(crate) cover: &'a Cover,
}

impl Problem<'_> {
    /// The relative change of each triangle of the region. A partly covered triangle has the geometric mean of both
    /// conductances: current crosses borders in all directions, and the arithmetic mean would leave four times the
    /// error.
    pub(crate) fn map(&self, shapes: &[Shape]) -> Vec<f64> {
        let mut kept = vec![1.0; self.model.mesh.region().len()];
        for shape in shapes {
            self.take(shape, &mut kept);
        }
        kept.iter().map(|kept| kept - 1.0).collect()
    }

    /// Multiplies the remaining conductances by that of a shape.
    fn take(&self, shape: &Shape, kept: &mut [f64]) {
        let kept_within = 1.0 - shape.loss();
        for (outline, weight) in shape.layers() {
            let covered = kept_within.powf(weight);
            for (t, share) in self.cover.of(&outline) {
                kept[t as usize] *= match share {
                    1.0 => covered,
                    _ => kept_within.powf(weight * share),
                };
            }
        }
    }

    /// Adds each triangle's share of the loss's logarithm, multiplied by a factor.
    fn add_shares(&self, shape: &Shape, factor: f64, shares: &mut [f64]) {
        for (outline, weight) in shape.layers() {
            for (t, share) in self.cover.of(&outline) {
                shares[t as usize] += factor * weight * share;
            }
        }
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
        const STEP: f64 = 2e-4;
        let count = self.model.mesh.region().len();
        let mut kept = vec![1.0; count];
        for shape in shapes {
            self.take(shape, &mut kept);
        }
        let mut directions = Vec::new();
        for shape in shapes {
            let log = (1.0 - shape.loss()).ln();
            let mut shares = vec![0.0; count];
            self.add_shares(shape, 1.0, &mut shares);
            for parameter in 0..shape.theta.len() {
                let slopes: Vec<f64> = if parameter == LOSS {
                    shares.iter().map(|share| -shape.loss() * share).collect()
                } else {
                    let mut moved = shape.clone();
                    moved.theta[parameter] += STEP;
                    let mut slopes: Vec<f64> =
                        shares.iter().map(|share| -log / STEP * share).collect();
                    self.add_shares(&moved, log / STEP, &mut slopes);
                    slopes
                };
                let slopes = slopes.into_iter().zip(&kept).enumerate();
                let slopes = slopes.map(|(t, (slope, kept))| (t as u32, kept * slope));
                // rounding leaves a small value if a triangle is covered before and after a step
                directions.push(slopes.filter(|(_, slope)| slope.abs() > 1e-10).collect());
            }
        }
        let mut j = self.model.along(solved, &directions)?;
        for mut column in j.column_iter_mut() {
            column.component_mul_assign(&data.weights);
        }
        Ok(j)
    }

    /// The residual of the data for these shapes, in deviations of a reading, and the derivatives of the readings with
    /// respect to their parameters.
    pub(crate) fn rest(
        &self,
        data: &Data,
        shapes: &[Shape],
    ) -> Result<(DVector<f64>, DMatrix<f64>), ForwardError> {
        let (solved, rest, ..) = self.evaluate(data, shapes)?;
        Ok((rest, self.sensitivity(data, shapes, &solved)?))
    }

    /// The change of each triangle covered by a shape, if it loses all conductance.
    pub(crate) fn covered(&self, shape: &Shape) -> Vec<(u32, f64)> {
        let mut shares = Vec::new();
        for (outline, weight) in shape.layers() {
            let covered = self.cover.of(&outline).into_iter();
            shares.extend(covered.map(|(t, share)| (t, -weight * share)));
        }
        shares
    }

    /// Takes at most [`STEPS`] steps from a start, including rejected ones; fewer if the misfit will not reach
    /// `wanted`, or if the start is `hopeless`.
    pub(super) fn fit(
        &self,
        data: &Data,
        start: &[Shape],
        wanted: f64,
        hopeless: Hopeless,
    ) -> Result<Fit, ForwardError> {
        let mut shapes = start.to_vec();
        let (mut solved, mut residual, mut misfit, mut objective) = self.evaluate(data, &shapes)?;
        let count = shapes.iter().map(|shape| shape.theta.len()).sum();
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
        for taken in 1..=STEPS {
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
            // at most 1.5 cm or 1.5 units of a logit per step
            let largest = step.amax();
            if largest > 1.5 {
                step *= 1.5 / largest;
            }
            let mut next = shapes.clone();
            let mut at = 0;
            for shape in &mut next {
                for value in &mut shape.theta {
                    *value += step[at];
                    at += 1;
                }
                shape.limit();
            }
            let (s, r, m, o) = self.evaluate(data, &next)?;
            let gain = objective - o;
            if gain > 0.0 {
                (shapes, solved, residual, misfit, objective) = (next, s, r, m, o);
            }
            if taken >= hopeless.after && misfit > hopeless.misfit {
                break;
            }
            if gain > 0.0 {
                if gain < DONE || misfit > FAR * wanted && gain < SLOW * misfit {
                    break;
                }
                j = self.sensitivity(data, &shapes, &solved)?;
                damping = (damping * 0.25).max(1e-6);
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
            hessian,
        })
    }
}
