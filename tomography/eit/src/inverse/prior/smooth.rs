//! A smooth prior: x = G w with white w and a Gaussian kernel G, so that no system has to be inverted.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// The kernel is cut off at this many lengths (e^-9 of its maximum). The truncated kernel is itself an exact prior.
const REACH: f64 = 3.0;

/// G with G G' = R^-1, row by row.
#[derive(Debug, Clone)]
pub(crate) struct Smooth {
    /// Row i of G is `entries[first[i]..first[i + 1]]`: column and value.
    first: Vec<usize>,
    entries: Vec<(u32, f64)>,
    /// r with G_jk = G_kj r_k / r_j: the kernel is symmetric, its norms and areas are not.
    skew: Vec<f64>,
}

impl Smooth {
    /// Correlation exp(-r^2 / 2 length^2) of unknowns at `points` (m) with `areas` (m2), variance 1 each.
    pub(crate) fn new(points: &[[f64; 2]], areas: &[f64], length: f64) -> Self {
        let rows: Vec<(Vec<(u32, f64)>, f64)> = points
            .par_iter()
            .map(|p| {
                let mut row: Vec<(u32, f64)> = points
                    .iter()
                    .zip(areas)
                    .enumerate()
                    .filter_map(|(j, (q, area))| {
                        let square =
                            ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)) / (length * length);
                        (square <= REACH * REACH).then(|| (j as u32, (-square).exp() * area.sqrt()))
                    })
                    .collect();
                let norm = row.iter().map(|(_, g)| g * g).sum::<f64>().sqrt();
                for (_, g) in &mut row {
                    *g /= norm;
                }
                (row, norm)
            })
            .collect();
        let mut first = vec![0];
        let (mut entries, mut skew) = (Vec::new(), Vec::new());
        for ((row, norm), area) in rows.into_iter().zip(areas) {
            entries.extend(row);
            first.push(entries.len());
            skew.push(norm * area.sqrt());
        }
        Self {
            first,
            entries,
            skew,
        }
    }

    pub(crate) fn unknowns(&self) -> usize {
        self.first.len() - 1
    }

    fn row(&self, unknown: usize) -> &[(u32, f64)] {
        &self.entries[self.first[unknown]..self.first[unknown + 1]]
    }

    /// J G: `sensitivity` has a column per unknown.
    pub(crate) fn seen(&self, sensitivity: &DMatrix<f64>) -> DMatrix<f64> {
        let rows = sensitivity.nrows();
        let mut out = DMatrix::zeros(rows, self.unknowns());
        for (unknown, column) in sensitivity.column_iter().enumerate() {
            for &(j, g) in self.row(unknown) {
                let into = &mut out.as_mut_slice()[rows * j as usize..][..rows];
                for (into, value) in into.iter_mut().zip(&column) {
                    *into += g * value;
                }
            }
        }
        out
    }

    /// G z: `z` has a row per unknown.
    pub(crate) fn spread(&self, z: &DMatrix<f64>) -> DMatrix<f64> {
        let z = z.transpose();
        let rows = z.nrows();
        let mut out = DMatrix::<f64>::zeros(rows, self.unknowns());
        out.as_mut_slice()
            .par_chunks_mut(rows)
            .enumerate()
            .for_each(|(unknown, into)| {
                for &(j, g) in self.row(unknown) {
                    let from = &z.as_slice()[rows * j as usize..][..rows];
                    for (into, value) in into.iter_mut().zip(from) {
                        *into += g * value;
                    }
                }
            });
        out.transpose()
    }

    /// G G'x
    pub(crate) fn covariance_times(&self, x: &DVector<f64>) -> DVector<f64> {
        let mut white = vec![0.0; x.len()];
        for (unknown, x) in x.iter().enumerate() {
            for &(j, g) in self.row(unknown) {
                white[j as usize] += g * x;
            }
        }
        DVector::from_fn(x.len(), |unknown, _| {
            let row = self.row(unknown).iter();
            row.map(|&(j, g)| g * white[j as usize]).sum()
        })
    }

    /// Row `unknown` of G G'.
    pub(crate) fn covariance_row(&self, unknown: usize) -> Vec<f64> {
        let mut out = vec![0.0; self.unknowns()];
        for &(k, g) in self.row(unknown) {
            let factor = g * self.skew[k as usize];
            for &(j, h) in self.row(k as usize) {
                out[j as usize] += factor * h;
            }
        }
        for (value, skew) in out.iter_mut().zip(&self.skew) {
            *value /= skew;
        }
        out
    }
}
