//! Builds a reconstructor from settings; errors name both sides of a mismatch.

use std::path::Path;
use std::sync::Arc;

use eit::{Calibration, ModelCheck, Reconstructor, Scale};

use crate::conditions::Conditions;
use crate::drift_removal::{DriftRemoved, FittedSheet, REMARK};
use crate::error::BuildError;
use crate::methods;
use crate::model::Model;
use crate::model_file::{load, short_hash};
use crate::settings::{DriftRule, HyperChoice, Method, PriorName, ReconstructionSettings};

/// Refuses settings for which a map would take longer than the frame period of a running instrument.
///
/// # Errors
/// [`BuildError::Setting`], which names an alternative.
pub fn check_live(settings: &ReconstructionSettings) -> Result<(), BuildError> {
    if settings.file.is_none()
        && matches!(
            settings.method.unwrap_or_default(),
            Method::OneStep | Method::Best
        )
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
    judging(unjudged(settings, conditions)?, settings, conditions)
}

/// As [`build`], without the quality check of maps and without removal of drift; [`judging`] adds the former,
/// [`with_drift`] the latter.
///
/// # Errors
/// As [`build`].
pub fn unjudged(
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
        None => {
            let prepared = methods::prepare(settings, conditions)?;
            Model {
                notes: prepared.notes,
                slow: prepared.slow,
                varies: settings.method == Some(Method::Best),
                fixed_strength: fixed_strength(settings, conditions)?,
                ..Model::new(prepared.reconstructor)
            }
        }
    };
    if let Some(path) = &settings.calibration {
        calibrate(&mut model, path)?;
    }
    with_drift(model, settings, conditions)
}

/// Adds the quality check against the model of the whole sheet to a model of [`unjudged`].
///
/// # Errors
/// A geometry that cannot be solved.
pub fn judging(
    model: Model,
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Model, BuildError> {
    let check = Arc::new(model_check(settings, conditions)?);
    Ok(Model {
        check: Some(check),
        ..model
    })
}

/// Adds removal of drift from each frame to a model, if the settings select it. [`build`] does this itself.
///
/// # Errors
/// [`BuildError::Setting`] if the baseline is tracked: its drift is removed already.
pub fn with_drift(
    mut model: Model,
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Model, BuildError> {
    let noise_v = methods::noise_v(settings, conditions);
    let sheet = Arc::new(FittedSheet::new(conditions, noise_v));
    model.sheet = Some(Arc::clone(&sheet));
    if settings.drift.unwrap_or_default() == DriftRule::Off {
        return Ok(model);
    }
    if settings.tracking == Some(true) {
        return Err(BuildError::Setting(
            "drift = \"frame\" is for frames whose baseline is not tracked: set tracking = false, or leave drift out".to_owned(),
        ));
    }
    let removed = |inner| {
        Arc::new(DriftRemoved {
            inner,
            sheet: Arc::clone(&sheet),
        })
    };
    let removal = removed(Arc::clone(&model.reconstructor));
    model.reconstructor = Arc::clone(&removal) as Arc<dyn Reconstructor>;
    model.removal = Some(removal);
    model.fixed_strength = model
        .fixed_strength
        .map(|fixed| removed(fixed) as Arc<dyn Reconstructor>);
    model.notes.push(REMARK.to_owned());
    Ok(model)
}

/// The linear method with one regularisation strength for all frames, used for the significance threshold of methods
/// that choose the strength for each frame; `None` for other methods.
fn fixed_strength(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Option<Arc<dyn Reconstructor>>, BuildError> {
    let method = settings.method.unwrap_or_default();
    if !matches!(method, Method::OneStep | Method::Best) || settings.frame_rule().is_none() {
        return Ok(None);
    }
    let fixed = ReconstructionSettings {
        method: Some(Method::OneStep),
        choose: Some(HyperChoice::Noise),
        loss_only: None,
        ..settings.clone()
    };
    Ok(Some(methods::prepare(&fixed, conditions)?.reconstructor))
}

/// The quality check of maps against the model of the whole sheet.
fn model_check(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<ModelCheck, BuildError> {
    let geometry = conditions.geometry;
    let noise_v = methods::known_noise_v(settings, conditions);
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

/// Reads a calibration from its file.
///
/// # Errors
/// What is wrong with the file.
pub fn read_calibration(path: &Path) -> Result<Calibration, String> {
    let text = std::fs::read_to_string(path).map_err(|cause| cause.to_string())?;
    let calibration: Calibration = toml::from_str(&text).map_err(|fault| fault.to_string())?;
    calibration.check().map_err(|fault| fault.to_string())?;
    Ok(calibration)
}

/// Reads a calibration from a file and adds it to a model.
///
/// # Errors
/// A file that cannot be read, or a calibration that was fitted to another method's maps or on another mesh.
pub fn calibrate(model: &mut Model, path: &Path) -> Result<(), BuildError> {
    let refused = |why: String| BuildError::Calibration {
        path: path.to_owned(),
        why,
    };
    let calibration = read_calibration(path).map_err(refused)?;
    let mesh = model.reconstructor.mesh().hash();
    if calibration.mesh != mesh {
        return Err(refused(format!(
            "it was fitted on mesh {}, the maps are on {}",
            short_hash(&calibration.mesh),
            short_hash(mesh),
        )));
    }
    let fits = model.varies || calibration.method == model.reconstructor.method();
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
