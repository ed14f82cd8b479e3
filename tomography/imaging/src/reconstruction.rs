//! Builds a reconstructor from settings; errors name both sides of a mismatch.

use std::path::Path;
use std::sync::Arc;

use eit::{Calibration, ModelCheck, Scale};

use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::methods;
use crate::methods::AfterFrames;
use crate::model::Model;
use crate::model_file::{load, short_hash};
use crate::settings::{Method, PriorName, ReconstructionSettings};

/// Refuses settings for which a map would take longer than the frame period of a running instrument.
///
/// # Errors
/// [`BuildError::Setting`], with the alternative to use.
pub fn check_live(settings: &ReconstructionSettings) -> Result<(), BuildError> {
    if settings.file.is_none()
        && settings.method.unwrap_or_default() == Method::OneStep
        && settings.loss_only.unwrap_or(false)
        && settings.prior == Some(PriorName::Gaussian)
    {
        return Err(BuildError::Setting(
            "loss_only with the gaussian prior takes longer than a frame; take tikhonov, noser or laplace, and \
             tactus-lab reconstruct for the gaussian one"
                .to_owned(),
        ));
    }
    Ok(())
}

/// Loads the model file or prepares the method named in the settings. Settings that the method does not use have no
/// effect; [`ReconstructionSettings::ignored`] lists them.
///
/// # Errors
/// A file that cannot be read or was made for another protocol or geometry, settings that contradict each other, or a
/// geometry that the method cannot use.
pub fn build(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Model, BuildError> {
    let loss_only = settings.loss_only.unwrap_or(false);
    let mut model = match &settings.file {
        Some(path) => load(
            path,
            loss_only,
            conditions.protocol,
            Some(conditions.geometry),
        )?,
        None if conditions.sample.is_none() && settings.looks_at_frames() => {
            let after_frames = Arc::new(AfterFrames::new(settings, conditions)?);
            Model {
                after_frames: Some(Arc::clone(&after_frames)),
                ..Model::new(after_frames)
            }
        }
        None => {
            let prepared = methods::prepare(settings, conditions)?;
            Model {
                notes: prepared.notes,
                slow: prepared.slow,
                ..Model::new(prepared.reconstructor)
            }
        }
    };
    if let Some(path) = &settings.calibration {
        calibrate(&mut model, path)?;
    }
    model.check = Some(Arc::new(model_check(settings, conditions)?));
    Ok(model)
}

/// The check of frames against the model of the whole sheet.
fn model_check(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<ModelCheck, BuildError> {
    let geometry = conditions.geometry;
    let measured = conditions.noise_v.filter(|_| !conditions.noise_assumed);
    let noise_v = settings.noise_uv.map(|noise| noise * 1e-6).or(measured);
    let noise = match &conditions.scale {
        Scale::Currents(_) => noise_v,
        Scale::ByDistance | Scale::Uniform => noise_v.map(|volts| volts / conditions.current.0),
    };
    Ok(ModelCheck::new(
        &geometry.mesh,
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        conditions.protocol,
        conditions.scale.clone(),
        noise,
    )?)
}

/// Reads a calibration for a model.
///
/// # Errors
/// A file that cannot be read, or a calibration that was fitted to another method's maps or on another mesh.
pub fn calibrate(model: &mut Model, path: &Path) -> Result<(), BuildError> {
    let refused = |why: String| BuildError::Calibration {
        path: path.to_owned(),
        why,
    };
    let text = std::fs::read_to_string(path).map_err(|cause| refused(cause.to_string()))?;
    let calibration: Calibration =
        toml::from_str(&text).map_err(|fault| refused(fault.to_string()))?;
    calibration
        .check()
        .map_err(|fault| refused(fault.to_string()))?;
    let mesh = model.reconstructor.mesh().hash();
    if calibration.mesh != mesh {
        return Err(refused(format!(
            "it was fitted on mesh {}, the maps are on {}",
            short_hash(&calibration.mesh),
            short_hash(mesh),
        )));
    }
    let fits = match &model.after_frames {
        Some(after_frames) => after_frames.may_make(&calibration.method),
        None => calibration.method == model.reconstructor.method(),
    };
    if !fits {
        return Err(refused(format!(
            "it was fitted to maps of '{}', this method is '{}'",
            calibration.method,
            model.reconstructor.method()
        )));
    }
    model.calibration = Some(Arc::new(calibration));
    Ok(())
}
