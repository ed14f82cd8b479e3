//! Fits a disc in whitened space, with the covariance of its position and load.
//!
//! The model of the disc is linear (Born) about the fitted sheet, with the exact area of each triangle that the disc
//! covers. A disc with k times its conductance changes the field like a linear change of 2 (k - 1) / (k + 1); the fitted
//! change is converted accordingly.

mod descent;
mod ellipse;
mod moving;

use eit::Mesh;
use nalgebra::{DVector, SMatrix, SVector, Vector4};

use crate::DriftError;
use crate::model::DriftModel;
use crate::overlap::overlap;
use crate::whitened::{LOADED, LoadTest, Whitened};
use descent::{Axis, Problem, descend};
pub use moving::{INJECTIONS, Injection, MovingLoad, TimedReading};

/// Error of the model as a share of the fitted signal.
pub(crate) const MODEL_SHARE: f64 = 0.01;
/// Factor of the covariance; and its floor, m: of an even sheet, and per unit of unevenness (decision 192).
const INFLATION: f64 = 1.5;
const FLOOR_M: f64 = 0.07e-3;
const FLOOR_OF_UNEVEN_M: f64 = 3e-3;
/// Chi squared per row after the fit above which the fit is rejected.
const REFUSED: f64 = 1.6;
/// Range of fitted diameters, m.
const DIAMETER_M: [f64; 2] = [4e-3, 0.15];
/// Prior standard deviation of ln diameter; the prior mean is the ln diameter of the start.
const LN_DIAMETER_SD: f64 = 1.0;
/// Largest reported gain of conductance; readings hardly distinguish larger gains.
const LARGEST_GAIN: f64 = 10.0;
const STEPS: usize = 30;

/// A disc with changed conductance.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Disc {
    /// Centre, m.
    pub centre: [f64; 2],
    /// Diameter, m.
    pub diameter: f64,
    /// Share of the conductance lost, 0 to 1; negative for a gain, down to -10.
    pub loss: f64,
}

/// A fitted disc with its uncertainty.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DiscFit {
    /// The disc.
    pub disc: Disc,
    /// Linear change of conductance times the squared diameter, m2, positive for a loss. It hardly depends on the
    /// fitted diameter.
    pub load: f64,
    /// Covariance of the centre, m2.
    pub covariance: [[f64; 2]; 2],
    /// Relative standard deviation of the load.
    pub load_sd: f64,
    /// Relative standard deviation of the change of conductance under the disc.
    pub change_sd: f64,
    /// Improvement of chi squared by the disc.
    pub score: f64,
    /// Chi squared per row after the fit, with 1 % of the disc's signal as model error.
    pub chi: f64,
    /// Whether the fit is good enough for its covariance to hold.
    pub accepted: bool,
}

impl Disc {
    /// A disc with this linear change of conductance.
    fn new(centre: [f64; 2], diameter: f64, change: f64) -> Self {
        Self {
            centre,
            diameter,
            loss: loss_of(change).max(-LARGEST_GAIN),
        }
    }

    /// The map of the disc: relative change of conductance of each triangle of the region, 0 outside of the disc.
    pub fn map(&self, mesh: &Mesh) -> Vec<f64> {
        let of = |&triangle: &usize| {
            let common = overlap(mesh.corners(triangle), self.centre, 0.5 * self.diameter);
            -self.loss * common / mesh.area(triangle)
        };
        mesh.region().iter().map(of).collect()
    }
}

impl DiscFit {
    /// Creates a fit from parameters that begin with x, y (m) and ln diameter (m) and end with the change, and their
    /// covariance.
    fn new<const N: usize>(
        model: &DriftModel,
        theta: &SVector<f64, N>,
        covariance: &SMatrix<f64, N, N>,
        chi: f64,
        score: f64,
    ) -> Self {
        let place = [0, 1].map(|i| [0, 1].map(|j| covariance[(i, j)]));
        let covariance = covariance * inflation(chi);
        let change = theta[N - 1];
        // ln load = ln |change| + 2 ln diameter
        let mut of_load = SVector::<f64, N>::zeros();
        (of_load[2], of_load[N - 1]) = (2.0, 1.0 / change);
        let load_variance = (of_load.transpose() * covariance * of_load)[(0, 0)];
        Self {
            disc: Disc::new([theta[0], theta[1]], theta[2].exp(), change),
            load: -change * (2.0 * theta[2]).exp(),
            covariance: place_covariance(model, place, chi),
            load_sd: load_variance.max(0.0).sqrt(),
            change_sd: covariance[(N - 1, N - 1)].max(0.0).sqrt() / change.abs(),
            score,
            chi,
            accepted: chi <= REFUSED,
        }
    }

    /// Whether the improvement of chi squared exceeds what drift and noise of an unloaded sheet cause.
    pub fn is_load(&self) -> bool {
        self.score > LOADED
    }

    /// Largest linear change of conductance that the load may have, 0 to 2: that of the disc, multiplied by e to the
    /// standard deviation of its logarithm (at most 1). A small disc with a large change can hardly be distinguished
    /// from a larger disc with a smaller change.
    fn largest_change(&self) -> f64 {
        let change = (self.load / self.disc.diameter.powi(2)).abs();
        let more = self.change_sd.min(1.0);
        (change * more.exp()).min(2.0)
    }
}

impl Whitened {
    /// Fits one disc (loss or gain), starting at the best places of the load test.
    ///
    /// # Errors
    /// Data that are not finite.
    pub fn fit_disc(&self, model: &DriftModel) -> Result<DiscFit, DriftError> {
        let starts = self.load_tests(model, 3);
        self.fit_disc_from(model, &starts)
    }

    pub(crate) fn fit_disc_from(
        &self,
        model: &DriftModel,
        starts: &[LoadTest],
    ) -> Result<DiscFit, DriftError> {
        let fits = self.descents(model, starts);
        let &(theta, cost) = fits.first().ok_or(DriftError::Covariance)?;
        self.described(model, theta, cost)
    }

    /// The disc that explains the data best, and the largest linear change of conductance that a load with these data
    /// may have, 0 to 2. A wide disc fitted to several loads has a smaller change than each of them; therefore the disc
    /// fitted from each start counts too, if it explains at least half as much.
    pub(crate) fn fit_disc_and_change(
        &self,
        model: &DriftModel,
        starts: &[LoadTest],
    ) -> Result<(DiscFit, f64), DriftError> {
        let mut fits = self.descents(model, starts).into_iter();
        let (theta, cost) = fits.next().ok_or(DriftError::Covariance)?;
        let best = self.described(model, theta, cost)?;
        let largest = fits
            .filter_map(|(theta, cost)| self.described(model, theta, cost).ok())
            .filter(|fit| fit.score > 0.5 * best.score)
            .map(|fit| fit.largest_change())
            .fold(best.largest_change(), f64::max);
        Ok((best, largest))
    }

    /// The disc fitted from each start and its cost, lowest cost first.
    fn descents(&self, model: &DriftModel, starts: &[LoadTest]) -> Vec<(Vector4<f64>, f64)> {
        let fits = starts.iter().map(|start| self.descend(model, start));
        let mut fits: Vec<_> = fits.filter(|(_, cost)| cost.is_finite()).collect();
        fits.sort_by(|a, b| a.1.total_cmp(&b.1));
        fits
    }

    /// Whitened data of a disc: theta is x, y (m), ln diameter (m), change.
    fn of_disc(&self, model: &DriftModel, theta: &Vector4<f64>) -> DVector<f64> {
        self.column(&(model.disc([theta[0], theta[1]], theta[2].exp()) * theta[3]))
    }

    /// The least-squares problem of a disc with this prior mean of ln diameter.
    fn of_one_disc<'a>(
        &'a self,
        model: &'a DriftModel,
        mean: f64,
    ) -> Problem<'a, 4, impl Fn(&Vector4<f64>) -> DVector<f64> + 'a> {
        let [x, y] = Axis::centre(model);
        Problem {
            data: self.data(),
            of: move |theta: &Vector4<f64>| self.of_disc(model, theta),
            axes: [x, y, Axis::ln_diameter(mean), Axis::change()],
        }
    }

    /// Levenberg-Marquardt fit, starting at a place of the load test.
    fn descend(&self, model: &DriftModel, start: &LoadTest) -> (Vector4<f64>, f64) {
        let mean = start.place.diameter.ln();
        let [x, y] = start.place.centre;
        let start = Vector4::new(x, y, mean, start.change);
        descend(&self.of_one_disc(model, mean), start, STEPS)
    }

    /// The fit with its covariance, which includes a model error of 1 % of the signal.
    fn described(
        &self,
        model: &DriftModel,
        theta: Vector4<f64>,
        cost: f64,
    ) -> Result<DiscFit, DriftError> {
        let signal = model.disc([theta[0], theta[1]], theta[2].exp()) * theta[3];
        let wider = self.with_error(&(&signal * MODEL_SHARE))?;
        let information = wider.of_one_disc(model, theta[2]).information(&theta);
        let left = wider.data() - wider.column(&signal);
        let chi = left.norm_squared() / self.rows().len() as f64;
        let covariance = information.try_inverse().ok_or(DriftError::Covariance)?;
        let score = self.data().norm_squared() - cost;
        Ok(DiscFit::new(model, &theta, &covariance, chi, score))
    }
}

/// The share of conductance that a disc loses if the field changes like this linear change, limited to -2..2; negative
/// for a gain, minus infinity for a perfect conductor.
pub(crate) fn loss_of(change: f64) -> f64 {
    // the inverse of 2 (k - 1) / (k + 1), with a loss of 1 - k
    let change = change.clamp(-2.0, 2.0);
    -2.0 * change / (2.0 - change)
}

/// Factor of the covariance for a chi squared per row after the fit.
fn inflation(chi: f64) -> f64 {
    INFLATION * chi.max(1.0)
}

/// The reported covariance of a position, m2: inflated, with the floor of the sheet.
fn place_covariance(model: &DriftModel, of_fit: [[f64; 2]; 2], chi: f64) -> [[f64; 2]; 2] {
    let mut out = of_fit.map(|row| row.map(|value| value * inflation(chi)));
    let floor = FLOOR_M.max(FLOOR_OF_UNEVEN_M * model.fit().unevenness);
    for (k, row) in out.iter_mut().enumerate() {
        row[k] += floor * floor;
    }
    out
}
