//! The place of a load that is no disc. The centre of a disc that stands for an oblong load lies beside that of the load, and its error
//! is that of a disc: an ellipse is fitted too, and its error counts for loads that look like a disc as well (decision 195).

use nalgebra::{DVector, SVector};

use super::descent::{Axis, Problem, descend};
use super::{DiscFit, MODEL_SHARE, REFUSED, STEPS};
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
