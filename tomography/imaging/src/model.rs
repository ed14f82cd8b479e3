//! A reconstructor ready for frames, with its origin and remarks.

use std::sync::Arc;

use eit::{Calibration, LossOnly, ModelCheck, ReconstructError, Reconstructor};
use survey::{Map, Reading};

/// A reconstructor with its origin.
#[derive(Clone)]
pub struct Model {
    /// Makes the maps, without their quality: see [`Model::reconstruct`].
    pub reconstructor: Arc<dyn Reconstructor>,
    /// Hash of the model file; `None` for a method without one.
    pub hash: Option<String>,
    /// Conversion of its maps to pressure; `None` if not configured.
    pub calibration: Option<Arc<Calibration>>,
    /// Decisions and remarks, a sentence each.
    pub notes: Vec<String>,
    /// Whether frames take so long that they should be reconstructed in parallel.
    pub slow: bool,
    /// Whether its maps can be of another method than [`Reconstructor::method`], which each map names.
    pub(crate) varies: bool,
    /// The same method with one strength for all frames, if this one has a strength for each.
    pub(crate) fixed_strength: Option<Arc<dyn Reconstructor>>,
    /// Judges its maps; `None` if they are not judged.
    pub(crate) check: Option<Arc<ModelCheck>>,
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
        }
    }

    /// The map of a frame, with its quality.
    ///
    /// # Errors
    /// As [`Reconstructor::reconstruct`].
    pub fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let map = self.reconstructor.reconstruct(baseline, frame)?;
        Ok(match &self.check {
            Some(check) => check.judged(baseline, frame, map),
            None => map,
        })
    }

    /// Wraps a trained reconstructor; `loss_only` clips its maps to losses.
    pub fn trained(trained: Box<dyn Reconstructor>, loss_only: bool) -> Self {
        Self::new(match loss_only {
            true => Arc::new(LossOnly::new(trained)),
            false => Arc::from(trained),
        })
    }
}
