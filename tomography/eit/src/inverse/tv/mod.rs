//! Total variation: the map with the shortest borders among those that explain the readings.
//!
//! x = argmin |J x - d|^2 / 2 + alpha sum L_e |x_i - x_j|  with x = dsigma / sigma0 on the triangles of the region, J
//! and d divided by the noise of a difference, L_e the length (m) of the border between two triangles; optionally over
//! -1 <= x <= 0. It is solved to a stated gap by [cut pursuit](pursuit). The usual method in this field smooths
//! .| near zero and needs some tens of iterations (A. Borsic, B. Graham, A. Adler, W. Lionheart, IEEE Trans. Med.
//! Imaging 29 (2010) 44); here the absolute value is exact.

mod mehrotra;
mod options;
mod problem;
mod pursuit;
mod regions;

use std::borrow::Cow;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use survey::{Map, Protocol, Reading};

pub use crate::inverse::tv::options::{Strength, TV_STRENGTH, TvError, TvOptions};

use crate::inverse::frame_rule::FrameRule;
use crate::inverse::graph::Graph;
use crate::inverse::learned::linear::Linear;
use crate::inverse::learned::novelty;
use crate::inverse::learned::novelty::UNSEEN;
use crate::inverse::prior::{OUTSIDE_WEIGHT, outside};
use crate::inverse::reciprocity::Seen;
use crate::inverse::tv::problem::Problem;
use crate::inverse::tv::pursuit::Outcome;
use crate::linear_algebra::dense;
use crate::{
    EXPECTED_CHANGE, MODEL_SHARE, Mesh, Novelty, OneStepError, OneStepOptions, ReconstructError,
    Reconstructor,
};

/// If the noise is unknown, directions below this share of the largest are dropped.
const ROUNDING: f64 = 1e-8;
/// Bounds of maps that are not limited to losses; no linear map of a sheet comes near them.
const FREE: [f64; 2] = [-10.0, 10.0];

/// The total-variation reconstructor.
pub struct Tv {
    mesh: Arc<Mesh>,
    mesh_hash: String,
    protocol: Protocol,
    method: String,
    linear: Linear,
    graph: Graph,
    /// J over the noise of a difference, reciprocal twins folded.
    whitened: DMatrix<f64>,
    /// Unit of the data: the standard deviation of a change due to noise, or the smallest error of the linear model.
    deviation: f64,
    /// Orthonormal directions of the data that maps change (columns), and J along them.
    directions: DMatrix<f64>,
    along: DMatrix<f64>,
    /// Weights of the borders, for errors of `deviation`.
    weights: Vec<f64>,
    alpha: f64,
    frame_rule: Option<FrameRule>,
    options: TvOptions,
}

/// A map with its accuracy.
#[derive(Debug, Clone, PartialEq)]
pub struct TvSolution {
    /// Relative change of conductance of each triangle of the region.
    pub values: Vec<f64>,
    /// The objective, with all readings.
    pub objective: f64,
    /// Upper limit of its distance from the minimum, from a computed lower bound.
    pub gap: f64,
    /// Rounds of cut pursuit.
    pub rounds: usize,
    /// Constant regions of the map.
    pub regions: usize,
}

impl Tv {
    /// Solves the forward model at `sigma0` (S per square, one per triangle of the mesh) and precomputes what all
    /// frames share.
    ///
    /// # Errors
    /// See [`TvError`].
    pub fn new(
        mesh: Arc<Mesh>,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        protocol: &Protocol,
        options: TvOptions,
    ) -> Result<Self, TvError> {
        options.check()?;
        let shared = OneStepOptions {
            scale: options.scale.clone(),
            deviations: options.deviations.clone(),
            shown: options.shown.clone(),
            ..OneStepOptions::default()
        };
        let (linear, sensitivity, penalty) =
            Linear::new(&mesh, contact_ohm_m, sigma0, protocol, &shared)?;
        let scale = &options.scale;
        let noise = options
            .noise_v
            .map(|volts| scale.deviation(volts, options.current_a));
        let (deviation, frame_rule) = match (options.strength, options.frame_rule) {
            (Strength::Alpha(_), _) => (1.0, None),
            (_, None) => (noise.unwrap_or(1.0), None),
            (_, Some(rule)) => {
                let size = penalty.size(&sensitivity).ok_or(OneStepError::Prior)?;
                let amplitude = penalty.amplitude(EXPECTED_CHANGE, options.shown.as_deref())?;
                let frame_rule =
                    FrameRule::new(rule, noise, &linear, sensitivity.clone(), &penalty)?;
                // no frame is more accurate than the linear model
                let least = MODEL_SHARE * size * amplitude;
                (noise.unwrap_or(0.0).max(least), Some(frame_rule))
            }
        };
        let whitened = sensitivity / deviation;
        let graph = Graph::of_region(&mesh);
        let directions = match options.strength {
            Strength::Alpha(_) => novelty::directions_above(&whitened, |top| ROUNDING * top),
            Strength::Relative(_) => novelty::directions(&whitened),
        }
        .ok_or(TvError::Blind)?;
        let along = dense::product(dense::view(&directions).transpose(), dense::view(&whitened));
        let alpha = match options.strength {
            Strength::Alpha(alpha) => alpha,
            Strength::Relative(share) => {
                share * options::reference(&mesh, &along, options.shown.as_deref())
            }
        };
        let outside = outside(options.shown.as_deref(), graph.unknowns);
        let borders = graph.lengths.iter().zip(&graph.edges);
        let weights = borders
            .map(|(length, [a, b])| match outside[*a] || outside[*b] {
                true => OUTSIDE_WEIGHT * alpha * length,
                false => alpha * length,
            })
            .collect();
        let loss = if options.loss_only { ", loss only" } else { "" };
        Ok(Self {
            method: format!("total variation{loss}"),
            mesh_hash: mesh.hash().to_owned(),
            mesh,
            protocol: protocol.clone(),
            linear,
            graph,
            whitened,
            deviation,
            directions,
            along,
            weights,
            alpha,
            frame_rule,
            options,
        })
    }

    /// The penalty of a jump of 1 along 1 m of border, for readings in standard deviations (or in volts if alpha was
    /// given).
    pub fn alpha(&self) -> f64 {
        self.alpha
    }

    /// Number of directions of the data in use.
    pub fn rank(&self) -> usize {
        self.directions.ncols()
    }

    /// The map of a frame, with its gap.
    ///
    /// # Errors
    /// As [`Reconstructor::reconstruct`].
    pub fn solve(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<(TvSolution, usize), ReconstructError> {
        let (data, missing) = self.data(baseline, frame)?;
        let outcome = self.minimum(&data, &missing)?.ok_or_else(|| {
            self.numerical("the problem on the regions could not be solved".to_owned())
        })?;
        let solution = TvSolution {
            regions: outcome.label.iter().max().map_or(0, |top| top + 1),
            values: outcome.x,
            objective: outcome.objective,
            gap: outcome.gap,
            rounds: outcome.rounds,
        };
        Ok((solution, missing.len()))
    }

    /// The objective of a map for all readings, for comparison with other solvers.
    ///
    /// # Errors
    /// As [`Reconstructor::reconstruct`], or a map of another length.
    pub fn objective(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
        values: &[f64],
    ) -> Result<f64, ReconstructError> {
        let (data, missing) = self.data(baseline, frame)?;
        if values.len() != self.graph.unknowns {
            return Err(ReconstructError::Length {
                what: "map",
                has: values.len(),
                wants: self.graph.unknowns,
                method: self.method.clone(),
            });
        }
        let seen = self.linear.fold.seen(&data, &missing);
        let constant = self.beside(&data, &missing, &seen);
        let sensitivity = seen.rows(&self.whitened);
        let weights = self.weights(&seen, &missing)?;
        let problem = self.problem(&sensitivity, seen.data.clone(), &weights, constant);
        Ok(problem.objective(values))
    }

    /// The smallest objective for all readings, by an interior method over all triangles, to 2e-9: takes minutes on a
    /// mesh of the paper's size; for comparison.
    ///
    /// # Errors
    /// As [`Reconstructor::reconstruct`].
    pub fn minimum_offline(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<f64, ReconstructError> {
        let (data, missing) = self.data(baseline, frame)?;
        let seen = self.linear.fold.seen(&data, &missing);
        let constant = self.beside(&data, &missing, &seen);
        let sensitivity = seen.rows(&self.whitened);
        let weights = self.weights(&seen, &missing)?;
        let problem = self.problem(&sensitivity, seen.data.clone(), &weights, constant);
        let found = problem.minimum_offline(2e-9);
        found.ok_or_else(|| {
            self.numerical(
                "the interior-point method over all triangles did not converge".to_owned(),
            )
        })
    }

    fn numerical(&self, cause: String) -> ReconstructError {
        ReconstructError::Numerical {
            method: self.method.clone(),
            cause,
        }
    }

    /// Weights of the borders for the errors of this frame: minimising |J x - d|^2 / 2 e^2 + (a / e) TV is equivalent
    /// to minimising |J x - d|^2 / 2 + a e TV. `seen`: data in the unit of `deviation`.
    fn weights(&self, seen: &Seen, missing: &[usize]) -> Result<Cow<'_, [f64]>, ReconstructError> {
        let Some(rule) = &self.frame_rule else {
            return Ok(Cow::Borrowed(&self.weights));
        };
        let error = rule
            .error(&seen.times(self.deviation), missing)
            .map_err(|fault| self.numerical(fault.to_string()))?;
        let errors = (error / self.deviation).max(1.0);
        Ok(self.weights.iter().map(|weight| errors * weight).collect())
    }

    /// The change in standard deviations, and the missing readings.
    fn data(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<(Vec<f64>, Vec<usize>), ReconstructError> {
        let (mut change, missing) = self.linear.change(baseline, frame, &self.method)?;
        for value in &mut change {
            *value /= self.deviation;
        }
        Ok((change, missing))
    }

    /// The part of the objective that folding removes: half the squared differences of twins.
    fn beside(&self, data: &[f64], missing: &[usize], seen: &Seen) -> f64 {
        let all: f64 = (0..data.len())
            .filter(|reading| missing.binary_search(reading).is_err())
            .map(|reading| data[reading] * data[reading])
            .sum();
        (0.5 * (all - seen.data.norm_squared())).max(0.0)
    }

    fn problem<'a>(
        &'a self,
        sensitivity: &'a DMatrix<f64>,
        data: DVector<f64>,
        weights: &'a [f64],
        constant: f64,
    ) -> Problem<'a> {
        Problem {
            sensitivity,
            data,
            graph: &self.graph,
            weights,
            bounds: if self.options.loss_only {
                [-1.0, 0.0]
            } else {
                FREE
            },
            constant,
        }
    }

    fn minimum(
        &self,
        data: &[f64],
        missing: &[usize],
    ) -> Result<Option<Outcome>, ReconstructError> {
        let goal = self.options.gap;
        let seen = self.linear.fold.seen(data, missing);
        let beside = self.beside(data, missing, &seen);
        let weights = self.weights(&seen, missing)?;
        if seen.complete() {
            let along = self.directions.tr_mul(&seen.data);
            let constant = (0.5 * (seen.data.norm_squared() - along.norm_squared())).max(0.0);
            let problem = self.problem(&self.along, along, &weights, beside + constant);
            return Ok(problem.minimise(goal));
        }
        let sensitivity = seen.rows(&self.whitened);
        let problem = self.problem(&sensitivity, seen.data.clone(), &weights, beside);
        Ok(problem.minimise(goal))
    }
}

impl Reconstructor for Tv {
    fn method(&self) -> &str {
        &self.method
    }

    fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    fn mesh(&self) -> &Arc<Mesh> {
        &self.mesh
    }

    fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let (solution, masked) = self.solve(baseline, frame)?;
        if solution.values.iter().any(|value| !value.is_finite()) {
            return Err(self.numerical("the map is not finite".to_owned()));
        }
        Ok(Map {
            masked,
            ..Map::relative(&self.mesh_hash, solution.values, &self.method)
        })
    }

    fn assumptions(&self) -> Vec<String> {
        let options = &self.options;
        let mut notes = vec![
            format!(
                "total variation on {} triangles, alpha {:.3e} a metre of border, to a gap of {:e} of the objective",
                self.graph.unknowns, self.alpha, options.gap
            ),
            "linear in the change of conductance".to_owned(),
        ];
        let rank = format!(
            "{} of {} combinations of readings are used: those that a map of root mean square 0.1 changes by more than {UNSEEN:e} of the noise",
            self.rank(),
            self.protocol.len()
        );
        match (options.strength, &self.frame_rule, options.noise_v) {
            (Strength::Alpha(_), ..) => {
                notes.push("alpha was given, readings have equal weight".to_owned());
            }
            (_, Some(rule), noise) => notes.push(format!(
                "alpha is for errors of {:.2e} and grows with the errors of each frame, which are chosen {} and are at least {}; {rank}",
                self.deviation,
                rule.description(),
                noise.map_or("those of the linear model".to_owned(), |volts| format!(
                    "white noise of {volts:.2e} V on each reading at {:.2e} A",
                    options.current_a
                )),
            )),
            (_, None, noise) => notes.push(format!(
                "white noise of {:.2e} V on each reading at {:.2e} A, on baseline and frame alike; {rank}",
                noise.unwrap_or_default(),
                options.current_a,
            )),
        }
        if options.loss_only {
            notes.push("loads only reduce conductance: -1 <= dsigma/sigma0 <= 0".to_owned());
        }
        notes
    }

    fn novelty(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Option<Novelty>, ReconstructError> {
        let (data, missing) = self.data(baseline, frame)?;
        if matches!(self.options.strength, Strength::Alpha(_)) || self.options.noise_v.is_none() {
            return Ok(None); // the noise is unknown
        }
        let directions = self.linear.fold.unfold(&self.directions);
        Ok(novelty::unexplained(&directions, &data, &missing))
    }
}
