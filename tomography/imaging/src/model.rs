//! A reconstructor ready for frames, with its origin and remarks.

use std::sync::Arc;

use eit::{Calibration, LossOnly, ModelCheck, ReconstructError, Reconstructor};
use survey::{Map, Reading};

use crate::methods::AfterFrames;

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
    /// The same reconstructor, if its parameters are chosen from the first frames.
    pub(crate) after_frames: Option<Arc<AfterFrames>>,
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
            after_frames: None,
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

    /// A copy for another run of frames: parameters chosen from the first frames are chosen again.
    pub fn for_session(&self) -> Self {
        let Some(after_frames) = &self.after_frames else {
            return self.clone();
        };
        let fresh = Arc::new(after_frames.fresh());
        Self {
            reconstructor: Arc::clone(&fresh) as Arc<dyn Reconstructor>,
            after_frames: Some(fresh),
            ..self.clone()
        }
    }

    /// Whether its parameters are chosen from the first frames.
    pub fn looks_at_frames(&self) -> bool {
        self.after_frames.is_some()
    }

    /// The decision made since the last call, in a sentence; `None` if there is none.
    pub fn decided(&self) -> Option<String> {
        self.after_frames.as_ref()?.decided()
    }
}
