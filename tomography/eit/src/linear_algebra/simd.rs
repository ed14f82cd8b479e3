//! Short loops over slices, compiled for the baseline processor and for AVX2 and AVX-512, so that the compiler uses the
//! widest vectors available. The order of every sum is fixed by its lanes and nothing is fused: all versions give the
//! same bits.
#![allow(unsafe_code)]

const LANES: usize = 16;

/// Makes `name` call the version of `body` for the best instruction set of the machine.
macro_rules! widened {
    ($(#[$about:meta])* $vis:vis $name:ident by $body:ident ($($argument:ident: $type:ty),*) $(-> $result:ty)?) => {
        $(#[$about])*
        $vis fn $name($($argument: $type),*) $(-> $result)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f")]
                fn wide($($argument: $type),*) $(-> $result)? {
                    $body($($argument),*)
                }
                #[target_feature(enable = "avx2")]
                fn half_wide($($argument: $type),*) $(-> $result)? {
                    $body($($argument),*)
                }
                if is_x86_feature_detected!("avx512f") {
                    // SAFETY: AVX-512F was detected above.
                    return unsafe { wide($($argument),*) };
                } else if is_x86_feature_detected!("avx2") {
                    // SAFETY: AVX2 was detected above.
                    return unsafe { half_wide($($argument),*) };
                }
            }
            $body($($argument),*)
        }
    };
}

widened!(
    /// Squared distance, from direct differences: exactly 0 for identical rows.
    pub squared_distance by distance_body(a: &[f32], b: &[f64]) -> f64
);
widened!(
    /// Sum of products.
    pub(crate) dot by dot_body(a: &[f64], b: &[f64]) -> f64
);
widened!(
    /// `to += sum_k amounts[k] rows[k]`, rows of the length of `to`.
    pub(crate) add_four by add_body(to: &mut [f32], rows: [&[f32]; 4], amounts: [f32; 4])
);

#[inline(always)]
fn distance_body(a: &[f32], b: &[f64]) -> f64 {
    let mut lanes = [0.0_f64; LANES];
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            let difference = f64::from(a[lane]) - b[lane];
            lanes[lane] += difference * difference;
        }
    }
    let rest = a_rest.iter().zip(b_rest);
    let rest: f64 = rest.map(|(a, b)| (f64::from(*a) - b).powi(2)).sum();
    lanes.iter().sum::<f64>() + rest
}

#[inline(always)]
fn dot_body(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0_f64; LANES];
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    lanes.iter().sum::<f64>() + rest
}

#[inline(always)]
fn add_body(to: &mut [f32], [a, b, c, d]: [&[f32]; 4], [ka, kb, kc, kd]: [f32; 4]) {
    for (to, ((a, b), (c, d))) in to.iter_mut().zip(a.iter().zip(b).zip(c.iter().zip(d))) {
        *to += (ka * a + kb * b) + (kc * c + kd * d);
    }
}

#[cfg(test)]
mod tests {
    use crate::linear_algebra::simd::*;

    /// 83 entries: not a multiple of any vector length.
    fn wave(step: f64) -> Vec<f64> {
        (0..83).map(|i| (f64::from(i) * step).sin()).collect()
    }

    fn narrow(values: &[f64]) -> Vec<f32> {
        values.iter().map(|value| *value as f32).collect()
    }

    #[test]
    fn every_instruction_set_gives_same_bits_as_the_formula() {
        let (a, b) = (wave(0.7), wave(0.3));
        let short = narrow(&a);
        let found = squared_distance(&short, &b);
        assert_eq!(found.to_bits(), distance_body(&short, &b).to_bits());
        let exact: f64 = short
            .iter()
            .zip(&b)
            .map(|(a, b)| (f64::from(*a) - b).powi(2))
            .sum();
        assert!((found - exact).abs() < 1e-13 * exact);
        let found = dot(&a, &b);
        assert_eq!(found.to_bits(), dot_body(&a, &b).to_bits());
        let exact: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
        assert!((found - exact).abs() < 1e-13);
        let rows = [wave(0.1), wave(0.2), wave(0.4), wave(0.5)].map(|row| narrow(&row));
        let rows = [&rows[0][..], &rows[1], &rows[2], &rows[3]];
        let (mut wide, mut plain) = (short.clone(), short.clone());
        add_four(&mut wide, rows, [0.5, -1.0, 2.0, 0.25]);
        add_body(&mut plain, rows, [0.5, -1.0, 2.0, 0.25]);
        assert_eq!(wide, plain);
        let exact =
            short[40] + 0.5 * rows[0][40] - rows[1][40] + 2.0 * rows[2][40] + 0.25 * rows[3][40];
        assert!((wide[40] - exact).abs() < 1e-6);
    }

    #[test]
    fn identical_rows_are_at_distance_zero() {
        let row: Vec<f32> = (0..598).map(|i| (i as f32).sin()).collect();
        let wide: Vec<f64> = row.iter().map(|value| f64::from(*value)).collect();
        assert_eq!(squared_distance(&row, &wide), 0.0);
    }
}
