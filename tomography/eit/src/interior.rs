//! An interior method for min |J x - d|^2 / 2 + c x'Rx / 2 over -1 <= x <= 0: primal and dual, with Mehrotra's
//! predictor and corrector (J. Nocedal, S. Wright, Numerical Optimization, 2nd ed., section 16.6).
//!
//! It needs some twenty factorisations in the space of readings whatever the conditioning, where Newton's method on the
//! dual may crawl; each is of I + J D^-1 J' with a positive diagonal D, which is always definite.

use nalgebra::{DMatrix, DVector};

use crate::dense;

const MOST_STEPS: usize = 60;
/// Mean product of slack and multiplier, with the largest entry of J'd as unit, at which to stop.
const GAP: f64 = 1e-14;
/// Largest entry of the gradient less the multipliers, in the same unit, at which to stop.
const RESIDUAL: f64 = 1e-11;
/// Distance from a bound within which an unknown is on it.
const SNAP: f64 = 1e-7;
/// Share of the way to the nearest bound.
const STEP: f64 = 0.995;

/// A point strictly within the bounds and close to the minimum; `None` where the numbers gave out at once.
pub(crate) fn solve(
    sensitivity: &DMatrix<f64>,
    penalty: &[f64],
    square: f64,
    data: &DVector<f64>,
) -> Option<DVector<f64>> {
    let n = penalty.len();
    let unit = sensitivity.tr_mul(data).amax();
    if !(unit > 0.0 && unit.is_finite()) {
        return None;
    }
    // J and d divided by the root of the unit: the gradient at zero is then of size 1
    let j = sensitivity / unit.sqrt();
    let d = data / unit.sqrt();
    let ridge: Vec<f64> = penalty.iter().map(|r| square * r / unit).collect();

    let mut x = DVector::from_element(n, -0.5);
    let mut low = DVector::from_element(n, 1.0);
    let mut high = DVector::from_element(n, 1.0);
    for _ in 0..MOST_STEPS {
        let slack_low = x.add_scalar(1.0);
        let slack_high = -&x;
        let mut dual = j.tr_mul(&(&j * &x - &d)) - &low + &high;
        for i in 0..n {
            dual[i] += ridge[i] * x[i];
        }
        let gap = (slack_low.dot(&low) + slack_high.dot(&high)) / (2 * n) as f64;
        if gap <= GAP && dual.amax() <= RESIDUAL {
            break;
        }
        let diagonal = DVector::from_fn(n, |i, _| {
            ridge[i] + low[i] / slack_low[i] + high[i] / slack_high[i]
        });
        let mut system = dense::gram(&j, |i| Some(1.0 / diagonal[i]));
        for i in 0..system.nrows() {
            system[(i, i)] += 1.0;
        }
        let Some(factor) = dense::Definite::new(&system) else {
            break;
        };
        // (D + J'J)^-1 b by Woodbury's formula, refined once: D may be tiny beside J'J
        let once = |b: &DVector<f64>| {
            let seen = &j * b.component_div(&diagonal);
            (b - j.tr_mul(&factor.solve(&seen))).component_div(&diagonal)
        };
        let inverse = |b: &DVector<f64>| {
            let first = once(b);
            let left = b - first.component_mul(&diagonal) - j.tr_mul(&(&j * &first));
            first + once(&left)
        };
        // targets are the products slack x multiplier that a step aims at, less what they are
        let direction = |target_low: &DVector<f64>, target_high: &DVector<f64>| {
            let right = -&dual + target_low.component_div(&slack_low)
                - target_high.component_div(&slack_high);
            let dx = inverse(&right);
            let dlow = (target_low - low.component_mul(&dx)).component_div(&slack_low);
            let dhigh = (target_high + high.component_mul(&dx)).component_div(&slack_high);
            (dx, dlow, dhigh)
        };
        let lengths = |dx: &DVector<f64>, dlow: &DVector<f64>, dhigh: &DVector<f64>| {
            let (mut primal, mut dual) = (1.0_f64, 1.0_f64);
            for i in 0..n {
                if dx[i] < 0.0 {
                    primal = primal.min(-slack_low[i] / dx[i]);
                } else if dx[i] > 0.0 {
                    primal = primal.min(slack_high[i] / dx[i]);
                }
                for (z, dz) in [(low[i], dlow[i]), (high[i], dhigh[i])] {
                    if dz < 0.0 {
                        dual = dual.min(-z / dz);
                    }
                }
            }
            // a quadratic objective ties both: they share one length
            primal.min(dual)
        };
        let product_low = slack_low.component_mul(&low);
        let product_high = slack_high.component_mul(&high);
        let (dx, dlow, dhigh) = direction(&-&product_low, &-&product_high);
        let length = lengths(&dx, &dlow, &dhigh);
        let ahead = ((&slack_low + &dx * length).dot(&(&low + &dlow * length))
            + (&slack_high - &dx * length).dot(&(&high + &dhigh * length)))
            / (2 * n) as f64;
        let aim = gap * (ahead / gap).powi(3);
        let (dx, dlow, dhigh) = direction(
            &(-&product_low - dx.component_mul(&dlow)).add_scalar(aim),
            &(-&product_high + dx.component_mul(&dhigh)).add_scalar(aim),
        );
        let length = STEP * lengths(&dx, &dlow, &dhigh);
        let next = &x + &dx * length;
        let inside = next.iter().all(|x| *x > -1.0 && *x < 0.0);
        if !inside || length < 1e-12 {
            break;
        }
        x = next;
        low += dlow * length;
        high += dhigh * length;
    }
    // an unknown belongs to its bound where the multiplier is larger than the slack
    Some(DVector::from_fn(n, |i, _| {
        if high[i] > -x[i] && x[i] > -SNAP {
            0.0
        } else if low[i] > x[i] + 1.0 && x[i] < -1.0 + SNAP {
            -1.0
        } else {
            x[i]
        }
    }))
}
