//! The methods that need no model file, each prepared from settings and [`Conditions`]. Not included: the mathematics
//! (crate `eit`), model files, calibrations.

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

/// A prepared method.
pub(crate) struct Prepared {
    pub(crate) reconstructor: Arc<dyn Reconstructor>,
    /// Decisions and remarks, a sentence each.
    pub(crate) notes: Vec<String>,
    /// Whether frames take so long that they should be reconstructed in parallel.
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

/// Prepares the method named in the settings.
///
/// # Errors
/// Settings that contradict each other, or a geometry that is unsuitable for the method.
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
