//! Sparse Cholesky: the one place that knows `faer`. Symbolic analysis once, a factor per matrix, many right sides.
//!
//! Unknowns are numbered in the order of elimination by the caller (see [`dissect`]).

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::supernodal::SupernodalLltRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Par, Side, Spec};

/// Right sides handled at once: one row of the block is one vector operation.
pub(crate) const WIDTH: usize = 8;

/// A row of a block of right sides.
pub(crate) type Row = [f64; WIDTH];

/// Where a symmetric matrix may be non-zero (upper triangle by columns), and the shape of its factor.
pub(crate) struct Pattern {
    size: usize,
    starts: Vec<usize>,
    rows: Vec<usize>,
    symbolic: SymbolicCholesky<usize>,
}

/// Why there is no factor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SparseError {
    /// The machine has not enough memory.
    Memory,
    /// A pivot was not positive.
    NotDefinite,
}

impl Pattern {
    /// From pairs of unknowns, in any order, repeated or not; the diagonal is always there.
    pub(crate) fn new(
        size: usize,
        pairs: impl IntoIterator<Item = [usize; 2]>,
    ) -> Result<Self, SparseError> {
        let mut columns: Vec<Vec<usize>> = (0..size).map(|unknown| vec![unknown]).collect();
        for [a, b] in pairs {
            columns[a.max(b)].push(a.min(b));
        }
        let mut starts = vec![0];
        let mut rows = Vec::new();
        for column in &mut columns {
            column.sort_unstable();
            column.dedup();
            rows.extend_from_slice(column);
            starts.push(rows.len());
        }
        let symbolic = factorize_symbolic_cholesky(
            SymbolicSparseColMatRef::new_checked(size, size, &starts, None, &rows),
            Side::Upper,
            SymmetricOrdering::Identity,
            CholeskySymbolicParams {
                supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
                ..CholeskySymbolicParams::default()
            },
        )
        .map_err(|_| SparseError::Memory)?;
        Ok(Self {
            size,
            starts,
            rows,
            symbolic,
        })
    }

    /// Number of stored entries.
    pub(crate) fn entries(&self) -> usize {
        self.rows.len()
    }

    /// Index of an entry among the stored ones.
    pub(crate) fn entry(&self, a: usize, b: usize) -> Option<usize> {
        let (row, column) = (a.min(b), a.max(b));
        let start = self.starts[column];
        self.rows[start..self.starts[column + 1]]
            .binary_search(&row)
            .ok()
            .map(|at| start + at)
    }

    /// The factor of the matrix with these entries.
    pub(crate) fn factor(&self, values: &[f64]) -> Result<Factor<'_>, SparseError> {
        let scratch = self
            .symbolic
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default());
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| SparseError::Memory)?;
        let mut factor = vec![0.0; self.symbolic.len_val()];
        self.symbolic
            .factorize_numeric_llt(
                &mut factor,
                SparseColMatRef::new(
                    SymbolicSparseColMatRef::new_checked(
                        self.size,
                        self.size,
                        &self.starts,
                        None,
                        &self.rows,
                    ),
                    values,
                ),
                Side::Upper,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                Spec::default(),
            )
            .map_err(|_| SparseError::NotDefinite)?;
        Ok(Factor {
            symbolic: &self.symbolic,
            values: factor,
        })
    }
}

/// A lower triangle L with L Lᵀ = A, in blocks of columns with one pattern.
pub(crate) struct Factor<'a> {
    symbolic: &'a SymbolicCholesky<usize>,
    values: Vec<f64>,
}

impl Factor<'_> {
    /// Solves A x = b in place for [`WIDTH`] right sides. Rows of zeros cost nothing on the way forward.
    pub(crate) fn solve(&self, block: &mut [Row]) {
        let SymbolicCholeskyRaw::Supernodal(symbolic) = self.symbolic.raw() else {
            unreachable!("the symbolic analysis was told to make supernodes");
        };
        let factor = SupernodalLltRef::new(symbolic, &self.values);
        let supernodes = symbolic.n_supernodes();
        for index in 0..supernodes {
            let node = factor.supernode(index);
            let (start, pattern, values) = (node.start(), node.pattern(), node.val());
            let width = values.ncols();
            for j in 0..width {
                let column = values.col(j);
                let mut x = block[start + j];
                if x == [0.0; WIDTH] {
                    continue;
                }
                let column = column
                    .try_as_col_major()
                    .expect("a supernode's columns are contiguous")
                    .as_slice();
                let pivot = column[j];
                x.iter_mut().for_each(|x| *x /= pivot);
                block[start + j] = x;
                for (row, l) in block[start + j + 1..start + width]
                    .iter_mut()
                    .zip(&column[j + 1..width])
                {
                    subtract(row, *l, &x);
                }
                for (row, l) in pattern.iter().zip(&column[width..]) {
                    subtract(&mut block[*row], *l, &x);
                }
            }
        }
        for index in (0..supernodes).rev() {
            let node = factor.supernode(index);
            let (start, pattern, values) = (node.start(), node.pattern(), node.val());
            let width = values.ncols();
            for j in (0..width).rev() {
                let column = values
                    .col(j)
                    .try_as_col_major()
                    .expect("a supernode's columns are contiguous")
                    .as_slice();
                let mut x = block[start + j];
                for (row, l) in block[start + j + 1..start + width]
                    .iter()
                    .zip(&column[j + 1..width])
                {
                    subtract(&mut x, *l, row);
                }
                for (row, l) in pattern.iter().zip(&column[width..]) {
                    subtract(&mut x, *l, &block[*row]);
                }
                let pivot = column[j];
                x.iter_mut().for_each(|x| *x /= pivot);
                block[start + j] = x;
            }
        }
    }
}

#[inline(always)]
fn subtract(from: &mut Row, factor: f64, row: &Row) {
    for (from, value) in from.iter_mut().zip(row) {
        *from -= factor * value;
    }
}

/// An elimination order by nested dissection: halves the plane at the median of its longer side, eliminates both
/// halves first and the points between them last. `neighbours` must be symmetric.
pub(crate) fn dissect(points: &[[f64; 2]], neighbours: &[Vec<usize>]) -> Vec<usize> {
    let mut order = Vec::with_capacity(points.len());
    let mut side = vec![0; points.len()];
    let mut mark = 0;
    split(
        points,
        neighbours,
        (0..points.len()).collect(),
        &mut side,
        &mut mark,
        &mut order,
    );
    order
}

/// Parts of this size are not cut any further.
const LEAF: usize = 12;

fn split(
    points: &[[f64; 2]],
    neighbours: &[Vec<usize>],
    mut part: Vec<usize>,
    side: &mut [usize],
    mark: &mut usize,
    order: &mut Vec<usize>,
) {
    if part.len() <= LEAF {
        order.extend(part);
        return;
    }
    let extent = |axis: usize| {
        let along = part.iter().map(|&node| points[node][axis]);
        along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
    };
    let axis = usize::from(extent(1) > extent(0));
    part.sort_by(|&a, &b| points[a][axis].total_cmp(&points[b][axis]).then(a.cmp(&b)));
    let (low, high) = part.split_at(part.len() / 2);
    *mark += 2;
    let (is_low, is_high) = (*mark, *mark + 1);
    low.iter().for_each(|&node| side[node] = is_low);
    high.iter().for_each(|&node| side[node] = is_high);
    let touching = |nodes: &[usize], other: usize, side: &[usize]| -> Vec<usize> {
        nodes
            .iter()
            .copied()
            .filter(|&node| neighbours[node].iter().any(|&near| side[near] == other))
            .collect()
    };
    let from_low = touching(low, is_high, side);
    let from_high = touching(high, is_low, side);
    let (separator, keep) = if from_low.len() <= from_high.len() {
        (from_low, is_low)
    } else {
        (from_high, is_high)
    };
    separator.iter().for_each(|&node| side[node] = 0);
    let rest = |nodes: &[usize], own: usize, side: &[usize]| -> Vec<usize> {
        nodes
            .iter()
            .copied()
            .filter(|&node| own != keep || side[node] == own)
            .collect()
    };
    let low = rest(low, is_low, side);
    let high = rest(high, is_high, side);
    split(points, neighbours, low, side, mark, order);
    split(points, neighbours, high, side, mark, order);
    order.extend(separator);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_of_resistors_is_solved() {
        let size = 40;
        let links = || (1..size).map(|k| [k - 1, k]);
        let pattern = Pattern::new(size, links()).unwrap();
        let mut values = vec![0.0; pattern.entries()];
        for [a, b] in links() {
            values[pattern.entry(a, b).unwrap()] -= 1.0;
            values[pattern.entry(a, a).unwrap()] += 1.0;
            values[pattern.entry(b, b).unwrap()] += 1.0;
        }
        values[pattern.entry(0, 0).unwrap()] += 1.0;
        let factor = pattern.factor(&values).unwrap();
        let mut block = vec![[0.0; WIDTH]; size];
        block[size - 1][3] = 2.0;
        factor.solve(&mut block);
        for (k, row) in block.iter().enumerate() {
            assert!((row[3] - 2.0 * (k + 1) as f64).abs() < 1e-12);
            assert_eq!(row[0], 0.0);
        }
        assert_eq!(pattern.entry(0, 5), None);
        values[0] = -9.0;
        assert!(matches!(
            pattern.factor(&values),
            Err(SparseError::NotDefinite)
        ));
    }

    #[test]
    fn dissection_keeps_every_point_once() {
        let points: Vec<[f64; 2]> = (0..900)
            .map(|k| [(k % 30) as f64, (k / 30) as f64])
            .collect();
        let neighbours: Vec<Vec<usize>> = points
            .iter()
            .map(|p| {
                (0..900)
                    .filter(|&q: &usize| {
                        (points[q][0] - p[0]).abs() + (points[q][1] - p[1]).abs() == 1.0
                    })
                    .collect()
            })
            .collect();
        let mut order = dissect(&points, &neighbours);
        order.sort_unstable();
        assert_eq!(order, (0..900).collect::<Vec<_>>());
    }
}
