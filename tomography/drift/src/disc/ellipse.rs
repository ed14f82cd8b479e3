//! The position of a load that is not a disc. A disc fitted to an oblong load is offset from its centre, and its stated
//! error holds for discs only. An ellipse is therefore fitted too, and its error is included also for loads that look
//! like a disc (decision 195).

use nalgebra::{DVector, SVector};

use super::descent::{Axis, Problem, descend};
use super::{DiscFit, MODEL_SHARE, REFUSED, STEPS};
use crate::DriftError;
use crate::model::DriftModel;
use crate::whitened::Whitened;

/// x, y (m), ln diameter (m), two stretches, change.
const N: usize = 6;
/// Prior standard deviation of each stretch: half of the logarithm of the ratio of the axes, along x and along the
/// diagonal.
const STRETCH_SD: f64 = 0.4;
const MOST_STRETCH: f64 = 1.0;
/// Improvement of chi squared above which the load is not a disc; and the largest chi squared of the ellipse, as a
/// share of the disc's, if the ellipse does not explain the data either. Where the linear model fails, the ellipse is
/// fitted beside the load.
const NO_DISC: f64 = 12.0;
const CLEARLY: f64 = 0.5;
/// Standard deviation of the position due to a shape other than the fitted one, as a share of the diameter: if the fit
/// is accepted, and if not.
const LIKE_AN_ELLIPSE: f64 = 0.005;
const OTHER_SHAPE: f64 = 0.025;
/// Smallest relative standard deviation of a load.
const LOAD_FLOOR: f64 = 0.04;

impl Whitened {
    /// The position of a load to whose data `disc` was fitted: the centre of an ellipse if the ellipse explains the
    /// data better, with an error that holds for loads that are not discs. The disc of the result has the area of the
    /// ellipse.
    ///
    /// # Errors
    /// Data that are not finite.
    pub fn fit_place(&self, model: &DriftModel, disc: &DiscFit) -> Result<DiscFit, DriftError> {
        let change = -disc.load / disc.disc.diameter.powi(2);
        let signal = model.disc(disc.disc.centre, disc.disc.diameter) * change;
        let white = self.with_error(&(signal * MODEL_SHARE))?;
        let [x, y] = disc.disc.centre;
        let mean = disc.disc.diameter.ln();
        let [x_axis, y_axis] = Axis::centre(model);
        let stretch = Axis::small([-MOST_STRETCH, MOST_STRETCH], 0.02, STRETCH_SD);
        let size = Axis::ln_diameter(mean);
        let problem = Problem {
            data: white.data(),
            of: |theta: &SVector<f64, N>| {
                let [x, y, size, along, across, change] = (*theta).into();
                let ellipse = model.ellipse([x, y], size.exp(), [along, across]);
                white.column(&(ellipse * change))
            },
            axes: [x_axis, y_axis, size, stretch, stretch, Axis::change()],
        };
        let start = SVector::<f64, N>::from([x, y, mean, 0.0, 0.0, change]);
        let (of_disc, before) = problem.residual(&start);
        let (best, cost) = descend(&problem, start, STEPS);
        let (of_ellipse, _) = problem.residual(&best);
        let chi = |left: &DVector<f64>| left.norm_squared() / left.len() as f64;
        let (of_disc, of_ellipse) = (chi(&of_disc), chi(&of_ellipse));
        let explains = of_ellipse <= REFUSED || of_ellipse < CLEARLY * of_disc;
        let (theta, chi, gained) = match explains && before - cost >= NO_DISC {
            true => (best, of_ellipse, before - cost),
            false => (start, of_disc, 0.0),
        };
        let covariance = problem.information(&theta).try_inverse();
        let covariance = covariance.ok_or(DriftError::Covariance)?;
        let mut out = DiscFit::new(model, &theta, &covariance, chi, disc.score + gained);
        let of_shape = match out.accepted {
            true => LIKE_AN_ELLIPSE,
            false => OTHER_SHAPE,
        };
        for (axis, row) in out.covariance.iter_mut().enumerate() {
            row[axis] += (of_shape * out.disc.diameter).powi(2);
        }
        out.load_sd = out.load_sd.hypot(LOAD_FLOOR);
        Ok(out)
    }
}
