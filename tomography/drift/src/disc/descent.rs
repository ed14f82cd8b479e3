//! Levenberg-Marquardt for the few parameters of a disc or an ellipse.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use super::{DIAMETER_M, LN_DIAMETER_SD};
use crate::model::DriftModel;

/// One parameter: its bounds, the step of its differences, and its prior.
#[derive(Clone, Copy)]
pub(super) struct Axis {
    bounds: [f64; 2],
    step: f64,
    mean: f64,
    deviation: f64,
}

impl Axis {
    /// A parameter whose prior mean is zero.
    pub(super) fn small(bounds: [f64; 2], step: f64, deviation: f64) -> Self {
        Self {
            bounds,
            step,
            mean: 0.0,
            deviation,
        }
    }

    /// x and y of a centre, m.
    pub(super) fn centre(model: &DriftModel) -> [Self; 2] {
        let [low, high] = model.bounds();
        [0, 1].map(|axis| Self::small([low[axis], high[axis]], 0.2e-3, f64::INFINITY))
    }

    /// ln diameter (m), with this prior mean.
    pub(super) fn ln_diameter(mean: f64) -> Self {
        Self {
            bounds: DIAMETER_M.map(f64::ln),
            step: 0.02,
            mean,
            deviation: LN_DIAMETER_SD,
        }
    }

    /// Linear change of conductance, the factor of the data; at -2 all conductance is lost.
    pub(super) fn change() -> Self {
        Self::small([-2.0, 2.0], 1.0, f64::INFINITY)
    }

    fn weight(&self) -> f64 {
        self.deviation.powi(-2)
    }
}

/// Least-squares problem: fits `N` parameters to data; the last parameter is a linear factor.
pub(super) struct Problem<'a, const N: usize, F> {
    /// Whitened data.
    pub(super) data: &'a DVector<f64>,
    /// The whitened data that these parameters predict.
    pub(super) of: F,
    pub(super) axes: [Axis; N],
}

impl<const N: usize, F: Fn(&SVector<f64, N>) -> DVector<f64>> Problem<'_, N, F> {
    /// Clamps the parameters to their bounds.
    fn clamp(&self, theta: SVector<f64, N>) -> SVector<f64, N> {
        SVector::from_fn(|k, _| {
            let [low, high] = self.axes[k].bounds;
            theta[k].clamp(low, high)
        })
    }

    /// The residual of the data, and the cost including the priors.
    pub(super) fn residual(&self, theta: &SVector<f64, N>) -> (DVector<f64>, f64) {
        let left = self.data - (self.of)(theta);
        let mut cost = left.norm_squared();
        for (value, axis) in theta.iter().zip(&self.axes) {
            cost += ((value - axis.mean) / axis.deviation).powi(2);
        }
        (left, cost)
    }

    /// Derivatives of the prediction: central differences; the last column is the prediction at factor 1.
    fn derivative(&self, theta: &SVector<f64, N>) -> DMatrix<f64> {
        let mut columns: Vec<DVector<f64>> = Vec::with_capacity(N);
        for (k, axis) in self.axes[..N - 1].iter().enumerate() {
            let (mut up, mut down) = (*theta, *theta);
            up[k] += axis.step;
            down[k] -= axis.step;
            columns.push(((self.of)(&up) - (self.of)(&down)) / (2.0 * axis.step));
        }
        let mut one = *theta;
        one[N - 1] = 1.0;
        columns.push((self.of)(&one));
        DMatrix::from_columns(&columns)
    }

    /// The inverse covariance of the parameters, priors included.
    pub(super) fn information(&self, theta: &SVector<f64, N>) -> SMatrix<f64, N, N> {
        self.with_priors(&self.derivative(theta))
    }

    /// H' H plus the prior weights.
    fn with_priors(&self, h: &DMatrix<f64>) -> SMatrix<f64, N, N> {
        let mut out = SMatrix::from_fn(|i, j| h.column(i).dot(&h.column(j)));
        for (k, axis) in self.axes.iter().enumerate() {
            out[(k, k)] += axis.weight();
        }
        out
    }

    /// The normal matrix and the right side, priors included, at parameters with this residual.
    fn normal(
        &self,
        theta: &SVector<f64, N>,
        left: &DVector<f64>,
    ) -> (SMatrix<f64, N, N>, SVector<f64, N>) {
        let h = self.derivative(theta);
        let right = SVector::from_fn(|k, _| {
            let axis = &self.axes[k];
            h.column(k).dot(left) - (theta[k] - axis.mean) * axis.weight()
        });
        (self.with_priors(&h), right)
    }
}

/// The parameters after at most this number of steps, and their cost.
pub(super) fn descend<const N: usize>(
    problem: &Problem<'_, N, impl Fn(&SVector<f64, N>) -> DVector<f64>>,
    start: SVector<f64, N>,
    steps: usize,
) -> (SVector<f64, N>, f64) {
    let mut theta = problem.clamp(start);
    let (mut left, mut cost) = problem.residual(&theta);
    let mut damping = 1e-2;
    for _ in 0..steps {
        let (normal, right) = problem.normal(&theta, &left);
        let mut gained = 0.0;
        for _ in 0..8 {
            let mut damped = normal;
            for k in 0..N {
                damped[(k, k)] *= 1.0 + damping;
            }
            let step = damped.cholesky().map(|factor| factor.solve(&right));
            let next = problem.clamp(theta + step.unwrap_or_else(SVector::zeros));
            let (next_left, next_cost) = problem.residual(&next);
            if next_cost < cost {
                gained = cost - next_cost;
                (theta, left, cost) = (next, next_left, next_cost);
                damping = (damping * 0.1).max(1e-9);
                break;
            }
            damping *= 10.0;
        }
        if gained < 1e-4 {
            break;
        }
    }
    (theta, cost)
}
