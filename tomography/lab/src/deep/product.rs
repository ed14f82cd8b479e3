//! The three products of a fully connected layer, by tiles of rows, in f32.
//!
//! Matrices are row-major; `b` is the number of samples that lie side by side.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

/// Y = W X for some rows of W: `weights` rows x i, `inputs` i x b, `outputs` rows x b.
pub(super) fn forward(weights: &[f32], inputs: &[f32], outputs: &mut [f32], b: usize) {
    let (i, rows) = (inputs.len() / b, outputs.len() / b);
    let w = MatRef::from_row_major_slice(weights, rows, i);
    let x = MatRef::from_row_major_slice(inputs, i, b);
    let y = MatMut::from_row_major_slice_mut(outputs, rows, b);
    matmul(y, Accum::Replace, w, x, 1.0, Par::Seq);
}

/// Rows `first..` of dX = W' dY: `weights` o x i, `slopes` dY o x b, `outputs` rows x b.
pub(super) fn backward(
    weights: &[f32],
    slopes: &[f32],
    outputs: &mut [f32],
    first: usize,
    b: usize,
) {
    let (o, rows) = (slopes.len() / b, outputs.len() / b);
    let w = MatRef::from_row_major_slice(weights, o, weights.len() / o);
    let dy = MatRef::from_row_major_slice(slopes, o, b);
    let dx = MatMut::from_row_major_slice_mut(outputs, rows, b);
    let columns = w.transpose().subrows(first, rows);
    matmul(dx, Accum::Replace, columns, dy, 1.0, Par::Seq);
}

/// dW = dY X' for some rows: `slopes` rows x b, `inputs` i x b, `gradient` rows x i.
pub(super) fn gradient(slopes: &[f32], inputs: &[f32], gradient: &mut [f32], b: usize) {
    let (i, rows) = (inputs.len() / b, slopes.len() / b);
    let dy = MatRef::from_row_major_slice(slopes, rows, b);
    let x = MatRef::from_row_major_slice(inputs, i, b);
    let dw = MatMut::from_row_major_slice_mut(gradient, rows, i);
    matmul(dw, Accum::Replace, dy, x.transpose(), 1.0, Par::Seq);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_products_are_what_their_formulas_say() {
        let wave =
            |n: usize, step: f32| -> Vec<f32> { (0..n).map(|i| (i as f32 * step).sin()).collect() };
        let (i, o, b) = (5, 7, 3);
        let (w, x, dy) = (wave(o * i, 0.7), wave(i * b, 0.3), wave(o * b, 1.1));
        let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-5, "{a} {b}");
        let mut y = vec![0.0; 3 * b];
        forward(&w[2 * i..5 * i], &x, &mut y, b);
        let mut dx = vec![0.0; 2 * b];
        backward(&w, &dy, &mut dx, 3, b);
        let mut dw = vec![0.0; 3 * i];
        gradient(&dy[2 * b..5 * b], &x, &mut dw, b);
        for row in 0..3 {
            for s in 0..b {
                close(
                    y[row * b + s],
                    (0..i).map(|k| w[(row + 2) * i + k] * x[k * b + s]).sum(),
                );
            }
            for k in 0..i {
                close(
                    dw[row * i + k],
                    (0..b).map(|s| dy[(row + 2) * b + s] * x[k * b + s]).sum(),
                );
            }
        }
        for row in 0..2 {
            for s in 0..b {
                close(
                    dx[row * b + s],
                    (0..o).map(|k| w[k * i + row + 3] * dy[k * b + s]).sum(),
                );
            }
        }
    }
}
