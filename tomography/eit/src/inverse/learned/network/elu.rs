//! The exponential linear unit, written so that the compiler vectorises it.

/// elu(x) = x for x > 0, otherwise e^x - 1, in place; within 2e-7 of the larger of 1 and |x|.
pub fn elu(values: &mut [f32]) {
    for value in values {
        *value = one(*value);
    }
}

/// d elu(x) / dx from y = elu(x): 1 for y > 0, otherwise y + 1.
#[inline(always)]
pub fn elu_slope(y: f32) -> f32 {
    y.min(0.0) + 1.0
}

/// e^x - 1 = 2^n (q + 1) - 1 with x = n ln 2 + r and q = e^r - 1 from its series: no call, no branch.
#[inline(always)]
fn one(x: f32) -> f32 {
    /// Adding and subtracting it rounds to a whole number.
    const ROUND: f32 = 12_582_912.0;
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    // below -87, e^x is negligible relative to 1; a NaN passes through clamp and series
    let low = x.clamp(-87.0, 0.0);
    let shifted = low * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = low - n * LN_2[0] - n * LN_2[1];
    let series = 1.0 / 5040.0;
    let series = series * r + 1.0 / 720.0;
    let series = series * r + 1.0 / 120.0;
    let series = series * r + 1.0 / 24.0;
    let series = series * r + 1.0 / 6.0;
    let series = series * r + 0.5;
    let q = series * r * r + r;
    let power = f32::from_bits(((n as i32 + 127) as u32) << 23);
    x.max(0.0) + (power * q + (power - 1.0))
}

#[cfg(test)]
mod tests {
    use crate::inverse::learned::network::elu::*;

    #[test]
    fn elu_is_the_formula() {
        for i in -2000..400 {
            let x = i as f32 * 0.05 + 1e-4;
            let mut y = [x];
            elu(&mut y);
            let exact = if x > 0.0 {
                f64::from(x)
            } else {
                f64::from(x).exp_m1()
            };
            let error = (f64::from(y[0]) - exact).abs() / f64::from(x.abs().max(1.0));
            assert!(error < 2e-7, "{x}: {} {exact}", y[0]);
        }
        // small arguments keep their digits
        let mut y = [-1e-6_f32];
        elu(&mut y);
        assert!((y[0] + 1e-6).abs() < 1e-12);
    }

    #[test]
    fn no_number_stays_none() {
        let mut y = [f32::NAN, f32::NEG_INFINITY, f32::INFINITY];
        elu(&mut y);
        assert!(y[0].is_nan());
        assert_eq!(y[1..], [-1.0, f32::INFINITY]);
    }

    #[test]
    fn the_slope_is_the_difference() {
        for x in [-3.0_f32, -0.2, 0.4] {
            let mut y = [x - 1e-3, x, x + 1e-3];
            elu(&mut y);
            assert!(((y[2] - y[0]) / 2e-3 - elu_slope(y[1])).abs() < 1e-3);
        }
    }
}
