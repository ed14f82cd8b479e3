//! The methods that need no model file, each prepared from settings and [`Conditions`].
//! Left to others: the mathematics (crate `eit`), model files, calibrations.

mod after_frames;
mod best;
mod hyper_parameter;
mod one_step;
mod total_variation;

use std::sync::Arc;

use eit::Reconstructor;

pub(crate) use after_frames::AfterFrames;
pub use after_frames::FRAMES_LOOKED_AT;

use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::settings::{Method, ReconstructionSettings};

/// A method that is ready.
pub(crate) struct Prepared {
    pub(crate) reconstructor: Arc<dyn Reconstructor>,
    /// What was decided, and what to know of it, a sentence each.
    pub(crate) notes: Vec<String>,
    /// Whether a frame takes so long that frames are better made side by side.
    pub(crate) slow: bool,
}

impl Prepared {
    fn quick(reconstructor: impl Reconstructor + 'static, notes: Vec<String>) -> Self {
        Self {
            reconstructor: Arc::new(reconstructor),
            notes,
            slow: false,
        }
    }
}

/// Prepares the method that the settings name.
///
/// # Errors
/// Settings that contradict each other, or a geometry that the method cannot use.
pub(crate) fn prepare(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Prepared, BuildError> {
    match settings.method.unwrap_or_default() {
        Method::OneStep => one_step::prepare(settings, conditions),
        Method::Best => best::prepare(settings, conditions),
        Method::Tv => total_variation::prepare(settings, conditions),
        Method::TvPaper => total_variation::paper(settings, conditions),
        trained @ (Method::Linear | Method::Rbf | Method::Dnn) => {
            let name = trained.name();
            Err(BuildError::Setting(format!(
                "method {name} needs a model file: train one with tactus-lab train {name}, and name it (--model FILE, or \
                 file in [model])"
            )))
        }
    }
}
