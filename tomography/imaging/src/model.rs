//! A reconstructor that is ready for frames.

use std::sync::Arc;

use eit::{Calibration, LossOnly, Reconstructor};

use crate::methods::AfterFrames;

/// A reconstructor and where it comes from.
#[derive(Clone)]
pub struct Model {
    /// Makes the maps.
    pub reconstructor: Arc<dyn Reconstructor>,
    /// Of the model file; `None` for a method without one.
    pub hash: Option<String>,
    /// From its maps to pressure; `None` where none is configured.
    pub calibration: Option<Arc<Calibration>>,
    /// What was decided, and what to know of it, a sentence each.
    pub notes: Vec<String>,
    /// Whether a frame takes so long that frames are better made side by side.
    pub slow: bool,
    /// The reconstructor once more, where it is settled by the first frames that it is given.
    pub(crate) after_frames: Option<Arc<AfterFrames>>,
}

impl Model {
    /// A reconstructor without model file, calibration and notes.
    pub fn new(reconstructor: Arc<dyn Reconstructor>) -> Self {
        Self {
            reconstructor,
            hash: None,
            calibration: None,
            notes: Vec::new(),
            slow: false,
            after_frames: None,
        }
    }

    /// A trained reconstructor; `loss_only` cuts its maps to losses.
    pub fn trained(trained: Box<dyn Reconstructor>, loss_only: bool) -> Self {
        Self::new(match loss_only {
            true => Arc::new(LossOnly::new(trained)),
            false => Arc::from(trained),
        })
    }

    /// The same for another run of frames: a method that is settled by its first frames has seen none.
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

    /// Whether the method is settled by the first frames that it is given.
    pub fn looks_at_frames(&self) -> bool {
        self.after_frames.is_some()
    }

    /// What was decided since this was last called, in a sentence; `None` where nothing was.
    pub fn decided(&self) -> Option<String> {
        self.after_frames.as_ref()?.decided()
    }
}
