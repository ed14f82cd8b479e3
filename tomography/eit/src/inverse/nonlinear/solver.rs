//! Gauss and Newton's method for total variation in the logarithm of conductance, with a penalty on gains.
//!
//! f(u) = |d - c(u)|^2 / 2 s^2 + alpha sum L_e sqrt((u_a - u_b)^2 + b^2) + k sum A_i max(u_i, 0)^2 / 2 + r |u|^2 / 2
//!
//! with u the change of ln sigma of each cell, c(u) the change of the readings by the forward model, s the deviation of a
//! reading, L_e the length of a border and A_i the size of a cell. The square root is replaced by its tangent parabola at
//! each step (lagged diffusivity: C. Vogel, M. Oman, SIAM J. Sci. Comput. 17 (1996) 227), so that a step solves a
//! least-squares problem with a sparse penalty, in the space of the readings.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use survey::Protocol;

use super::cells::Cells;
use crate::inverse::learned::linear::scale_rows;
use crate::inverse::prior::{Half, Laplacian, block_of_columns};
use crate::inverse::reciprocity::Seen;
use crate::linear_algebra::dense;
use crate::linear_algebra::sparse::Block;
use crate::{Forward, ForwardError, OneStepError, Parameters};

/// b: differences of ln sigma below this are penalised as squares.
const SMOOTH: f64 = 0.02;
/// k: a gain of ln sigma in one triangle of the region costs what this many squared deviations of a reading cost.
const GAIN_PENALTY: f64 = 1e3;
/// r: determines the mean level where readings do not.
const LEVEL: f64 = 1e-4;
/// Most steps.
const STEPS: usize = 12;
/// Largest change of ln sigma in a step.
const LONGEST: f64 = 1.5;
/// Lowest ln sigma: below it a cell insulates.
const LOWEST: f64 = -6.0;
/// The search ends when a step improves the objective by less than this share.
const DONE: f64 = 0.01;
/// Most halvings of a step.
const HALVINGS: usize = 4;
/// Draws of the posterior: a whole number of lanes.
const DRAWS: usize = 16;
const SEED: u64 = 3;
/// The deviation is lowered to what the map leaves unexplained, if that is less than this share of it.
const KEPT: f64 = 0.8;
/// The step after which it may also be raised, as where losses cannot explain a frame: later steps would explain it by gains
/// whatever these cost.
const RAISED: usize = 4;

/// The sheet and the penalties.
pub(super) struct Sheet {
    pub(super) forward: Forward,
    /// Questions of the folded readings, and the factor of each.
    pub(super) questions: Protocol,
    pub(super) factors: DVector<f64>,
    pub(super) sigma0: Vec<f64>,
    pub(super) cells: Cells,
    parameters: Parameters,
    /// The pattern of the penalty's factor.
    pattern: Half,
    /// Folded readings of the unloaded sheet, and their sensitivity to ln sigma of the cells.
    pub(super) unloaded: DVector<f64>,
    pub(super) sensitivity: DMatrix<f64>,
    /// alpha, 1/m.
    pub(super) alpha: f64,
}

/// A minimum.
pub(super) struct Found<'a> {
    /// Change of ln sigma of each cell.
    pub(super) change: Vec<f64>,
    /// Share of the squared change of the readings that is left.
    pub(super) left: f64,
    /// Standard deviation of the errors of a reading, from what is left.
    pub(super) error: f64,
    /// The last step, for the draws of the posterior.
    penalty: Penalty<'a>,
    last: Solution,
}

impl Found<'_> {
    /// Changes of ln sigma of each cell that errors and penalty leave possible, in the linearised problem of the last step.
    pub(super) fn possible(&self) -> Vec<Vec<f64>> {
        self.penalty.possible(&self.last, &self.change)
    }
}

/// A point of the search.
struct Point {
    change: Vec<f64>,
    /// d - c(u)
    residual: DVector<f64>,
    sigma: Vec<f64>,
}

impl Point {
    /// Standard deviation of the errors of a reading, from what is left by a map with so many degrees of freedom.
    fn error(&self, degrees: f64) -> f64 {
        (self.residual.norm_squared() / (self.residual.len() as f64 - degrees)).sqrt()
    }
}

impl Sheet {
    pub(super) fn new(
        forward: Forward,
        questions: Protocol,
        factors: &[f64],
        sigma0: &[f64],
        alpha: f64,
    ) -> Result<Self, OneStepError> {
        let cells = Cells::new(forward.mesh());
        let mut sheet = Self {
            parameters: cells.parameters(forward.mesh()),
            pattern: cells.neighbours.pattern().ok_or(OneStepError::Prior)?,
            cells,
            unloaded: DVector::zeros(questions.len()),
            sensitivity: DMatrix::zeros(0, 0),
            sigma0: sigma0.to_vec(),
            forward,
            questions,
            factors: DVector::from_column_slice(factors),
            alpha,
        };
        sheet.unloaded = sheet.readings(sigma0)?;
        let mut sensitivity = DMatrix::zeros(0, 0);
        sheet.sensitivity_into(sigma0, &mut sensitivity)?;
        sheet.sensitivity = sensitivity;
        Ok(sheet)
    }

    fn readings(&self, sigma: &[f64]) -> Result<DVector<f64>, ForwardError> {
        let readings = self.forward.readings(sigma, &self.questions)?;
        Ok(readings.zip_map(&self.factors, |value, factor| value * factor))
    }

    fn sensitivity_into(
        &self,
        sigma: &[f64],
        sensitivity: &mut DMatrix<f64>,
    ) -> Result<(), ForwardError> {
        let (forward, questions) = (&self.forward, &self.questions);
        forward.sensitivity_into(sigma, questions, &self.parameters, sensitivity)?;
        scale_rows(sensitivity, self.factors.as_slice());
        Ok(())
    }

    /// The minimum for the change of the readings. The standard deviation of their errors is `first`, then what the map leaves
    /// unexplained, at least `least`. `bounded`: gains are penalised. `None` if a step cannot be solved.
    pub(super) fn minimum(
        &self,
        seen: &Seen,
        first: f64,
        least: f64,
        bounded: bool,
    ) -> Result<Option<Found<'_>>, ForwardError> {
        let mut penalty = Penalty::new(self, bounded);
        let mut at = Point {
            change: vec![0.0; self.cells.count()],
            residual: seen.data.clone(),
            sigma: self.sigma0.clone(),
        };
        let mut deviation = first;
        let mut value = self.value(&at, deviation, bounded);
        let mut last = None;
        // kept from step to step: new memory takes longer than what fills it
        let mut changed = DMatrix::zeros(0, 0);
        for step in 1..=STEPS {
            let sensitivity = match step {
                1 => &self.sensitivity,
                _ => {
                    self.sensitivity_into(&at.sigma, &mut changed)?;
                    &changed
                }
            };
            let problem = Linearised::new(&seen.rows(sensitivity), &at, deviation);
            let Some(solution) = penalty.minimum(&problem, &at.change) else {
                return Ok(None);
            };
            let solution = last.insert(solution);
            let Some(next) =
                self.towards(seen, &at, &solution.change, value, deviation, bounded)?
            else {
                break; // no step improves it further
            };
            at = next;
            let before = value;
            value = self.value(&at, deviation, bounded);
            let estimated = at.error(solution.degrees).max(least);
            if estimated < KEPT * deviation || step == RAISED && estimated > deviation {
                deviation = estimated;
                value = self.value(&at, deviation, bounded);
            } else if before - value < DONE * value {
                break;
            }
        }
        Ok(last.map(|last| Found {
            error: at.error(last.degrees),
            left: at.residual.norm_squared() / seen.data.norm_squared(),
            change: at.change,
            penalty,
            last,
        }))
    }

    /// The objective.
    fn value(&self, at: &Point, deviation: f64, bounded: bool) -> f64 {
        let edges = self.cells.neighbours.edges.iter();
        let variation: f64 = edges
            .zip(&self.cells.neighbours.weights)
            .map(|(&[a, b], length)| length * (at.change[a] - at.change[b]).hypot(SMOOTH))
            .sum();
        let sizes = self.cells.sizes.iter().zip(&at.change);
        let gains: f64 = match bounded {
            true => sizes.map(|(size, u)| size * u.max(0.0).powi(2)).sum(),
            false => 0.0,
        };
        let level: f64 = at.change.iter().map(|u| u * u).sum();
        0.5 * (at.residual.norm_squared() / (deviation * deviation)
            + GAIN_PENALTY * gains
            + LEVEL * level)
            + self.alpha * variation
    }

    /// A point on the way to a solution with a smaller objective; `None` if none was found.
    fn towards(
        &self,
        seen: &Seen,
        from: &Point,
        to: &[f64],
        value: f64,
        deviation: f64,
        bounded: bool,
    ) -> Result<Option<Point>, ForwardError> {
        let both = || from.change.iter().zip(to);
        let longest = both()
            .map(|(from, to)| (to - from).abs())
            .fold(0.0, f64::max);
        let mut share = (LONGEST / longest).min(1.0);
        for _ in 0..=HALVINGS {
            let change: Vec<f64> = both()
                .map(|(from, to)| (from + share * (to - from)).max(LOWEST))
                .collect();
            let sigma = self.cells.conductances(&self.sigma0, &change);
            let shift = self.readings(&sigma)? - &self.unloaded;
            let shift = seen
                .rows(&DMatrix::from_column_slice(
                    shift.len(),
                    1,
                    shift.as_slice(),
                ))
                .column(0)
                .into_owned();
            let point = Point {
                change,
                residual: &seen.data - shift,
                sigma,
            };
            if self.value(&point, deviation, bounded) < value {
                return Ok(Some(point));
            }
            share *= 0.5;
        }
        Ok(None)
    }
}

/// The least-squares problem of a step, in deviations of a reading.
struct Linearised {
    /// A row for each cell, a column for each reading.
    sensitivity: Block,
    /// d - c(u) + J u
    data: DVector<f64>,
}

impl Linearised {
    fn new(sensitivity: &DMatrix<f64>, at: &Point, deviation: f64) -> Self {
        let change = DVector::from_column_slice(&at.change);
        let predicted = DVector::from_vec(dense::times(sensitivity, &change));
        let mut block = block_of_columns(sensitivity);
        for value in &mut block.values {
            *value /= deviation;
        }
        Self {
            sensitivity: block,
            data: (&at.residual + predicted) / deviation,
        }
    }
}

/// The quadratic penalty of a step.
struct Penalty<'a> {
    sheet: &'a Sheet,
    laplacian: Laplacian,
    half: Half,
    /// The cells with gains in the solution of the step before, which are penalised; `None` if gains are free.
    gains: Option<Vec<bool>>,
}

/// The solution of a step.
struct Solution {
    change: Vec<f64>,
    /// Degrees of freedom of the data that it uses.
    degrees: f64,
    /// H = L^-1 J', with L L' the penalty, and (H'H + 1)^-1.
    halved: Block,
    inverse: DMatrix<f64>,
}

impl<'a> Penalty<'a> {
    fn new(sheet: &'a Sheet, bounded: bool) -> Self {
        Self {
            laplacian: sheet.cells.neighbours.clone(),
            half: sheet.pattern.clone(),
            gains: bounded.then(|| vec![false; sheet.cells.count()]),
            sheet,
        }
    }

    /// The minimum with the penalty's tangent parabola at `at`; `None` if a matrix cannot be factored.
    fn minimum(&mut self, problem: &Linearised, at: &[f64]) -> Option<Solution> {
        let cells = &self.sheet.cells;
        for ((weight, length), &[a, b]) in self
            .laplacian
            .weights
            .iter_mut()
            .zip(&cells.neighbours.weights)
            .zip(&cells.neighbours.edges)
        {
            *weight = length / (at[a] - at[b]).hypot(SMOOTH);
        }
        let solution = self.solved(problem)?;
        if let Some(gains) = &mut self.gains {
            for (gain, u) in gains.iter_mut().zip(&solution.change) {
                *gain = *u > 0.0;
            }
        }
        Some(solution)
    }

    fn solved(&mut self, problem: &Linearised) -> Option<Solution> {
        let sizes = &self.sheet.cells.sizes;
        let gains = self.gains.as_ref();
        self.half
            .factor_again(&self.laplacian, self.sheet.alpha, |cell| {
                match gains.is_some_and(|gains| gains[cell]) {
                    true => LEVEL + GAIN_PENALTY * sizes[cell],
                    false => LEVEL,
                }
            })?;
        let halved = self.half.down(&problem.sensitivity);
        let count = problem.data.len();
        let all = dense::gram_of_block(&halved);
        let mut matrix = all.view((0, 0), (count, count)).into_owned();
        for k in 0..count {
            matrix[(k, k)] += 1.0;
        }
        let inverse = dense::inverse_of_definite(&matrix)?;
        let weights = &inverse * &problem.data;
        let mut along = Block::zeros(sizes.len(), 1);
        for row in 0..sizes.len() {
            let sum = halved.row(row).iter().zip(&weights).map(|(h, w)| h * w);
            along.row_mut(row)[0] = sum.sum();
        }
        let change = self.half.up(along, sizes.len());
        Some(Solution {
            change: (0..sizes.len()).map(|cell| change.row(cell)[0]).collect(),
            degrees: count as f64 - inverse.trace(),
            halved,
            inverse,
        })
    }

    /// Draws of the posterior round `at`, whose deviations are x = L^-T (p + H (H'H + 1)^-1 (e - H'p)) with white p and e.
    fn possible(&self, solution: &Solution, at: &[f64]) -> Vec<Vec<f64>> {
        let mut random = ChaCha8Rng::seed_from_u64(SEED);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let cells = at.len();
        let readings = solution.inverse.nrows();
        let mut white = Block::zeros(cells, DRAWS);
        for value in &mut white.values {
            *value = normal();
        }
        // a column for each draw, a row for each reading
        let mut errors = DMatrix::from_fn(readings, white.width, |_, _| normal());
        let halved = dense::transposed_view(&solution.halved).subrows(0, readings);
        errors -= dense::product(halved, dense::transposed_view(&white).transpose());
        let weights = &solution.inverse * errors;
        let moved = dense::product(dense::view(&weights).transpose(), halved);
        for (value, moved) in white.values.iter_mut().zip(moved.as_slice()) {
            *value += moved;
        }
        let deviations = self.half.up(white, cells);
        (0..DRAWS)
            .map(|draw| {
                let moved = |cell: usize| at[cell] + deviations.row(cell)[draw];
                (0..cells).map(moved).collect()
            })
            .collect()
    }
}
