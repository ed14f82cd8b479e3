//! A reconstructor ready for frames, with its origin and remarks.

use std::sync::Arc;

use drift::MapDeviation;
use eit::{Calibration, LossOnly, ModelCheck, OwnMisfit, ReconstructError, Reconstructor};
use survey::{Map, Reading};

use crate::drift_removal::{DriftRemoved, FittedSheet};

/// A reconstructor with its origin.
#[derive(Clone)]
pub struct Model {
    /// Computes maps without their quality; [`Model::reconstruct`] adds it.
    pub reconstructor: Arc<dyn Reconstructor>,
    /// Hash of the model file; `None` for a method without one.
    pub hash: Option<String>,
    /// Conversion of its maps to pressure; `None` if not configured.
    pub calibration: Option<Arc<Calibration>>,
    /// Decisions and remarks, one sentence each.
    pub notes: Vec<String>,
    /// Whether a frame takes so long that frames should be reconstructed in parallel.
    pub slow: bool,
    /// Whether the method of a map can differ from [`Reconstructor::method`]; each map names its own.
    pub(crate) varies: bool,
    /// The same method with one regularisation strength for all frames, if `reconstructor` chooses one for each frame.
    pub(crate) fixed_strength: Option<Arc<dyn Reconstructor>>,
    /// Quality check of the maps; `None` if they are not judged.
    pub(crate) check: Option<Arc<ModelCheck>>,
    /// Misfit of its maps of held-out cases; `None` if its model file has none, and for a method without a file.
    pub(crate) own_misfit: Option<OwnMisfit>,
    /// The same object as `reconstructor`, if that removes the drift of each frame.
    pub(crate) removal: Option<Arc<DriftRemoved>>,
    /// The sheet fitted to a baseline; `None` without conditions of a measurement.
    pub(crate) sheet: Option<Arc<FittedSheet>>,
}

impl Model {
    /// Wraps a reconstructor without model file, calibration and remarks.
    pub fn new(reconstructor: Arc<dyn Reconstructor>) -> Self {
        Self {
            reconstructor,
            hash: None,
            calibration: None,
            notes: Vec::new(),
            slow: false,
            varies: false,
            fixed_strength: None,
            check: None,
            own_misfit: None,
            removal: None,
            sheet: None,
        }
    }

    /// The map of a frame, with its quality. If this model does not judge its maps, the quality is `None` even if the
    /// method itself reported doubts, which alone would look like a complete judgement.
    ///
    /// # Errors
    /// As [`Reconstructor::reconstruct`].
    pub fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let compared = match &self.removal {
            Some(removal) => Some(removal.compare(baseline, frame)?),
            None => None,
        };
        let (baseline, frame) = compared
            .as_ref()
            .map_or((baseline, frame), |[baseline, frame]| {
                (&baseline[..], &frame[..])
            });
        let method = self.removal.as_ref().map(|removal| &removal.inner);
        let map = method
            .unwrap_or(&self.reconstructor)
            .reconstruct(baseline, frame)?;
        Ok(match &self.check {
            Some(check) => check.judged(baseline, frame, map, self.own_misfit.as_ref()),
            None => Map {
                quality: None,
                ..map
            },
        })
    }

    /// Standard deviation of ln conductance of each triangle of the map, from the linear model with noise and drift of
    /// the frame, independent of the method. `None` for a model that was loaded without a geometry. The first call with
    /// a baseline takes a second, because the sheet is fitted to it.
    ///
    /// # Errors
    /// A baseline or frame with missing readings, or of another length.
    pub fn deviation(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Option<MapDeviation>, ReconstructError> {
        let sheet = self.sheet.as_ref();
        sheet
            .map(|sheet| sheet.deviation(baseline, frame))
            .transpose()
    }

    /// Wraps a trained reconstructor; `loss_only` clips its maps to losses.
    pub fn trained(trained: Box<dyn Reconstructor>, loss_only: bool) -> Self {
        Self::new(match loss_only {
            true => Arc::new(LossOnly::new(trained)),
            false => Arc::from(trained),
        })
    }
}
