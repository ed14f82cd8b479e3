//! Dense products and factorisations: nalgebra stores the matrices, faer multiplies and factors them.
//!
//! faer is built without threads; the larger products are cut into fixed chunks of columns for several threads, so that
//! every result has the same bits on any number of threads.

use faer::linalg::matmul::matmul;
use faer::linalg::solvers::Solve;
use faer::{Accum, Mat, MatMut, MatRef, Par, Side};
use half::bf16;
use nalgebra::{DMatrix, DVector, Scalar};
use rayon::prelude::*;

use crate::linear_algebra::sparse::{Block, MulAdd, Task, widest};

/// A faer view of the same matrix, for [`product`].
pub fn view(matrix: &DMatrix<f64>) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(matrix.as_slice(), matrix.nrows(), matrix.ncols())
}

/// Columns per task.
const COLUMNS: usize = 64;

/// Number of multiplications below which more threads do not pay off.
const SMALL: usize = 20_000_000;

/// Calls `fill` with the index of the first column and the columns, for each chunk of a matrix.
fn by_columns(
    out: &mut DMatrix<f64>,
    multiplications: usize,
    fill: impl Fn(usize, &mut [f64]) + Sync,
) {
    let length = out.nrows() * COLUMNS;
    if out.is_empty() {
        return;
    }
    if multiplications < SMALL {
        let chunks = out.as_mut_slice().chunks_mut(length).enumerate();
        chunks.for_each(|(chunk, out)| fill(chunk * COLUMNS, out));
    } else {
        let chunks = out.as_mut_slice().par_chunks_mut(length).enumerate();
        chunks.for_each(|(chunk, out)| fill(chunk * COLUMNS, out));
    }
}

/// The product a b: the same bits on any number of threads.
pub fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> DMatrix<f64> {
    let (rows, columns) = (a.nrows(), b.ncols());
    let mut out = DMatrix::zeros(rows, columns);
    by_columns(&mut out, rows * columns * a.ncols(), |first, out| {
        let count = out.len() / rows;
        let into = MatMut::from_column_major_slice_mut(out, rows, count);
        let b = b.subcols(first, count);
        matmul(into, Accum::Replace, a, b, 1.0, Par::Seq);
    });
    out
}

/// The product a a', computed in the lower triangle and mirrored.
fn square(a: MatRef<'_, f64>) -> DMatrix<f64> {
    let rows = a.nrows();
    let mut out = DMatrix::zeros(rows, rows);
    by_columns(&mut out, rows * rows * a.ncols() / 2, |first, out| {
        let count = out.len() / rows;
        let into =
            MatMut::from_column_major_slice_mut(out, rows, count).subrows_mut(first, rows - first);
        let (low, own) = (a.subrows(first, rows - first), a.subrows(first, count));
        matmul(into, Accum::Replace, low, own.transpose(), 1.0, Par::Seq);
    });
    out.fill_upper_triangle_with_lower_triangle();
    out
}

/// A faer view of a block, transposed: a row for each right side.
pub(crate) fn transposed_view(block: &Block) -> MatRef<'_, f64> {
    let unknowns = block.values.len() / block.width;
    MatRef::from_column_major_slice(&block.values, block.width, unknowns)
}

/// The products of all pairs of right sides of a block.
pub(crate) fn gram_of_block(block: &Block) -> DMatrix<f64> {
    square(transposed_view(block))
}

/// a x, at memory bandwidth; `a` may have single precision.
pub fn times<T: Scalar + Copy + Into<f64>>(a: &DMatrix<T>, x: &DVector<f64>) -> Vec<f64> {
    widest(Times { a, x })
}

struct Times<'a, T> {
    a: &'a DMatrix<T>,
    x: &'a DVector<f64>,
}

impl<T: Scalar + Copy + Into<f64>> Task for Times<'_, T> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run<M: MulAdd>(self) -> Vec<f64> {
        const TOGETHER: usize = 8;
        let rows = self.a.nrows();
        let mut out = vec![0.0; rows];
        let columns = self.a.as_slice().chunks(rows.max(1) * TOGETHER);
        for (columns, x) in columns.zip(self.x.as_slice().chunks(TOGETHER)) {
            if x.len() == TOGETHER {
                let column: [&[T]; TOGETHER] =
                    std::array::from_fn(|k| &columns[k * rows..][..rows]);
                for (i, out) in out.iter_mut().enumerate() {
                    let mut sum = *out;
                    for k in 0..TOGETHER {
                        sum = M::mul_add(column[k][i].into(), x[k], sum);
                    }
                    *out = sum;
                }
            } else {
                for (column, x) in columns.chunks_exact(rows).zip(x) {
                    for (out, value) in out.iter_mut().zip(column) {
                        *out = M::mul_add((*value).into(), *x, *out);
                    }
                }
            }
        }
        out
    }
}

/// Q with orthonormal columns, and the inverse of U, of A = Q U; `None` if the columns of A are linearly dependent.
pub(crate) fn thin_qr_and_inverse(a: &DMatrix<f64>) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
    let n = a.ncols();
    let qr = view(a).qr();
    let q = qr.compute_thin_Q();
    let mut inverse = Mat::<f64>::identity(n, n);
    qr.thin_R()
        .solve_upper_triangular_in_place(inverse.as_mut());
    let inverse = DMatrix::from_fn(n, n, |i, j| inverse[(i, j)]);
    let q = DMatrix::from_fn(a.nrows(), n, |i, j| q[(i, j)]);
    inverse
        .iter()
        .all(|value| value.is_finite())
        .then_some((q, inverse))
}

/// The inverse of a symmetric positive definite matrix, symmetric to the last bit; `None` if it is not definite.
pub(crate) fn inverse_of_definite(a: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    Definite::new(a)?.inverse()
}

/// Solves a x = b for symmetric positive definite a; `None` if it is not definite.
pub(crate) fn solve_definite(a: &DMatrix<f64>, b: &[f64]) -> Option<Vec<f64>> {
    let factor = view(a).llt(Side::Lower).ok()?;
    let mut x = Mat::<f64>::from_fn(b.len(), 1, |i, _| b[i]);
    factor.solve_in_place(x.as_mut());
    Some((0..b.len()).map(|i| x[(i, 0)]).collect())
}

/// Eigenvalues (ascending) and orthonormal eigenvectors (columns) of a symmetric matrix; `None` if it has NaN entries.
pub fn symmetric_eigen(a: &DMatrix<f64>) -> Option<(Vec<f64>, DMatrix<f64>)> {
    let n = a.nrows();
    let eigen = view(a).self_adjoint_eigen(Side::Lower).ok()?;
    let (s, u) = (eigen.S(), eigen.U());
    let values = (0..n).map(|i| s[i]).collect();
    Some((values, DMatrix::from_fn(n, n, |i, j| u[(i, j)])))
}

/// The Cholesky factor L of a symmetric positive definite matrix A = L L', for several right-hand sides.
#[derive(Debug, Clone)]
pub struct Definite(faer::linalg::solvers::Llt<f64>);

impl Definite {
    /// `None` if the matrix is not definite.
    pub fn new(a: &DMatrix<f64>) -> Option<Self> {
        view(a).llt(Side::Lower).ok().map(Self)
    }

    /// ln det A.
    pub fn log_determinant(&self) -> f64 {
        let lower = self.0.L();
        let logs = (0..lower.nrows()).map(|i| lower[(i, i)].ln());
        2.0 * logs.sum::<f64>()
    }

    /// L^-1 B, in place: data with covariance A become white.
    pub fn whiten(&self, b: &mut DMatrix<f64>) {
        let (rows, columns) = b.shape();
        let view = MatMut::from_column_major_slice_mut(b.as_mut_slice(), rows, columns);
        self.0.L().solve_lower_triangular_in_place(view);
    }

    /// L'^-1 b.
    pub fn unwhiten_transposed(&self, b: &DVector<f64>) -> DVector<f64> {
        let mut x = b.clone();
        let rows = x.len();
        let view = MatMut::from_column_major_slice_mut(x.as_mut_slice(), rows, 1);
        let upper = self.0.L().transpose();
        upper.solve_upper_triangular_in_place(view);
        x
    }

    /// A = L L', recomputed from the factor.
    pub fn matrix(&self) -> DMatrix<f64> {
        square(self.0.L())
    }

    /// A^-1 B, in place: the same bits on any number of threads.
    pub fn solve_columns(&self, b: &mut DMatrix<f64>) {
        let (rows, columns) = b.shape();
        by_columns(b, rows * rows * columns, |_, part| {
            let count = part.len() / rows;
            self.0
                .solve_in_place(MatMut::from_column_major_slice_mut(part, rows, count));
        });
    }

    /// A^-1, symmetric to the last bit; `None` if it has NaN entries.
    pub(crate) fn inverse(&self) -> Option<DMatrix<f64>> {
        let n = self.0.L().nrows();
        let mut inverse = Mat::<f64>::identity(n, n);
        self.0.solve_in_place(inverse.as_mut());
        let out = DMatrix::from_fn(n, n, |i, j| 0.5 * (inverse[(i, j)] + inverse[(j, i)]));
        out.iter().all(|value| value.is_finite()).then_some(out)
    }

    /// A^-1 b.
    pub fn solve(&self, b: &DVector<f64>) -> DVector<f64> {
        let mut x = b.clone();
        let rows = x.len();
        self.0.solve_in_place(MatMut::from_column_major_slice_mut(
            x.as_mut_slice(),
            rows,
            1,
        ));
        x
    }
}

/// J W J' with the diagonal W of positive entries from `weight`; columns without a weight are skipped.
pub(crate) fn gram(j: &DMatrix<f64>, weight: impl Fn(usize) -> Option<f64>) -> DMatrix<f64> {
    let rows = j.nrows();
    let mut scaled = Vec::with_capacity(j.len());
    for (i, column) in j.column_iter().enumerate() {
        if let Some(weight) = weight(i) {
            let root = weight.sqrt();
            scaled.extend(column.iter().map(|value| value * root));
        }
    }
    let columns = scaled.len().checked_div(rows).unwrap_or_default();
    square(MatRef::from_column_major_slice(&scaled, rows, columns))
}

/// A'A
pub(crate) fn gram_of_columns(a: &DMatrix<f64>) -> DMatrix<f64> {
    square(view(a).transpose())
}

/// A'x
pub(crate) fn transposed_times(a: &DMatrix<f64>, x: &DVector<f64>) -> DVector<f64> {
    let x = MatRef::from_column_major_slice(x.as_slice(), x.len(), 1);
    let product = product(view(a).transpose(), x);
    DVector::from_column_slice(product.as_slice())
}

/// Number of values in a vector register.
const LANES: usize = 16;

/// A matrix rounded to the eight leading bits of each value (bfloat16): half the memory of single precision.
#[derive(Debug)]
pub struct Rounded {
    /// Column by column, each filled with zeros to a multiple of [`LANES`].
    values: Vec<bf16>,
    filled_rows: usize,
    columns: usize,
}

impl Rounded {
    /// The rounded values of a matrix.
    pub fn new(a: &DMatrix<f64>) -> Self {
        let filled_rows = a.nrows().next_multiple_of(LANES);
        let mut values = vec![bf16::ZERO; filled_rows * a.ncols()];
        for (k, column) in a.column_iter().enumerate() {
            for (to, value) in values[k * filled_rows..].iter_mut().zip(&column) {
                *to = bf16::from_f64(*value);
            }
        }
        Self {
            values,
            filled_rows,
            columns: a.ncols(),
        }
    }

    /// A'x, at memory bandwidth: for tests that compare many columns. The rounding is independent of x, so the error of
    /// a product is about 0.1 % of the root of the sum of squares of its terms.
    pub fn transposed_times(&self, x: &DVector<f64>) -> DVector<f64> {
        let mut filled = vec![0.0; self.filled_rows];
        for (to, value) in filled.iter_mut().zip(x) {
            *to = *value as f32;
        }
        let x = &filled;
        DVector::from_vec(widest(RoundedTransposedTimes { a: self, x }))
    }
}

struct RoundedTransposedTimes<'a> {
    a: &'a Rounded,
    x: &'a [f32],
}

impl Task for RoundedTransposedTimes<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run<M: MulAdd>(self) -> Vec<f64> {
        const TOGETHER: usize = 4;
        // the leading half of the bits of a number in single precision
        let single = |value: bf16| f32::from_bits(u32::from(value.to_bits()) << 16);
        let (x, _) = self.x.as_chunks::<LANES>();
        let (values, _) = self.a.values.as_chunks::<LANES>();
        let mut out = vec![0.0; self.a.columns];
        for (columns, out) in values
            .chunks((x.len() * TOGETHER).max(1))
            .zip(out.chunks_mut(TOGETHER))
        {
            // fewer columns at the end: the last one is computed several times
            let last = out.len() - 1;
            let column: [&[[bf16; LANES]]; TOGETHER] =
                std::array::from_fn(|k| &columns[k.min(last) * x.len()..][..x.len()]);
            let mut lanes = [[0.0_f32; LANES]; TOGETHER];
            for (i, x) in x.iter().enumerate() {
                for k in 0..TOGETHER {
                    for lane in 0..LANES {
                        let value = single(column[k][i][lane]);
                        lanes[k][lane] = M::single_mul_add(value, x[lane], lanes[k][lane]);
                    }
                }
            }
            for (out, mut lanes) in out.iter_mut().zip(lanes) {
                // halves are added, so that no sum depends on the previous one
                let mut half = LANES / 2;
                while half > 0 {
                    for lane in 0..half {
                        lanes[lane] += lanes[lane + half];
                    }
                    half /= 2;
                }
                *out = f64::from(lanes[0]);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_with_vectors_are_those_of_the_formula() {
        // sizes that are and are not multiples of what is computed together
        for (rows, columns) in [(1, 1), (7, 9), (8, 4), (299, 101), (16, 3), (0, 5), (5, 0)] {
            let a = DMatrix::from_fn(rows, columns, |i, j| ((i * 7 + j * 3) as f64).sin());
            let [x, y] = [columns, rows].map(|n| DVector::from_fn(n, |i, _| (i as f64).cos()));
            let to = DVector::from_vec(times(&a, &x));
            let single = DVector::from_vec(times(&a.map(|value| value as f32), &x));
            assert!((single - &to).amax() < 1e-5, "{rows} x {columns}");
            let back = Rounded::new(&a).transposed_times(&y);
            assert_eq!((to.len(), back.len()), (rows, columns));
            assert!((to - &a * &x).amax() < 1e-12, "{rows} x {columns}");
            let of_rounded = a.map(|value| bf16::from_f64(value).to_f64()).tr_mul(&y);
            assert!((back - of_rounded).amax() < 1e-4, "{rows} x {columns}");
        }
    }
}
