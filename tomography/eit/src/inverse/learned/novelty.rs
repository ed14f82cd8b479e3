//! The part of a frame that no map explains: the data outside the sensitivity's range.

use nalgebra::{DMatrix, DVector};

use crate::Novelty;
use crate::linear_algebra::dense;

/// A direction of the data is dropped if a map of root mean square 0.1 changes it by at most this share of its noise.
pub(crate) const UNSEEN: f64 = 1e-4;
/// Root mean square of the unexplained part, in standard deviations of the noise, above which a frame is novel.
const NEW: f64 = 3.0;

/// Orthonormal directions of the data (columns) that maps change; `sensitivity` in standard deviations of the noise.
/// `None` if there are none.
pub(crate) fn directions(sensitivity: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let unknowns = sensitivity.ncols() as f64;
    directions_above(sensitivity, |_| UNSEEN / (0.1 * unknowns.sqrt()))
}

/// The directions whose singular value is above a floor, computed from the largest.
pub(crate) fn directions_above(
    sensitivity: &DMatrix<f64>,
    floor: impl Fn(f64) -> f64,
) -> Option<DMatrix<f64>> {
    let (values, vectors) = dense::symmetric_eigen(&dense::gram(sensitivity, |_| Some(1.0)))?;
    let floor = floor(values.last().copied()?.max(0.0).sqrt());
    let kept: Vec<usize> = (0..values.len())
        .filter(|&i| values[i] > floor * floor)
        .collect();
    (!kept.is_empty()).then(|| vectors.select_columns(&kept))
}

/// The root mean square, in standard deviations, of the data outside `directions`; missing readings are first estimated
/// from the others.
pub(crate) fn unexplained(
    directions: &DMatrix<f64>,
    data: &[f64],
    missing: &[usize],
) -> Option<Novelty> {
    let kept: Vec<usize> = (0..data.len())
        .filter(|reading| missing.binary_search(reading).is_err())
        .collect();
    let rows = directions.select_rows(&kept);
    let data = DVector::from_iterator(kept.len(), kept.iter().map(|&reading| data[reading]));
    let free = kept
        .len()
        .checked_sub(rows.ncols())
        .filter(|free| *free > 0)?;
    let seen = rows.tr_mul(&data);
    let explained = if missing.is_empty() {
        seen
    } else {
        let mut gram = dense::gram_of_columns(&rows);
        for i in 0..gram.nrows() {
            gram[(i, i)] += 1e-12;
        }
        DVector::from_vec(dense::solve_definite(&gram, seen.as_slice())?)
    };
    let left = (data - rows * explained).norm_squared();
    Some(Novelty {
        value: (left / free as f64).sqrt(),
        limit: NEW,
        measure: "root mean square of the change that no map explains, in standard deviations of the noise",
    })
}
