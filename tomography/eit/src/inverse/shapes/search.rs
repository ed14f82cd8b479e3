//! Search for shapes that explain a frame: a beam of joint fits, one more shape each round.

use crate::ForwardError;
use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::fit::{Data, Fit, Problem};
use super::shape::Shape;

/// Single shapes with their changes of the readings.
pub(crate) struct Library {
    pub(crate) shapes: Vec<Shape>,
    /// Change of the readings, V.
    pub(crate) changes: Vec<Vec<f64>>,
}

impl Library {
    pub(crate) fn new(
        problem: &Problem<'_>,
        count: usize,
        seed: u64,
    ) -> Result<Self, ForwardError> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let bounds = problem.cover.bounds();
        let mut shapes = Vec::with_capacity(count);
        while shapes.len() < count {
            let shape = Shape::draw(bounds, &mut random);
            if problem
                .cover
                .of(&shape.outline())
                .iter()
                .map(|c| c.1)
                .sum::<f64>()
                > 1.0
            {
                shapes.push(shape);
            }
        }
        let changes = shapes
            .par_iter()
            .map_init(
                || problem.model.quick(),
                |quick, shape| match quick {
                    Ok(quick) => quick.change(&problem.map(std::slice::from_ref(shape))),
                    Err(fault) => Err(fault.clone()),
                },
            )
            .collect::<Result<_, ForwardError>>()?;
        Ok(Self { shapes, changes })
    }

    /// The changes in units of the noise.
    fn white(&self, data: &Data) -> Vec<DVector<f64>> {
        self.changes
            .iter()
            .map(|c| DVector::from_column_slice(c).component_mul(&data.weights))
            .collect()
    }

    /// The best shapes to add to a fit, at a distance from each other; `white` are the changes in units of the noise.
    fn additions(
        &self,
        white: &[DVector<f64>],
        residual: &DVector<f64>,
        count: usize,
    ) -> Vec<Shape> {
        let mut scored: Vec<(f64, f64, usize)> = white
            .iter()
            .enumerate()
            .map(|(k, g)| {
                let (dot, square) = (g.dot(residual), g.norm_squared());
                // the loss may be scaled, to at most 1
                let most = 1.0 / self.shapes[k].loss();
                let factor = (dot / square).clamp(0.0, most);
                (2.0 * factor * dot - factor * factor * square, factor, k)
            })
            .collect();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<(usize, f64)> = Vec::new();
        for (gain, factor, k) in scored {
            if chosen.len() == count || gain <= 0.0 {
                break;
            }
            let apart = chosen.iter().all(|&(other, _)| {
                white[k].dot(&white[other]) < 0.9 * white[k].norm() * white[other].norm()
            });
            if apart {
                chosen.push((k, factor));
            }
        }
        chosen
            .into_iter()
            .map(|(k, factor)| {
                let mut shape = self.shapes[k].clone();
                let loss = shape.loss() * factor;
                shape.set_loss(loss);
                shape
            })
            .collect()
    }
}

/// Extent of the search.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Settings {
    /// Most shapes of a frame: Algorithm 1 draws up to four.
    pub(crate) most: usize,
    /// Fits that each round extends.
    pub(crate) beam: usize,
    /// Starts of the first round.
    pub(crate) first: usize,
    /// Additions tried for each fit in later rounds.
    pub(crate) additions: usize,
    /// Steps of a first fit.
    pub(crate) steps: usize,
    /// Steps for the fits that are kept.
    pub(crate) polish: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            most: 4,
            beam: 2,
            first: 6,
            additions: 3,
            steps: 8,
            polish: 10,
        }
    }
}

/// The search ends after a round whose best log evidence is this much below the best so far.
const FALLS_SHORT: f64 = 5.0;

/// Every fit found with its evidence, in descending order.
pub(crate) fn search(
    problem: &Problem<'_>,
    library: &Library,
    data: &Data,
    settings: &Settings,
) -> Result<Vec<(f64, Fit)>, ForwardError> {
    let white = library.white(data);
    let area: f64 = problem.model.mesh.region_areas().iter().sum();
    let none = Fit {
        shapes: Vec::new(),
        misfit: 0.5 * data.white.norm_squared(),
        objective: 0.5 * data.white.norm_squared(),
        residual: data.white.clone(),
        hessian: nalgebra::DMatrix::zeros(0, 0),
    };
    let mut all = vec![(-none.objective, none.clone())];
    let mut beam = vec![none];
    for round in 0..settings.most {
        let additions = if round == 0 {
            settings.first
        } else {
            settings.additions
        };
        let mut next: Vec<(f64, Fit)> = Vec::new();
        for from in &beam {
            for addition in library.additions(&white, &from.residual, additions) {
                let mut start = from.shapes.clone();
                start.push(addition);
                let fit = problem.fit(data, &start, settings.steps, 0.05)?;
                next.push((evidence(&fit, area), fit));
            }
        }
        next.sort_by(|a, b| b.0.total_cmp(&a.0));
        let left = next.split_off(settings.beam.min(next.len()));
        for (value, fit) in &mut next {
            *fit = problem.fit(data, &fit.shapes, settings.polish, 0.02)?;
            *value = evidence(fit, area);
        }
        next.sort_by(|a, b| b.0.total_cmp(&a.0));
        let Some(best) = next.first() else { break };
        let before = all.iter().map(|a| a.0).fold(f64::NEG_INFINITY, f64::max);
        let gained = best.0 - before;
        beam = next.iter().map(|(_, fit)| fit.clone()).collect();
        all.extend(next);
        all.extend(left);
        if gained < -FALLS_SHORT {
            break;
        }
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    Ok(all)
}

/// Logarithm of the evidence by Laplace's method.
fn evidence(fit: &Fit, area: f64) -> f64 {
    let count = fit.hessian.nrows();
    let mut value = -fit.objective;
    if count == 0 {
        return value;
    }
    let mut hessian = fit.hessian.clone();
    for p in 0..count {
        hessian[(p, p)] += 0.1;
    }
    let Some(factor) = hessian.cholesky() else {
        return f64::NEG_INFINITY;
    };
    let log: f64 = factor.l().diagonal().iter().map(|d| d.ln()).sum();
    value += 0.5 * count as f64 * (2.0 * std::f64::consts::PI).ln() - log;
    value += fit
        .shapes
        .iter()
        .map(|shape| shape.log_prior(area))
        .sum::<f64>();
    value
}
