//! One hyper-parameter for all frames: the map is a matrix times the readings.

use nalgebra::DMatrix;

use super::noise_figure;
use super::{EXPECTED_CHANGE, MODEL_SHARE};
use crate::Mesh;
use crate::inverse::data_space::DataSpace;
use crate::inverse::error::OneStepError;
use crate::inverse::learned::linear::Linear;
use crate::inverse::low_rank::Quick;
use crate::inverse::options::{Hyper, OneStepOptions};
use crate::inverse::prior::Penalty;

/// A one-step problem solved for one lambda.
pub(super) struct Fixed {
    pub(super) lambda: f64,
    /// Whether lambda was raised: the noise alone would give a smaller one than [`MODEL_SHARE`] allows.
    pub(super) raised: bool,
    /// Trace of the matrix from readings to the readings of their map.
    pub(super) degrees: f64,
    pub(super) noise_figure: f64,
    pub(super) solution: DataSpace,
    pub(super) quick: Option<Quick>,
}

impl Fixed {
    /// `deviation`: standard deviation of a change due to noise, for [`Hyper::Noise`].
    pub(super) fn new(
        mesh: &Mesh,
        linear: &Linear,
        sensitivity: &DMatrix<f64>,
        penalty: &Penalty,
        options: &OneStepOptions,
        deviation: Option<f64>,
    ) -> Result<Self, OneStepError> {
        let shown = options.shown.as_deref();
        let figure = |solution: &DataSpace| {
            noise_figure::of(mesh, &linear.fold, sensitivity, solution.matrix(), shown)
        };
        let amplitude = penalty.amplitude(EXPECTED_CHANGE, shown)?;
        let size = || penalty.size(sensitivity).ok_or(OneStepError::Prior);
        let (lambda, raised) = match (options.hyper, deviation) {
            (Hyper::Lambda(lambda), _) => (lambda, false),
            (Hyper::Paper(alpha), _) => (alpha.sqrt() * linear.largest(), false),
            (Hyper::NoiseFigure(wanted), _) => {
                let at = |lambda| Ok(figure(&DataSpace::new(sensitivity, penalty, lambda)?));
                (noise_figure::lambda(wanted, size()?, at)?, false)
            }
            (Hyper::Noise { .. } | Hyper::Frame { .. }, deviation) => {
                let lambda = deviation.unwrap_or(0.0) / amplitude;
                let least = MODEL_SHARE * size()?;
                (lambda.max(least), lambda < least)
            }
        };
        let solution = DataSpace::new(sensitivity, penalty, lambda)?;
        // column by column of both: the rows of a matrix are far apart in memory
        let columns = solution.matrix().transpose();
        let degrees = sensitivity.dot(&columns);
        let quick = match options.map_error {
            Some(error) if !options.loss_only => {
                let typical = typical(&mesh.region_areas(), sensitivity, lambda * amplitude);
                let quick = Quick::new(solution.matrix(), &typical, error);
                Some(quick.ok_or(OneStepError::Prior)?)
            }
            _ => None,
        };
        Ok(Self {
            lambda,
            raised,
            degrees,
            noise_figure: figure(&solution),
            solution,
            quick,
        })
    }

    /// The map of a change.
    pub(super) fn map(
        &self,
        linear: &Linear,
        change: &mut [f64],
        missing: &[usize],
    ) -> Result<Vec<f64>, OneStepError> {
        self.solution.impute(&linear.fold, change, missing)?;
        let data = linear.fold.data(change);
        let quick = self.quick.as_ref().and_then(|quick| quick.map(&data));
        Ok(quick.map_or_else(|| self.solution.apply(&data), |(values, _)| values))
    }
}

/// Typical data for the choice of a rank: some single triangles, each as strong as a small disc with half its
/// conductance lost, with the noise of a difference on every row.
fn typical(areas: &[f64], sensitivity: &DMatrix<f64>, noise: f64) -> DMatrix<f64> {
    const LOADS: usize = 48;
    let area: f64 = areas.iter().sum();
    let disc = (0.5 * noise_figure::LOAD).powi(2) * std::f64::consts::PI * area;
    DMatrix::from_fn(sensitivity.nrows(), LOADS, |row, load| {
        let unknown = (2 * load + 1) * areas.len() / (2 * LOADS);
        // with root mean square 1
        let shake = (1.7 * row as f64 + 2.3 * load as f64).sin() * std::f64::consts::SQRT_2;
        -0.5 * disc / areas[unknown] * sensitivity[(row, unknown)] + noise * shake
    })
}
