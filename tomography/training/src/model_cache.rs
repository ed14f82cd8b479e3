//! Cache of trained models; a training with the same settings is not repeated.

use std::path::{Path, PathBuf};

use eit::{Case, Model, TrainingSettings, model};
use outfile::Existing;

use crate::samples::TrainError;

/// A cached model.
#[derive(Debug)]
pub struct Cached {
    /// The model.
    pub model: Model,
    /// Whether it was trained by this call.
    pub is_new: bool,
    /// The path to which a new model was stored, or the reason why it was not.
    pub notes: Vec<String>,
}

/// The common current of a case's readings, A.
///
/// # Errors
/// [`TrainError::Currents`] if readings have several currents.
pub fn single_current(case: &Case) -> Result<f64, TrainError> {
    let first = case.currents.first().copied().unwrap_or(1.0);
    if case.currents.iter().all(|current| *current == first) {
        Ok(first.abs())
    } else {
        Err(TrainError::Currents)
    }
}

/// The model of a case: from the cache if it was trained before with the same settings, otherwise trained and cached.
pub(crate) fn kept(
    case: &Case,
    settings: &TrainingSettings,
    kind: &str,
    make: impl FnOnce() -> Result<Model, TrainError>,
) -> Result<Cached, TrainError> {
    let path = cache_file(case, settings, kind);
    if let Some(path) = &path
        && let Ok(model) = model::load(path)
        && model.is_for(&case.protocol, &case.mesh)
        && model.metadata().training == *settings
    {
        return Ok(Cached {
            model,
            is_new: false,
            notes: Vec::new(),
        });
    }
    let model = make()?;
    let mut notes = Vec::new();
    if let Some(path) = path {
        let kept = path
            .parent()
            .map_or(Ok(()), |folder| {
                outfile::make_folder(folder, Existing::Replace)
            })
            .map_err(|refused| refused.to_string())
            .and_then(|()| {
                model::save(&path, Existing::Replace, &model).map_err(|fault| fault.to_string())
            });
        notes.push(match kept {
            Ok(()) => format!("the trained network is kept in {}", path.display()),
            Err(why) => format!("the trained network is not kept: {why}"),
        });
    }
    Ok(Cached {
        model,
        is_new: true,
        notes,
    })
}

/// `$XDG_CACHE_HOME/tactus/KIND-HASH.safetensors`; the hash covers everything that the training depends on.
fn cache_file(case: &Case, settings: &TrainingSettings, kind: &str) -> Option<PathBuf> {
    let base = std::env::var_os("XDG_CACHE_HOME")
        .filter(|base| Path::new(base).is_absolute())
        .map(PathBuf::from)
        .or_else(|| std::env::var_os("HOME").map(|home| Path::new(&home).join(".cache")))?;
    let inputs = serde_json::json!({
        "geometry": case.mesh.hash(),
        "survey": case.protocol.hash(),
        "contact": case.contact_ohm_m,
        "sigma0": case.sigma.get("homog"),
        "settings": settings,
    });
    let hash = eit::model::fingerprint(inputs.to_string().as_bytes());
    Some(
        base.join("tactus")
            .join(format!("{kind}-{}.safetensors", &hash[..16])),
    )
}
