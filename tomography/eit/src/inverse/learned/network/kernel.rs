//! Matrix times vector for the three precisions of weights. A frame is one pass over all weights, so these loops are
//! limited by memory bandwidth; the portable loops convert f16 and int8 more slowly than that, the vectorised ones do
//! not (`cargo run --release -p tactus-eit --example deep_time` prints both).
//!
//! The last bits of a result depend on the machine's instruction set, never on the number of threads.
#![allow(unsafe_code)]

use half::f16;

use crate::inverse::learned::network::weights::Rows;

/// `output[r] = sum_i weights[r][i] input[i]`; rows of as many entries as `input`.
pub(super) fn multiply(weights: Rows<'_>, input: &[f32], output: &mut [f32]) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx512f") {
        // SAFETY: AVX-512F was detected above.
        return unsafe { wide::multiply(weights, input, output) };
    } else if is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("fma")
        && is_x86_feature_detected!("f16c")
    {
        // SAFETY: AVX2, FMA and F16C were detected above.
        return unsafe { half_wide::multiply(weights, input, output) };
    }
    portable(weights, input, output);
}

fn portable(weights: Rows<'_>, input: &[f32], output: &mut [f32]) {
    fn each<W: Copy>(weights: &[W], input: &[f32], output: &mut [f32], value: impl Fn(W) -> f32) {
        const LANES: usize = 16;
        for (row, output) in weights.chunks_exact(input.len()).zip(output) {
            let mut lanes = [0.0_f32; LANES];
            let (ws, xs) = (row.chunks_exact(LANES), input.chunks_exact(LANES));
            let rest: f32 = ws
                .remainder()
                .iter()
                .zip(xs.remainder())
                .map(|(w, x)| value(*w) * x)
                .sum();
            for (w, x) in ws.zip(xs) {
                for lane in 0..LANES {
                    lanes[lane] += value(w[lane]) * x[lane];
                }
            }
            *output = lanes.iter().sum::<f32>() + rest;
        }
    }
    match weights {
        Rows::F32(weights) => each(weights, input, output, |w| w),
        Rows::F16(weights) => each(weights, input, output, f16::to_f32),
        Rows::Int8(weights, scales) => {
            each(weights, input, output, f32::from);
            for (output, scale) in output.iter_mut().zip(scales) {
                *output *= scale;
            }
        }
    }
}

/// Prefetch distance for weights, bytes.
#[cfg(target_arch = "x86_64")]
const AHEAD: usize = 4096;

/// The loop over rows and lanes for one instruction set: four sums per row hide the latency of the multiply-add. Rows
/// are read one after another, as one stream: four at once ran at two thirds of the speed on memory with small pages.
#[cfg(target_arch = "x86_64")]
macro_rules! kernel {
    ($module:ident, $features:literal, $lanes:literal, $vector:ty, $zero:expr, $fma:expr, $add:expr, $sum:expr,
     $f32:expr, $f16:expr, $i8:expr) => {
        mod $module {
            use std::arch::x86_64::*;

            use half::f16;

            use super::{AHEAD, Rows};

            #[target_feature(enable = $features)]
            pub(super) fn multiply(weights: Rows<'_>, input: &[f32], output: &mut [f32]) {
                match weights {
                    // SAFETY of the three: the loads read $lanes entries, which `each` guarantees.
                    Rows::F32(weights) => {
                        each(weights, input, output, |w| unsafe { $f32(w) }, |w| w)
                    }
                    Rows::F16(weights) => {
                        each(weights, input, output, |w| unsafe { $f16(w) }, f16::to_f32)
                    }
                    Rows::Int8(weights, scales) => {
                        each(weights, input, output, |w| unsafe { $i8(w) }, f32::from);
                        for (output, scale) in output.iter_mut().zip(scales) {
                            *output *= scale;
                        }
                    }
                }
            }

            /// `load` gets pointers to at least $lanes entries.
            #[inline]
            #[target_feature(enable = $features)]
            fn each<W: Copy>(
                weights: &[W],
                input: &[f32],
                output: &mut [f32],
                load: impl Fn(*const W) -> $vector,
                value: impl Fn(W) -> f32,
            ) {
                const LANES: usize = $lanes;
                for (row, output) in weights.chunks_exact(input.len()).zip(output) {
                    let mut sums = [$zero; 4];
                    let (ws, xs) = (row.chunks_exact(4 * LANES), input.chunks_exact(4 * LANES));
                    let mut rest = 0.0;
                    for (w, x) in ws.remainder().iter().zip(xs.remainder()) {
                        rest += value(*w) * x;
                    }
                    for (w, x) in ws.zip(xs) {
                        // hardware prefetching is too slow for weights narrower than f32
                        if size_of::<W>() < 4 {
                            for line in (0..size_of_val(w)).step_by(64) {
                                let ahead = w.as_ptr().cast::<i8>().wrapping_add(AHEAD + line);
                                // SAFETY: a prefetch is valid for any address.
                                _mm_prefetch::<_MM_HINT_T0>(ahead);
                            }
                        }
                        for (k, sum) in sums.iter_mut().enumerate() {
                            // SAFETY: both slices have 4 LANES entries, and k is below 4.
                            let x = unsafe { $f32(x.as_ptr().add(k * LANES)) };
                            let w = load(w[k * LANES..].as_ptr());
                            *sum = $fma(w, x, *sum);
                        }
                    }
                    let sum = $add($add(sums[0], sums[1]), $add(sums[2], sums[3]));
                    *output = $sum(sum) + rest;
                }
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
kernel!(
    wide,
    "avx512f",
    16,
    __m512,
    _mm512_setzero_ps(),
    _mm512_fmadd_ps,
    _mm512_add_ps,
    _mm512_reduce_add_ps,
    |w: *const f32| _mm512_loadu_ps(w),
    |w: *const f16| _mm512_cvtph_ps(_mm256_loadu_si256(w.cast())),
    |w: *const i8| _mm512_cvtepi32_ps(_mm512_cvtepi8_epi32(_mm_loadu_si128(w.cast())))
);

#[cfg(target_arch = "x86_64")]
kernel!(
    half_wide,
    "avx2,fma,f16c",
    8,
    __m256,
    _mm256_setzero_ps(),
    _mm256_fmadd_ps,
    _mm256_add_ps,
    |sum: __m256| {
        let pairs = _mm_add_ps(_mm256_castps256_ps128(sum), _mm256_extractf128_ps::<1>(sum));
        let pairs = _mm_add_ps(pairs, _mm_movehl_ps(pairs, pairs));
        _mm_cvtss_f32(_mm_add_ss(pairs, _mm_movehdup_ps(pairs)))
    },
    |w: *const f32| _mm256_loadu_ps(w),
    |w: *const f16| _mm256_cvtph_ps(_mm_loadu_si128(w.cast())),
    |w: *const i8| _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_loadl_epi64(w.cast())))
);

#[cfg(test)]
mod tests {
    use crate::inverse::learned::network::kernel::*;

    /// Five rows (not divisible by four) of 83 entries (not divisible by any vector length).
    fn sample() -> (Vec<f32>, Vec<f32>) {
        let wave = |n: usize, step: f32| (0..n).map(|i| (i as f32 * step).sin()).collect();
        (wave(5 * 83, 0.7), wave(83, 0.3))
    }

    fn close(a: &[f32], b: &[f32]) -> bool {
        let top = a.iter().fold(0.0_f32, |top, value| top.max(value.abs()));
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-6 * top)
    }

    #[test]
    fn every_set_of_instructions_gives_the_same_result() {
        let (weights, input) = sample();
        let halves: Vec<f16> = weights.iter().map(|w| f16::from_f32(*w)).collect();
        let bytes: Vec<i8> = weights.iter().map(|w| (w * 127.0) as i8).collect();
        let scales = [0.1, 0.2, 0.3, 0.4, 0.05];
        for rows in [
            Rows::F32(&weights),
            Rows::F16(&halves),
            Rows::Int8(&bytes, &scales),
        ] {
            let mut plain = [0.0; 5];
            portable(rows, &input, &mut plain);
            let mut chosen = [0.0; 5];
            multiply(rows, &input, &mut chosen);
            assert!(close(&plain, &chosen), "{plain:?} {chosen:?}");
            #[cfg(target_arch = "x86_64")]
            if is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("fma")
                && is_x86_feature_detected!("f16c")
            {
                // SAFETY: the features were detected above.
                unsafe { half_wide::multiply(rows, &input, &mut chosen) };
                assert!(close(&plain, &chosen), "{plain:?} {chosen:?}");
            }
        }
    }
}
