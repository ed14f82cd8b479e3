//! A primal-dual interior method for min |J x - d|^2 / 2 + c x'Rx / 2 over -1 <= x <= 0, R a diagonal or a graph
//! Laplacian, with Mehrotra's predictor and corrector (J. Nocedal, S. Wright, Numerical Optimization, 2nd ed., section
//! 16.6).
//!
//! It needs about twenty factorisations in the space of readings, whatever the conditioning; Newton's method on the
//! dual may need far more. Each is of I + J D^-1 J' with D = c R + a positive diagonal, which is always definite.

use nalgebra::{DMatrix, DVector};

use crate::inverse::prior::{Half, Laplacian, Penalty, block_of_columns};
use crate::linear_algebra::dense;
use crate::linear_algebra::sparse::Block;

const MOST_STEPS: usize = 60;
/// Mean product of slack and multiplier, with the largest entry of J'd as unit, at which to stop.
const GAP: f64 = 1e-14;
/// Largest entry of the gradient minus the multipliers, in the same unit, at which to stop.
const RESIDUAL: f64 = 1e-11;
/// Distance from a bound within which an unknown is set to it.
const SNAP: f64 = 1e-7;
/// Fraction of the distance to the nearest bound that a step may take.
const STEP: f64 = 0.995;

/// A point strictly within the bounds and close to the minimum; `None` if the first factorisation fails.
pub(crate) fn solve(
    sensitivity: &DMatrix<f64>,
    penalty: &Penalty,
    square: f64,
    data: &DVector<f64>,
) -> Option<DVector<f64>> {
    let n = sensitivity.ncols();
    let unit = sensitivity.tr_mul(data).amax();
    if !(unit > 0.0 && unit.is_finite()) {
        return None;
    }
    // J and d divided by the root of the unit: the gradient at zero is then of size 1
    let j = sensitivity / unit.sqrt();
    let d = data / unit.sqrt();
    let mut ridge = Ridge::new(penalty, square / unit)?;

    let mut x = DVector::from_element(n, -0.5);
    let mut low = DVector::from_element(n, 1.0);
    let mut high = DVector::from_element(n, 1.0);
    for _ in 0..MOST_STEPS {
        let slack_low = x.add_scalar(1.0);
        let slack_high = -&x;
        let dual = j.tr_mul(&(&j * &x - &d)) - &low + &high + ridge.times(&x);
        let gap = (slack_low.dot(&low) + slack_high.dot(&high)) / (2 * n) as f64;
        if gap <= GAP && dual.amax() <= RESIDUAL {
            break;
        }
        let barrier = DVector::from_fn(n, |i, _| low[i] / slack_low[i] + high[i] / slack_high[i]);
        let Some(mut system) = ridge.gram(&j, &barrier) else {
            break;
        };
        for i in 0..system.nrows() {
            system[(i, i)] += 1.0;
        }
        let Some(factor) = dense::Definite::new(&system) else {
            break;
        };
        // (D + J'J)^-1 b by Woodbury's formula, refined once: D may be tiny beside J'J
        let once = |b: &DVector<f64>| {
            let seen = &j * ridge.solve(b);
            ridge.solve(&(b - j.tr_mul(&factor.solve(&seen))))
        };
        let inverse = |b: &DVector<f64>| {
            let first = once(b);
            let left =
                b - ridge.times(&first) - first.component_mul(&barrier) - j.tr_mul(&(&j * &first));
            first + once(&left)
        };
        // targets: the products slack x multiplier that a step aims at, minus their present values
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
            // a quadratic objective couples both: they share one step length
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
    // an unknown is on its bound if the multiplier is larger than the slack
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

/// D = c R + a positive diagonal, and its inverse.
enum Ridge<'a> {
    Diagonal {
        entries: DVector<f64>,
        all: DVector<f64>,
    },
    Laplacian {
        of: &'a Laplacian,
        scale: f64,
        half: Box<Half>,
    },
}

impl<'a> Ridge<'a> {
    /// `None` for a prior without an explicit R.
    fn new(penalty: &'a Penalty, scale: f64) -> Option<Self> {
        match penalty {
            Penalty::Diagonal(entries) => {
                let entries =
                    DVector::from_iterator(entries.len(), entries.iter().map(|r| scale * r));
                Some(Self::Diagonal {
                    all: entries.clone(),
                    entries,
                })
            }
            Penalty::Laplacian(of) => Some(Self::Laplacian {
                of,
                scale,
                half: Box::new(of.pattern()?),
            }),
            Penalty::Smooth(_) => None,
        }
    }

    /// c R x
    fn times(&self, x: &DVector<f64>) -> DVector<f64> {
        match self {
            Self::Diagonal { entries, .. } => x.component_mul(entries),
            Self::Laplacian { of, scale, .. } => DVector::from_vec(of.times(x.as_slice())) * *scale,
        }
    }

    /// Sets another diagonal, and returns J D^-1 J'.
    fn gram(&mut self, j: &DMatrix<f64>, diagonal: &DVector<f64>) -> Option<DMatrix<f64>> {
        match self {
            Self::Diagonal { entries, all } => {
                *all = &*entries + diagonal;
                Some(dense::gram(j, |i| Some(1.0 / all[i])))
            }
            Self::Laplacian { of, scale, half } => {
                half.factor_again(of, *scale, |unknown| diagonal[unknown])?;
                let halved = half.down(&block_of_columns(j));
                let unknowns = halved.values.len() / halved.width;
                let halved = DMatrix::from_vec(halved.width, unknowns, halved.values);
                let gram = dense::gram(&halved, |_| Some(1.0));
                Some(gram.view((0, 0), (j.nrows(), j.nrows())).into_owned())
            }
        }
    }

    /// D^-1 b
    fn solve(&self, b: &DVector<f64>) -> DVector<f64> {
        match self {
            Self::Diagonal { all, .. } => b.component_div(all),
            Self::Laplacian { half, .. } => {
                let mut block = Block::zeros(b.len(), 1);
                for (unknown, value) in b.iter().enumerate() {
                    block.row_mut(unknown)[0] = *value;
                }
                let block = half.up(half.down(&block), b.len());
                DVector::from_fn(b.len(), |unknown, _| block.row(unknown)[0])
            }
        }
    }
}
