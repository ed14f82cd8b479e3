//! Low-rank approximation of a reconstruction matrix, much faster than the full product: few directions of the data, a
//! small factor in f32, and an error bound that is checked on every frame.
//!
//! With M = U S V' the map of data y is M y = A (V_r' y) + M (y - V_r V_r' y), A = U_r S_r. The second term is dropped;
//! it is at most the longest row of U S beyond r times the length of y beyond V_r, which is computed exactly for each
//! frame. A in f32 rounds each value to (k + 2) 2^-24 of the longest row of A times the length of V_r' y, k the padded
//! columns.

use nalgebra::{DMatrix, DVector};

use crate::inverse::learned::network;
use crate::linear_algebra::dense;

/// Columns of the factor are padded to a multiple of this: the kernel's width.
const LANES: usize = 64;
/// Share of the allowed error used in the choice of the rank; each frame is checked against its own bound.
const CHOSEN: f64 = 0.1;

#[derive(Debug, Clone)]
pub(crate) struct Quick {
    /// Largest error of a map allowed, as a share of its largest value.
    error: f64,
    /// V_r', row by row, one entry per datum.
    directions: Vec<f64>,
    data: usize,
    /// A, row by row, padded.
    factor: Vec<f32>,
    width: usize,
    rank: usize,
    /// Longest rows of A and of the dropped part.
    longest: f64,
    left_out: f64,
}

impl Quick {
    /// Approximates maps `matrix` y. The rank is the smallest that meets `error` for data with the same components as
    /// `typical` data along the directions of the matrix. `None` if the matrix has no directions.
    pub(crate) fn new(matrix: &DMatrix<f64>, typical: &DMatrix<f64>, error: f64) -> Option<Self> {
        let (squares, vectors) = dense::symmetric_eigen(&dense::gram_of_columns(matrix))?;
        let order: Vec<usize> = (0..squares.len()).rev().collect();
        let vectors = vectors.select_columns(&order);
        let along = dense::product(dense::view(matrix), dense::view(&vectors));
        let (rows, columns) = along.shape();
        // length of each row beyond the first r columns; the maximum over all rows
        let mut sums = vec![0.0_f64; rows];
        let mut beyond = vec![0.0; columns + 1];
        for r in (0..columns).rev() {
            for (sum, value) in sums.iter_mut().zip(&along.column(r)) {
                *sum += value * value;
            }
            beyond[r] = sums.iter().copied().fold(0.0, f64::max).sqrt();
        }
        // typical data: their components along the directions, and the largest value of their maps
        let parts = dense::product(dense::view(&vectors).transpose(), dense::view(typical));
        let maps = dense::product(dense::view(matrix), dense::view(typical));
        let largest: Vec<f64> = maps.column_iter().map(|map| map.amax()).collect();
        let fits = |r: usize| {
            parts.column_iter().zip(&largest).all(|(part, largest)| {
                beyond[r] * part.rows(r, columns - r).norm() <= CHOSEN * error * largest
            })
        };
        let rank = (1..columns).find(|&r| fits(r)).unwrap_or(columns);
        let width = rank.div_ceil(LANES) * LANES;
        // the padding costs no time, so it holds further directions
        let rank = width.min(columns);
        let mut factor = vec![0.0_f32; rows * width];
        let mut longest = 0.0_f64;
        for (row, into) in factor.chunks_exact_mut(width).enumerate() {
            let mut square = 0.0;
            for (r, into) in into[..rank].iter_mut().enumerate() {
                let value = along[(row, r)];
                square += value * value;
                *into = value as f32;
            }
            longest = longest.max(square);
        }
        let directions = vectors.as_slice()[..rank * vectors.nrows()].to_vec();
        let finite = factor.iter().all(|value| value.is_finite()) && longest.is_finite();
        finite.then_some(Self {
            error,
            directions,
            data: vectors.nrows(),
            factor,
            width,
            rank,
            longest: longest.sqrt(),
            left_out: beyond[rank],
        })
    }

    /// The map and its error bound as a share of the largest value; `None` if the bound exceeds the allowed error.
    pub(crate) fn map(&self, data: &DVector<f64>) -> Option<(Vec<f64>, f64)> {
        let along: Vec<f64> = self
            .directions
            .chunks_exact(self.data)
            .map(|direction| dot(direction, data.as_slice()))
            .collect();
        let seen = along.iter().map(|part| part * part).sum::<f64>();
        // the difference of two squares has the rounding error of either
        let all = data.norm_squared();
        let beyond = ((all - seen).max(0.0) + 1e-14 * all).sqrt();
        // scaled to a size that f32 can represent, whatever the unit
        let unit = along
            .iter()
            .fold(0.0_f64, |most, part| most.max(part.abs()));
        if !(unit > 0.0 && unit.is_finite()) {
            return None;
        }
        let mut input = vec![0.0_f32; self.width];
        for (into, part) in input.iter_mut().zip(&along) {
            *into = (part / unit) as f32;
        }
        let mut output = vec![0.0_f32; self.factor.len() / self.width];
        network::rows_times(&self.factor, &input, &mut output);
        let values: Vec<f64> = output
            .iter()
            .map(|value| f64::from(*value) * unit)
            .collect();
        let largest = values
            .iter()
            .fold(0.0_f64, |most, value| most.max(value.abs()));
        let rounding = (self.width + 2) as f64 * 0.5 * f64::from(f32::EPSILON);
        let bound = self.left_out * beyond + rounding * self.longest * seen.sqrt();
        // relative to the map's true largest value, which is at least this one minus the bound
        let share = bound / (largest - bound);
        (largest > bound && share <= self.error).then_some((values, share))
    }

    /// User-readable description.
    pub(crate) fn description(&self) -> String {
        format!(
            "maps from {} of {} combinations of readings in f32 if their error is proved to be at most {:e} of the map's \
             largest value, otherwise from the whole matrix",
            self.rank, self.data, self.error
        )
    }
}

/// Dot product in a fixed order that the compiler can vectorise.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut lanes = [0.0; LANES];
    let (a, b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f64 = a
        .remainder()
        .iter()
        .zip(b.remainder())
        .map(|(a, b)| a * b)
        .sum();
    for (a, b) in a.zip(b) {
        for lane in 0..LANES {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    lanes.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use crate::inverse::low_rank::*;

    /// The bound holds on data of every kind, and data outside the directions are refused.
    #[test]
    fn a_map_is_within_its_bound_or_not_given() {
        let (unknowns, data) = (300, 180);
        let matrix = DMatrix::from_fn(unknowns, data, |i, k| {
            let decay = (-0.08 * k as f64).exp();
            decay * ((i * (k + 1)) as f64 * 0.37).sin()
        });
        let typical = DMatrix::from_fn(data, 5, |k, c| ((k + 1) as f64 * (c as f64 + 0.3)).cos());
        let quick = Quick::new(&matrix, &typical, 1e-3).unwrap();
        assert!(quick.rank < data, "{}", quick.rank);
        let mut given = 0;
        for case in 0..40 {
            let y = DVector::from_fn(data, |k, _| 1e-6 * ((k * (case + 2)) as f64 * 0.71).sin());
            let Some((values, share)) = quick.map(&y) else {
                continue;
            };
            given += 1;
            let exact = &matrix * &y;
            let error = values
                .iter()
                .zip(&exact)
                .fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
            assert!(error <= share * exact.amax(), "{error:e} {share:e}");
            assert!(share <= 1e-3 && error <= 1e-3 * exact.amax());
        }
        assert!(given > 30, "{given}");
        // along the last direction, only the dropped part contributes
        let (_, vectors) = dense::symmetric_eigen(&dense::gram_of_columns(&matrix)).unwrap();
        assert!(quick.map(&vectors.column(0).into_owned()).is_none());
        assert!(quick.map(&DVector::zeros(data)).is_none());
    }
}
