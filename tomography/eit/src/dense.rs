//! Dense products and factorisations: nalgebra holds the numbers, faer multiplies and factors them.
//!
//! faer is built without threads here, so every result has the same bits on any number of threads; callers that want
//! two cores cut their own work into fixed chunks.

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::solvers::Solve;
use faer::{Accum, Mat, MatMut, MatRef, Par, Side};
use nalgebra::{DMatrix, DVector};

/// The same numbers as faer sees them.
pub(crate) fn view(matrix: &DMatrix<f64>) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(matrix.as_slice(), matrix.nrows(), matrix.ncols())
}

/// a b
pub(crate) fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> DMatrix<f64> {
    let (rows, columns) = (a.nrows(), b.ncols());
    let mut out = DMatrix::zeros(rows, columns);
    let into = MatMut::from_column_major_slice_mut(out.as_mut_slice(), rows, columns);
    matmul(into, Accum::Replace, a, b, 1.0, Par::Seq);
    out
}

/// The inverse of a symmetric positive definite matrix, symmetric to the last bit; `None` where it is not definite.
pub(crate) fn inverse_of_definite(a: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = a.nrows();
    let factor = view(a).llt(Side::Lower).ok()?;
    let mut inverse = Mat::<f64>::identity(n, n);
    factor.solve_in_place(inverse.as_mut());
    let out = DMatrix::from_fn(n, n, |i, j| 0.5 * (inverse[(i, j)] + inverse[(j, i)]));
    out.iter().all(|value| value.is_finite()).then_some(out)
}

/// Solves a x = b for symmetric positive definite a; `None` where it is not definite.
pub(crate) fn solve_definite(a: &DMatrix<f64>, b: &[f64]) -> Option<Vec<f64>> {
    let factor = view(a).llt(Side::Lower).ok()?;
    let mut x = Mat::<f64>::from_fn(b.len(), 1, |i, _| b[i]);
    factor.solve_in_place(x.as_mut());
    Some((0..b.len()).map(|i| x[(i, 0)]).collect())
}

/// Eigenvalues (ascending) and orthonormal eigenvectors (columns) of a symmetric matrix.
pub(crate) fn symmetric_eigen(a: &DMatrix<f64>) -> Option<(Vec<f64>, DMatrix<f64>)> {
    let n = a.nrows();
    let eigen = view(a).self_adjoint_eigen(Side::Lower).ok()?;
    let (s, u) = (eigen.S(), eigen.U());
    let values = (0..n).map(|i| s[i]).collect();
    Some((values, DMatrix::from_fn(n, n, |i, j| u[(i, j)])))
}

/// A factor of a symmetric positive definite matrix, for several right-hand sides.
pub(crate) struct Definite(faer::linalg::solvers::Llt<f64>);

impl Definite {
    /// `None` where the matrix is not definite.
    pub(crate) fn new(a: &DMatrix<f64>) -> Option<Self> {
        view(a).llt(Side::Lower).ok().map(Self)
    }

    pub(crate) fn solve(&self, b: &DVector<f64>) -> DVector<f64> {
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

/// J W J' with the diagonal W that `weight` gives, positive entries; columns without a weight are left out.
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
    let scaled = MatRef::from_column_major_slice(&scaled, rows, columns);
    let mut out = DMatrix::zeros(rows, rows);
    let into = MatMut::from_column_major_slice_mut(out.as_mut_slice(), rows, rows);
    triangular::matmul(
        into,
        BlockStructure::TriangularLower,
        Accum::Replace,
        scaled,
        BlockStructure::Rectangular,
        scaled.transpose(),
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
    out.fill_upper_triangle_with_lower_triangle();
    out
}

/// A'A
pub(crate) fn gram_of_columns(a: &DMatrix<f64>) -> DMatrix<f64> {
    let columns = a.ncols();
    let mut out = DMatrix::zeros(columns, columns);
    let into = MatMut::from_column_major_slice_mut(out.as_mut_slice(), columns, columns);
    triangular::matmul(
        into,
        BlockStructure::TriangularLower,
        Accum::Replace,
        view(a).transpose(),
        BlockStructure::Rectangular,
        view(a),
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
    out.fill_upper_triangle_with_lower_triangle();
    out
}

/// A'x
pub(crate) fn transposed_times(a: &DMatrix<f64>, x: &DVector<f64>) -> DVector<f64> {
    let x = MatRef::from_column_major_slice(x.as_slice(), x.len(), 1);
    let product = product(view(a).transpose(), x);
    DVector::from_column_slice(product.as_slice())
}
