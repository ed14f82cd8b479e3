//! The place of a load that is no disc. The centre of a disc that stands for an oblong load lies beside that of the load, and its error
//! is that of a disc: an ellipse is fitted too, and its error counts for loads that look like a disc as well (decision 195).

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use super::descent::{Problem, descend};
use super::{
    DIAMETER_M, Disc, DiscFit, LN_DIAMETER_SD, MODEL_SHARE, REFUSED, STEPS, differences, gram,
    inflation, loss_of, place_covariance,
};
use crate::DriftError;
use crate::model::DriftModel;
use crate::whitened::Whitened;

/// x, y (m), ln diameter (m), two stretches, change.
const N: usize = 6;
/// Prior of each stretch, half of the logarithm of the ratio of the axes: along x, and along the diagonal.
const STRETCH_SD: f64 = 0.4;
const MOST_STRETCH: f64 = 1.0;
/// Improvement of chi squared from which on the load is no disc; and the share of chi squared that an ellipse may leave if it does not
/// explain the data either: where the linear model fails, it takes the ellipse beside the load.
const NO_DISC: f64 = 12.0;
const CLEARLY: f64 = 0.5;
/// Standard deviation of a place by what an ellipse lacks in shape, as a share of the diameter: where it explains the data, and where not.
const LIKE_AN_ELLIPSE: f64 = 0.005;
const OTHER_SHAPE: f64 = 0.025;
/// Least standard deviation of a load as a share of it.
const LOAD_FLOOR: f64 = 0.04;

impl Whitened {
    /// The place of a load for which `disc` was fitted to the same data: the centre of an ellipse if it explains them better, and an error that
    /// holds for loads that are no discs. The answer's disc has the area of the ellipse.
    ///
    /// # Errors
    /// Data that are not finite.
    pub fn fit_place(&self, model: &DriftModel, disc: &DiscFit) -> Result<DiscFit, DriftError> {
        let change = -disc.load / disc.disc.diameter.powi(2);
        let signal = model.disc(disc.disc.centre, disc.disc.diameter) * change;
        let white = self.with_error(&(signal * MODEL_SHARE))?;
        let [x, y] = disc.disc.centre;
        let mean = disc.disc.diameter.ln();
        let problem = Stretched {
            white: &white,
            model,
            mean,
        };
        let start = SVector::<f64, N>::from([x, y, mean, 0.0, 0.0, change]);
        let (theta, left, gained) = choose(&problem, start);
        let chi = left.norm_squared() / self.rows().len() as f64;
        let covariance = information(&problem.derivative(&theta));
        let covariance = covariance.try_inverse().ok_or(DriftError::Covariance)?;
        let place = [0, 1].map(|i| [0, 1].map(|j| covariance[(i, j)]));
        let mut place = place_covariance(model, place, chi);
        let (diameter, change) = (theta[2].exp(), theta[5]);
        let of_shape = match chi <= REFUSED {
            true => LIKE_AN_ELLIPSE,
            false => OTHER_SHAPE,
        };
        for (axis, row) in place.iter_mut().enumerate() {
            row[axis] += (of_shape * diameter).powi(2);
        }
        let mut of_load = SVector::<f64, N>::zeros();
        (of_load[2], of_load[5]) = (2.0, 1.0 / change);
        let of_load = (of_load.transpose() * covariance * of_load)[(0, 0)] * inflation(chi);
        Ok(DiscFit {
            disc: Disc {
                centre: [theta[0], theta[1]],
                diameter,
                loss: loss_of(change),
            },
            load: -change * diameter.powi(2),
            covariance: place,
            load_sd: (of_load.max(0.0) + LOAD_FLOOR.powi(2)).sqrt(),
            change_sd: (covariance[(5, 5)].max(0.0) * inflation(chi)).sqrt() / change.abs(),
            score: disc.score + gained,
            chi,
            accepted: chi <= REFUSED,
        })
    }
}

/// The parameters of an ellipse if it explains the data and the disc at the start does not, otherwise those of the start; the whitened data
/// that are left, and the improvement of chi squared.
fn choose(problem: &Stretched<'_>, start: SVector<f64, N>) -> (SVector<f64, N>, DVector<f64>, f64) {
    let (of_disc, before) = problem.residual(&start);
    let (theta, cost) = descend(problem, start, STEPS);
    let (left, _) = problem.residual(&theta);
    let n = of_disc.len() as f64;
    let explains = left.norm_squared() / n <= REFUSED
        || left.norm_squared() < CLEARLY * of_disc.norm_squared();
    if before - cost < NO_DISC || !explains {
        return (start, of_disc, 0.0);
    }
    (theta, left, before - cost)
}

/// An ellipse about a mean of the ln diameter of the disc of its area.
struct Stretched<'a> {
    white: &'a Whitened,
    model: &'a DriftModel,
    mean: f64,
}

impl Stretched<'_> {
    fn of(&self, theta: &SVector<f64, N>) -> DVector<f64> {
        let ellipse =
            self.model
                .ellipse([theta[0], theta[1]], theta[2].exp(), [theta[3], theta[4]]);
        self.white.column(&(ellipse * theta[5]))
    }

    fn derivative(&self, theta: &SVector<f64, N>) -> DMatrix<f64> {
        differences(theta, &[0.2e-3, 0.2e-3, 0.02, 0.02, 0.02], |theta| {
            self.of(theta)
        })
    }
}

impl Problem<N> for Stretched<'_> {
    fn clamp(&self, mut theta: SVector<f64, N>) -> SVector<f64, N> {
        let [low, high] = self.model.bounds();
        for axis in 0..2 {
            theta[axis] = theta[axis].clamp(low[axis], high[axis]);
        }
        theta[2] = theta[2].clamp(DIAMETER_M[0].ln(), DIAMETER_M[1].ln());
        for axis in [3, 4] {
            theta[axis] = theta[axis].clamp(-MOST_STRETCH, MOST_STRETCH);
        }
        theta[5] = theta[5].clamp(-2.0, 2.0);
        theta
    }

    fn residual(&self, theta: &SVector<f64, N>) -> (DVector<f64>, f64) {
        let left = self.white.data() - self.of(theta);
        let size = ((theta[2] - self.mean) / LN_DIAMETER_SD).powi(2);
        let stretch = (theta[3].powi(2) + theta[4].powi(2)) * STRETCH_SD.powi(-2);
        let cost = left.norm_squared() + size + stretch;
        (left, cost)
    }

    fn normal(
        &self,
        theta: &SVector<f64, N>,
        left: &DVector<f64>,
    ) -> (SMatrix<f64, N, N>, SVector<f64, N>) {
        let h = self.derivative(theta);
        let mut right = SVector::<f64, N>::from_fn(|i, _| h.column(i).dot(left));
        right[2] -= (theta[2] - self.mean) * LN_DIAMETER_SD.powi(-2);
        for axis in [3, 4] {
            right[axis] -= theta[axis] * STRETCH_SD.powi(-2);
        }
        (information(&h), right)
    }
}

/// H' H with the priors.
fn information(h: &DMatrix<f64>) -> SMatrix<f64, N, N> {
    let mut out: SMatrix<f64, N, N> = gram(h);
    out[(2, 2)] += LN_DIAMETER_SD.powi(-2);
    for axis in [3, 4] {
        out[(axis, axis)] += STRETCH_SD.powi(-2);
    }
    out
}
