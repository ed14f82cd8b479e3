//! The least-squares problem of one step of [`solver`](super::solver), with its sparse penalty.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::cells::Cells;
use crate::inverse::prior::{Half, Laplacian, block_of_columns};
use crate::linear_algebra::dense;
use crate::linear_algebra::sparse::Block;

/// b: differences of ln sigma below this are penalised as squares.
const SMOOTH: f64 = 0.02;
/// k: penalty of a unit gain of ln sigma in one triangle of the region, in squared deviations of a reading.
pub(super) const GAIN_PENALTY: f64 = 1e3;
/// r: determines the mean level if the readings do not.
pub(super) const LEVEL: f64 = 1e-4;
/// Draws of the posterior: a whole number of lanes.
const DRAWS: usize = 16;
const SEED: u64 = 3;

/// Penalty of differences between neighbours.
#[derive(Debug, Clone, Copy)]
pub(super) enum Differences {
    /// The absolute difference: for loads with borders.
    Amount,
    /// The square over 2 c: for loads that change slowly with position.
    Square(f64),
}

impl Differences {
    pub(super) fn are_smooth(self) -> bool {
        matches!(self, Self::Square(_))
    }

    pub(super) fn cost(self, difference: f64) -> f64 {
        match self {
            Self::Amount => difference.hypot(SMOOTH),
            Self::Square(slope) => 0.5 * difference * difference / slope,
        }
    }

    /// The curvature of the parabola that is tangent to the penalty at a difference.
    fn curvature(self, difference: f64) -> f64 {
        match self {
            Self::Amount => 1.0 / difference.hypot(SMOOTH),
            Self::Square(slope) => 1.0 / slope,
        }
    }
}

/// The linearised least-squares problem of a step, in units of a reading's deviation.
pub(super) struct Linearised {
    /// A row per cell, a column per reading.
    sensitivity: Block,
    /// d - c(u) + J u
    data: DVector<f64>,
}

impl Linearised {
    /// Linearises at a change of ln sigma, with the residual of the readings there.
    pub(super) fn new(
        sensitivity: &DMatrix<f64>,
        change: &[f64],
        residual: &DVector<f64>,
        deviation: f64,
    ) -> Self {
        let change = DVector::from_column_slice(change);
        let predicted = DVector::from_vec(dense::times(sensitivity, &change));
        let mut block = block_of_columns(sensitivity);
        for value in &mut block.values {
            *value /= deviation;
        }
        Self {
            sensitivity: block,
            data: (residual + predicted) / deviation,
        }
    }
}

/// The quadratic penalty of a step.
pub(super) struct Penalty<'a> {
    cells: &'a Cells,
    alpha: f64,
    laplacian: Laplacian,
    half: Half,
    /// Cells with gains in the solution of the previous step, which are penalised; `None` if gains are free.
    gains: Option<Vec<bool>>,
    differences: Differences,
}

/// The solution of a step.
pub(super) struct Solution {
    pub(super) change: Vec<f64>,
    /// Degrees of freedom of the data used by the solution.
    pub(super) degrees: f64,
    /// H = L^-1 J', with L L' the penalty, and (H'H + 1)^-1.
    halved: Block,
    inverse: DMatrix<f64>,
}

impl<'a> Penalty<'a> {
    /// `bounded`: gains are penalised; the gains at `start` are penalised from the first step on.
    pub(super) fn new(
        cells: &'a Cells,
        pattern: &Half,
        alpha: f64,
        bounded: bool,
        differences: Differences,
        start: &[f64],
    ) -> Self {
        Self {
            laplacian: cells.neighbours.clone(),
            half: pattern.clone(),
            gains: bounded.then(|| start.iter().map(|u| *u > 0.0).collect()),
            cells,
            alpha,
            differences,
        }
    }

    /// The minimum with the penalty's tangent parabola at `at`; `None` if a matrix cannot be factored.
    pub(super) fn minimum(&mut self, problem: &Linearised, at: &[f64]) -> Option<Solution> {
        let cells = self.cells;
        for ((weight, length), &[a, b]) in self
            .laplacian
            .weights
            .iter_mut()
            .zip(&cells.neighbours.weights)
            .zip(&cells.neighbours.edges)
        {
            *weight = length * self.differences.curvature(at[a] - at[b]);
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
        let sizes = &self.cells.sizes;
        let gains = self.gains.as_ref();
        self.half
            .factor_again(&self.laplacian, self.alpha, |cell| {
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

    /// Draws from the posterior around `at`; their deviations are x = L^-T (p + H (H'H + 1)^-1 (e - H'p)) with white p
    /// and e.
    pub(super) fn possible(&self, solution: &Solution, at: &[f64]) -> Vec<Vec<f64>> {
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
