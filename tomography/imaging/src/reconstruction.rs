//! From settings to a reconstructor, with every mismatch named by both sides.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eit::inverse::learned::network::{OnnxError, is_onnx, load_onnx};
use eit::{Calibration, Hyper, LossOnly, OneStep, OneStepOptions, Reconstructor, Tv, TvOptions};
use survey::{Amps, Protocol, Reading};

use crate::geometry::Geometry;
use crate::noise::DEFAULT_NOISE_UV;
use crate::settings::{Method, PriorName, ReconstructionSettings};
use crate::stored_models::short_hash;

/// What frames are taken with, and what is known of them before any is reconstructed.
#[derive(Debug, Clone, Copy)]
pub struct Conditions<'a> {
    /// The sheet or tank.
    pub geometry: &'a Geometry,
    /// The readings of a frame.
    pub protocol: &'a Protocol,
    /// Current of the frames, or the factor from the model's readings at 1 A to the recording's unit.
    pub current: Amps,
    /// Standard deviation of one reading, V, where the settings do not say it; else [`DEFAULT_NOISE_UV`].
    pub noise_v: Option<f64>,
}

/// A reconstructor and where it comes from.
#[derive(Clone)]
pub struct Model {
    /// Makes the maps.
    pub reconstructor: Arc<dyn Reconstructor>,
    /// Of the model file; `None` for a method without one.
    pub hash: Option<String>,
    /// From its maps to pressure; `None` where none is configured.
    pub calibration: Option<Arc<Calibration>>,
}

/// A half frame is not doubled for a model of whole ones: both readings of a pair would have the same noise, which a model
/// trained on independent noise takes for a change of the sheet.
const HALF: &str = ", or set survey.half = false (a whole frame), or take method = \"one-step\", which maps a half frame as it is";

/// Why there is no reconstructor.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The model file cannot be read.
    #[error("model file {}: {cause}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        #[source]
        cause: eit::ModelError,
    },
    /// The model takes other readings than the frames have.
    #[error(
        "model {model} asks {asks} readings of {model_electrodes} electrodes (survey {model_hash}), this rig asks {rig} \
         of {rig_electrodes} (survey {rig_hash}); use a model trained for this rig{}",
        if *.half { HALF } else { "" }
    )]
    Survey {
        /// The model file.
        model: String,
        /// Readings of the model.
        asks: usize,
        /// Electrodes of the model.
        model_electrodes: usize,
        /// Of what the model was made for, shortened.
        model_hash: String,
        /// Readings of the frames.
        rig: usize,
        /// Electrodes of the frames.
        rig_electrodes: usize,
        /// Of what is used here, shortened.
        rig_hash: String,
        /// Whether the rig reads half of what the model asks, and the other half is equal by reciprocity.
        half: bool,
    },
    /// The model was made for another geometry.
    #[error(
        "model {model} was made for geometry {model_hash}, this rig has {rig_hash} ({geometry}); use a model trained \
         for this geometry, or configure its geometry"
    )]
    Geometry {
        /// The model file.
        model: String,
        /// Of what the model was made for, shortened.
        model_hash: String,
        /// Of what is used here, shortened.
        rig_hash: String,
        /// What the geometry is called.
        geometry: String,
    },
    /// An ONNX file cannot be used.
    #[error(transparent)]
    Onnx(#[from] OnnxError),
    /// The one-step method cannot be prepared.
    #[error("the one-step method: {0}")]
    OneStep(#[from] eit::OneStepError),
    /// Total variation cannot be prepared.
    #[error("total variation: {0}")]
    Tv(#[from] eit::TvError),
    /// A calibration cannot be used.
    #[error("calibration {}: {why}; fit one with tactus-lab calibrate", .path.display())]
    Calibration {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// Settings that contradict each other.
    #[error("{0}")]
    Setting(String),
}

impl BuildError {
    /// Whether the file is sound and only made for something else.
    pub fn is_mismatch(&self) -> bool {
        matches!(
            self,
            Self::Survey { .. }
                | Self::Geometry { .. }
                | Self::Onnx(OnnxError::Shape { .. } | OnnxError::Other { .. })
        )
    }
}

/// Refuses a combination of settings that takes longer than a frame of a running instrument.
///
/// # Errors
/// [`BuildError::Setting`], with what to take in its place.
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

/// Loads the model file, or prepares the method, as the settings say.
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
        None => match settings.method.unwrap_or_default() {
            Method::OneStep => one_step(settings, conditions)?,
            Method::Tv => total_variation(settings, conditions)?,
        },
    };
    if let Some(path) = &settings.calibration {
        model.calibration = Some(Arc::new(calibration(path, conditions.geometry, &model)?));
    }
    Ok(model)
}

/// Reads a calibration and checks that it was fitted to this method's maps on this geometry.
fn calibration(path: &Path, geometry: &Geometry, model: &Model) -> Result<Calibration, BuildError> {
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
    if calibration.mesh != geometry.mesh.hash() {
        return Err(refused(format!(
            "it was fitted on mesh {}, this rig has {} ({})",
            short_hash(&calibration.mesh),
            short_hash(geometry.mesh.hash()),
            geometry.name
        )));
    }
    if calibration.method != model.reconstructor.method() {
        return Err(refused(format!(
            "it was fitted to maps of '{}', the configured method is '{}'",
            calibration.method,
            model.reconstructor.method()
        )));
    }
    Ok(calibration)
}

/// Loads a model file and checks that it was made for this protocol, and for this geometry where one is given; an ONNX
/// file says nothing of geometry and protocol, takes both from here, and cannot do without. `loss_only` cuts its maps.
///
/// # Errors
/// A file that cannot be read, or that was made for something else.
pub fn load(
    path: &Path,
    loss_only: bool,
    protocol: &Protocol,
    geometry: Option<&Geometry>,
) -> Result<Model, BuildError> {
    if is_onnx(path) {
        let geometry = geometry.ok_or_else(|| {
            BuildError::Setting(format!(
                "model {} is an ONNX file, which holds no mesh; name a preset or a case folder",
                path.display()
            ))
        })?;
        return onnx(path, loss_only, geometry, protocol);
    }
    let loaded = eit::model::load(path).map_err(|cause| BuildError::File {
        path: path.to_owned(),
        cause,
    })?;
    let hash = Some(loaded.hash().to_owned());
    let reconstructor = cut(loaded.into_reconstructor(), loss_only);
    check(path, reconstructor.as_ref(), geometry, protocol)?;
    Ok(Model {
        reconstructor,
        hash,
        calibration: None,
    })
}

fn cut(trained: Box<dyn Reconstructor>, loss_only: bool) -> Arc<dyn Reconstructor> {
    match loss_only {
        true => Arc::new(LossOnly::new(trained)),
        false => Arc::from(trained),
    }
}

/// A network trained elsewhere; its file says nothing of sheet and survey, so both are this rig's.
fn onnx(
    path: &Path,
    loss_only: bool,
    geometry: &Geometry,
    protocol: &Protocol,
) -> Result<Model, BuildError> {
    let network = load_onnx(path, Arc::clone(&geometry.mesh), protocol)?;
    let bytes = std::fs::read(path).map_err(|cause| BuildError::File {
        path: path.to_owned(),
        cause: eit::ModelError::Io {
            path: path.to_owned(),
            cause,
        },
    })?;
    Ok(Model {
        reconstructor: cut(network, loss_only),
        hash: Some(eit::model::fingerprint(&bytes)),
        calibration: None,
    })
}

fn check(
    path: &Path,
    model: &dyn Reconstructor,
    geometry: Option<&Geometry>,
    protocol: &Protocol,
) -> Result<(), BuildError> {
    let name = path.display().to_string();
    if model.protocol() != protocol {
        return Err(BuildError::Survey {
            model: name,
            asks: model.protocol().len(),
            model_electrodes: model.protocol().electrodes(),
            model_hash: short_hash(&model.protocol().hash()).to_owned(),
            rig: protocol.len(),
            rig_electrodes: protocol.electrodes(),
            rig_hash: short_hash(&protocol.hash()).to_owned(),
            half: model
                .protocol()
                .answered_by(protocol, &vec![Reading::NotMeasured; protocol.len()])
                .is_some(),
        });
    }
    if let Some(geometry) = geometry.filter(|geometry| model.mesh().hash() != geometry.mesh.hash())
    {
        return Err(BuildError::Geometry {
            model: name,
            model_hash: short_hash(model.mesh().hash()).to_owned(),
            rig_hash: short_hash(geometry.mesh.hash()).to_owned(),
            geometry: geometry.name.clone(),
        });
    }
    Ok(())
}

/// Noise of one reading, V.
fn noise_v(settings: &ReconstructionSettings, conditions: &Conditions<'_>) -> f64 {
    settings
        .noise_uv
        .map(|noise| noise * 1e-6)
        .or(conditions.noise_v)
        .unwrap_or(DEFAULT_NOISE_UV * 1e-6)
}

fn one_step(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Model, BuildError> {
    let hyper = match (settings.lambda, settings.noise_figure, settings.noise_uv) {
        (Some(_), Some(_), _) | (Some(_), _, Some(_)) | (_, Some(_), Some(_)) => {
            return Err(BuildError::Setting(
                "give one of lambda, noise_figure and noise_uv".to_owned(),
            ));
        }
        (Some(lambda), None, None) => Hyper::Lambda(lambda),
        (None, Some(figure), None) => Hyper::NoiseFigure(figure),
        (None, None, _) => Hyper::Noise {
            volts: noise_v(settings, conditions),
            current: conditions.current.0,
        },
    };
    let options = OneStepOptions {
        prior: settings.one_step_prior(),
        hyper,
        loss_only: settings.loss_only.unwrap_or(false),
        map_error: settings.map_error,
        ..OneStepOptions::default()
    };
    let geometry = conditions.geometry;
    let one_step = OneStep::new(
        Arc::clone(&geometry.mesh),
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        conditions.protocol,
        options,
    )?;
    Ok(Model {
        reconstructor: Arc::new(one_step),
        hash: None,
        calibration: None,
    })
}

/// Total variation with cold starts: a map depends on its frame alone.
fn total_variation(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Model, BuildError> {
    let usual = TvOptions::default();
    let options = TvOptions {
        noise_v: noise_v(settings, conditions),
        current_a: conditions.current.0,
        loss_only: settings.loss_only.unwrap_or(false),
        gap: settings.gap.unwrap_or(usual.gap),
        ..usual
    };
    let geometry = conditions.geometry;
    let tv = Tv::new(
        Arc::clone(&geometry.mesh),
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        conditions.protocol,
        options,
    )?;
    Ok(Model {
        reconstructor: Arc::new(tv),
        hash: None,
        calibration: None,
    })
}
