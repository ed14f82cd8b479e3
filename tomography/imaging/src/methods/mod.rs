//! The methods that need no model file, each prepared from settings and [`Conditions`]. Not included: the mathematics
//! (crate `eit`), model files, calibrations.

mod best;
mod hyper_parameter;
mod one_step;
mod total_variation;

use std::sync::Arc;

use eit::{Reconstructor, WholeSheet};

pub(crate) use hyper_parameter::{known_noise_v, noise_v};

use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::geometry::Geometry;
use crate::settings::{Method, ReconstructionSettings, Unknowns};

/// A prepared method.
pub(crate) struct Prepared {
    pub(crate) reconstructor: Arc<dyn Reconstructor>,
    /// Decisions and remarks, one sentence each.
    pub(crate) notes: Vec<String>,
    /// Whether a frame takes so long that frames should be reconstructed in parallel.
    pub(crate) slow: bool,
}

impl Prepared {
    fn quick(
        reconstructor: impl Reconstructor + 'static,
        notes: Vec<String>,
        conditions: &Conditions<'_>,
    ) -> Self {
        Self {
            reconstructor: match conditions.shown {
                None => Arc::new(reconstructor),
                Some(shown) => {
                    Arc::new(WholeSheet::new(Box::new(reconstructor), Arc::clone(shown)))
                }
            },
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
        Method::OneStep => for_unknowns(settings, conditions, one_step::prepare),
        Method::Best => best::prepare(settings, conditions),
        Method::Tv => for_unknowns(settings, conditions, total_variation::prepare),
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

/// Prepares a method with the unknowns that the settings name; its maps show the region.
fn for_unknowns(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
    prepare: fn(&ReconstructionSettings, &Conditions<'_>) -> Result<Prepared, BuildError>,
) -> Result<Prepared, BuildError> {
    let shown = &conditions.geometry.mesh;
    let whole_sheet = settings.unknowns.unwrap_or(Unknowns::Sheet) == Unknowns::Sheet;
    if !whole_sheet || shown.region().len() == shown.triangles().len() {
        return prepare(settings, conditions);
    }
    let geometry = Geometry {
        mesh: Arc::new(shown.whole()),
        ..conditions.geometry.clone()
    };
    let conditions = Conditions {
        geometry: &geometry,
        shown: Some(shown),
        ..conditions.clone()
    };
    prepare(settings, &conditions)
}
