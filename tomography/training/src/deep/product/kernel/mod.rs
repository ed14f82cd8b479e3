//! The innermost loops, for AVX-512, for AVX2 with FMA, and portable: a block of rows and columns stays in registers
//! during the summation. One core of a Zen 4 runs them at 110 (AVX2: 100) GFLOP/s; a general matrix product reached 60
//! to 70 for these shapes.
//!
//! The last bits of a result depend on the machine's instruction set, never on the number of threads.
#![allow(unsafe_code)]

use super::{PANEL, STRIP, TILE};

/// Numbers in a strip of a tile.
const BLOCK: usize = TILE * STRIP;

/// Calls a kernel for the best instruction set of the machine.
macro_rules! best {
    ($name:ident($($argument:expr),*)) => {{
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: AVX-512F was detected above.
            return unsafe { wide::$name($($argument),*) };
        } else if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: AVX2 and FMA were detected above.
            return unsafe { half_wide::$name($($argument),*) };
        }
        portable::$name($($argument),*)
    }};
}

/// Y += W X for one tile of outputs. `weights`: the panels of this tile; `inputs`: all tiles of X; `outputs`: the tile
/// of Y.
pub(in super::super) fn forward(weights: &[f32], inputs: &[f32], outputs: &mut [f32]) {
    best!(forward(weights, inputs, outputs))
}

/// dX += W' dY for tile `tile` of the inputs. `weights`: all of W; `slopes`: all tiles of dY; `outputs`: the tile of
/// dX.
pub(in super::super) fn backward(
    weights: &[f32],
    slopes: &[f32],
    tile: usize,
    outputs: &mut [f32],
) {
    best!(backward(weights, slopes, tile, outputs))
}

/// dW' = X dY' for a tile of inputs and a pair of panels. `turned`: one row per sample with the slopes of both panels;
/// `inputs`: the tile; `gradient`: first one panel, then the other.
pub(in super::super) fn gradient(turned: &[f32], inputs: &[f32], gradient: &mut [f32]) {
    best!(gradient(turned, inputs, gradient))
}

/// One step of Adam; `constants` are beta1, beta2, rate and epsilon; all slices have the same length.
pub(in super::super) fn adam(
    constants: [f32; 4],
    values: &mut [f32],
    moments: [&mut [f32]; 2],
    gradient: &[f32],
) {
    best!(adam(constants, values, moments, gradient))
}

macro_rules! kernels {
    ($module:ident, $($features:literal)?, $lanes:literal, $rows:literal, $vector:ty, $zero:expr, $load:expr, $store:expr,
     $all:expr, $fma:expr) => {
        mod $module {
            #[cfg(target_arch = "x86_64")]
            #[allow(unused_imports)]
            use std::arch::x86_64::*;

            use super::*;

            const VECTORS: usize = 2;
            /// Columns of a block in registers.
            const PART: usize = VECTORS * $lanes;
            /// Rows of a block.
            const ROWS: usize = $rows;
            type Block = [[$vector; VECTORS]; ROWS];

            /// # Safety
            /// `from` has ROWS rows of PART entries, `step` apart.
            #[inline]
            $(#[target_feature(enable = $features)])?
            unsafe fn load(from: *const f32, step: usize) -> Block {
                let mut block = [[$zero; VECTORS]; ROWS];
                for (r, row) in block.iter_mut().enumerate() {
                    for (v, vector) in row.iter_mut().enumerate() {
                        // SAFETY: within the rows guaranteed by the caller.
                        *vector = unsafe { $load(from.add(r * step + v * $lanes)) };
                    }
                }
                block
            }

            /// # Safety
            /// As [`load`].
            #[inline]
            $(#[target_feature(enable = $features)])?
            unsafe fn store(to: *mut f32, step: usize, block: &Block) {
                for (r, row) in block.iter().enumerate() {
                    for (v, vector) in row.iter().enumerate() {
                        // SAFETY: within the rows guaranteed by the caller.
                        unsafe { $store(to.add(r * step + v * $lanes), *vector) };
                    }
                }
            }

            /// `block[r] += sum_k a[k * ak + r * ar] b[k * bk ..]` over `count` k.
            ///
            /// # Safety
            /// `a` and `b` have those entries, PART of them in each row of `b`.
            #[inline]
            $(#[target_feature(enable = $features)])?
            unsafe fn add(
                block: &mut Block,
                (a, ak, ar): (*const f32, usize, usize),
                (b, bk): (*const f32, usize),
                count: usize,
            ) {
                for k in 0..count {
                    let mut columns = [$zero; VECTORS];
                    for (v, column) in columns.iter_mut().enumerate() {
                        // SAFETY: guaranteed by the caller.
                        *column = unsafe { $load(b.add(k * bk + v * $lanes)) };
                    }
                    for (r, row) in block.iter_mut().enumerate() {
                        // SAFETY: guaranteed by the caller.
                        let all = $all(unsafe { *a.add(k * ak + r * ar) });
                        for (sum, column) in row.iter_mut().zip(columns) {
                            *sum = $fma(all, column, *sum);
                        }
                    }
                }
            }

            $(#[target_feature(enable = $features)])?
            pub(super) fn forward(weights: &[f32], inputs: &[f32], outputs: &mut [f32]) {
                let strips = outputs.len() / BLOCK;
                let panel = weights.len() / (TILE / PANEL);
                assert_eq!(inputs.len() / (strips * STRIP), panel / PANEL);
                for (tile, inputs) in inputs.chunks_exact(strips * BLOCK).enumerate() {
                    for (inputs, outputs) in
                        inputs.chunks_exact(BLOCK).zip(outputs.chunks_exact_mut(BLOCK))
                    {
                        for (p, weights) in weights.chunks_exact(panel).enumerate() {
                            let weights = &weights[tile * TILE * PANEL..][..TILE * PANEL];
                            for h in (0..PANEL).step_by(ROWS) {
                                let rows = &mut outputs[(p * PANEL + h) * STRIP..][..ROWS * STRIP];
                                for part in (0..STRIP).step_by(PART) {
                                    let to = rows.as_mut_ptr().wrapping_add(part);
                                    let w = weights.as_ptr().wrapping_add(h);
                                    let x = inputs.as_ptr().wrapping_add(part);
                                    // SAFETY: `rows` has ROWS rows of STRIP entries; `weights` TILE rows of PANEL, of
                                    // which ROWS from h on are read; `inputs` TILE rows of STRIP. PART divides STRIP
                                    // and ROWS divides PANEL.
                                    unsafe {
                                        let mut block = load(to, STRIP);
                                        add(&mut block, (w, PANEL, 1), (x, STRIP), TILE);
                                        store(to, STRIP, &block);
                                    }
                                }
                            }
                        }
                    }
                }
            }

            $(#[target_feature(enable = $features)])?
            pub(super) fn backward(
                weights: &[f32],
                slopes: &[f32],
                tile: usize,
                outputs: &mut [f32],
            ) {
                let strips = outputs.len() / BLOCK;
                let panels = slopes.len() / (strips * STRIP * PANEL);
                let panel = weights.len() / panels;
                for (above, slopes) in slopes.chunks_exact(strips * BLOCK).enumerate() {
                    let weights = &weights[above * (TILE / PANEL) * panel..][..TILE / PANEL * panel];
                    for (slopes, outputs) in
                        slopes.chunks_exact(BLOCK).zip(outputs.chunks_exact_mut(BLOCK))
                    {
                        for g in (0..TILE).step_by(ROWS) {
                            let rows = &mut outputs[g * STRIP..][..ROWS * STRIP];
                            for part in (0..STRIP).step_by(PART) {
                                let to = rows.as_mut_ptr().wrapping_add(part);
                                // SAFETY: `rows` has ROWS rows of STRIP entries.
                                let mut block = unsafe { load(to, STRIP) };
                                for (weights, slopes) in
                                    weights.chunks_exact(panel).zip(slopes.chunks_exact(PANEL * STRIP))
                                {
                                    let w = &weights[(tile * TILE + g) * PANEL..][..ROWS * PANEL];
                                    let dy = slopes.as_ptr().wrapping_add(part);
                                    // SAFETY: `w` has ROWS rows of PANEL entries, `slopes` PANEL rows of STRIP.
                                    unsafe {
                                        add(&mut block, (w.as_ptr(), 1, PANEL), (dy, STRIP), PANEL);
                                    }
                                }
                                // SAFETY: as for `load`.
                                unsafe { store(to, STRIP, &block) };
                            }
                        }
                    }
                }
            }

            $(#[target_feature(enable = $features)])?
            pub(super) fn gradient(turned: &[f32], inputs: &[f32], gradient: &mut [f32]) {
                const PAIR: usize = 2 * PANEL;
                assert!(turned.len() == inputs.len() / TILE * PAIR && gradient.len() == PAIR * TILE);
                for g in (0..TILE).step_by(ROWS) {
                    for part in (0..PAIR).step_by(PART) {
                        let mut block = [[$zero; VECTORS]; ROWS];
                        for (inputs, turned) in
                            inputs.chunks_exact(BLOCK).zip(turned.chunks_exact(STRIP * PAIR))
                        {
                            let x = &inputs[g * STRIP..][..ROWS * STRIP];
                            let dy = turned.as_ptr().wrapping_add(part);
                            // SAFETY: `x` has ROWS rows of STRIP entries, `turned` STRIP rows of PAIR; PART divides
                            // PAIR.
                            unsafe { add(&mut block, (x.as_ptr(), 1, STRIP), (dy, PAIR), STRIP) };
                        }
                        for (r, row) in block.iter().enumerate() {
                            for (v, vector) in row.iter().enumerate() {
                                let column = part + v * $lanes;
                                let at = (column / PANEL * TILE + g + r) * PANEL + column % PANEL;
                                let to = &mut gradient[at..][..$lanes];
                                // SAFETY: `to` has as many entries as a vector.
                                unsafe { $store(to.as_mut_ptr(), *vector) };
                            }
                        }
                    }
                }
            }

            $(#[target_feature(enable = $features)])?
            pub(super) fn adam(
                [beta1, beta2, rate, epsilon]: [f32; 4],
                values: &mut [f32],
                [first, second]: [&mut [f32]; 2],
                gradient: &[f32],
            ) {
                let (g1, g2) = (1.0 - beta1, 1.0 - beta2);
                for (((value, m), v), g) in values.iter_mut().zip(first).zip(second).zip(gradient) {
                    *m = beta1 * *m + g1 * g;
                    *v = beta2 * *v + g2 * (g * g);
                    *value -= rate * *m / (v.sqrt() + epsilon);
                }
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
kernels!(
    wide,
    "avx512f",
    16,
    8,
    __m512,
    _mm512_setzero_ps(),
    _mm512_loadu_ps,
    _mm512_storeu_ps,
    _mm512_set1_ps,
    _mm512_fmadd_ps
);

#[cfg(target_arch = "x86_64")]
kernels!(
    half_wide,
    "avx2,fma",
    8,
    4,
    __m256,
    _mm256_setzero_ps(),
    _mm256_loadu_ps,
    _mm256_storeu_ps,
    _mm256_set1_ps,
    _mm256_fmadd_ps
);

kernels!(
    portable, , 4, 4, [f32; 4], [0.0; 4],
    |from: *const f32| from.cast::<[f32; 4]>().read(),
    |to: *mut f32, vector: [f32; 4]| to.cast::<[f32; 4]>().write(vector),
    |value: f32| [value; 4],
    |a: [f32; 4], b: [f32; 4], c: [f32; 4]| [0, 1, 2, 3].map(|i: usize| a[i] * b[i] + c[i])
);

#[cfg(test)]
mod tests;
