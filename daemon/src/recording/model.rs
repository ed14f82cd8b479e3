//! From configuration to geometry and reconstructor, with every mismatch named by both sides.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eit::inverse::learned::network::{OnnxError, is_onnx, load_onnx};
use eit::{
    Calibration, Case, Hyper, LossOnly, Mesh, OneStep, OneStepOptions, Preset, Prior,
    Reconstructor, SMOOTH_LENGTH_M, Tv, TvOptions,
};
use survey::{Amps, Protocol, Reading};

/// An error with its causes, for log, record and bus.
pub(crate) use survey::error_chain as chain;

use crate::config::{GeometrySection, MethodName, ModelSection, PresetName, PriorName};

/// Noise of one reading where nobody says, uV: a 34980A on its 1 V range at 1 PLC.
pub(crate) const DEFAULT_NOISE_UV: f64 = 2.0;

/// The sheet as the reconstruction sees it.
#[derive(Debug, Clone)]
pub(crate) struct Geometry {
    /// What a person calls it.
    pub name: String,
    pub mesh: Arc<Mesh>,
    pub contact_ohm_m: Vec<f64>,
    pub sigma0: Vec<f64>,
}

impl Geometry {
    pub(crate) fn electrodes(&self) -> usize {
        self.mesh.electrode_edges().len()
    }
}

/// A reconstructor and where it comes from.
#[derive(Clone)]
pub(crate) struct Model {
    pub reconstructor: Arc<dyn Reconstructor>,
    /// Of the model file; `None` for a method without one.
    pub hash: Option<String>,
    /// From its maps to pressure; `None` where nobody has calibrated it.
    pub calibration: Option<Arc<Calibration>>,
}

/// A half frame is not doubled for a model of whole ones: both readings of a pair would have the same noise, which a model
/// trained on independent noise takes for a change of the sheet.
const HALF: &str = ", or set survey.half = false (a whole frame), or take method = \"one-step\", which maps a half frame as it is";

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ModelFault {
    #[error("model file {}: {cause}", .path.display())]
    File {
        path: PathBuf,
        #[source]
        cause: eit::ModelError,
    },
    #[error(
        "model {model} asks {asks} readings of {model_electrodes} electrodes (survey {model_hash}), this rig asks {rig} \
         of {rig_electrodes} (survey {rig_hash}); use a model trained for this rig{}",
        if *.half { HALF } else { "" }
    )]
    Survey {
        model: String,
        asks: usize,
        model_electrodes: usize,
        model_hash: String,
        rig: usize,
        rig_electrodes: usize,
        rig_hash: String,
        /// Whether the rig reads half of what the model asks, and the other half is equal by reciprocity.
        half: bool,
    },
    #[error(
        "model {model} was made for geometry {model_hash}, this rig has {rig_hash} ({geometry}); use a model trained \
         for this geometry, or configure its geometry"
    )]
    Geometry {
        model: String,
        model_hash: String,
        rig_hash: String,
        geometry: String,
    },
    #[error(transparent)]
    Onnx(#[from] OnnxError),
    #[error("the one-step method: {0}")]
    OneStep(#[from] eit::OneStepError),
    #[error("total variation: {0}")]
    Tv(#[from] eit::TvError),
    #[error("calibration {}: {why}; fit one with tactus-lab calibrate", .path.display())]
    Calibration { path: PathBuf, why: String },
    #[error("{0}")]
    Setting(String),
}

impl ModelFault {
    /// Whether the file is sound and only made for something else.
    pub(crate) fn is_mismatch(&self) -> bool {
        matches!(
            self,
            Self::Survey { .. }
                | Self::Geometry { .. }
                | Self::Onnx(OnnxError::Shape { .. } | OnnxError::Other { .. })
        )
    }
}

/// Reads or makes the geometry. `case` is a case folder that a recording brings along.
pub(crate) fn geometry(section: &GeometrySection, case: Option<&Path>) -> Result<Geometry, String> {
    let brought = case.filter(|folder| folder.join("nodes.csv").exists());
    if section.preset.is_some() && section.case.is_some() {
        return Err("give a preset or a case folder, not both".to_owned());
    }
    let folder = match (&section.case, section.preset, brought) {
        (Some(folder), _, _) => Some(folder.as_path()),
        (None, None, Some(folder)) => Some(folder),
        _ => None,
    };
    if let Some(folder) = folder {
        let case = Case::read(folder).map_err(|cause| chain(&cause))?;
        let sigma0 = case
            .sigma("homog")
            .unwrap_or_else(|_| vec![1e-3; case.mesh.triangles().len()]);
        return Ok(Geometry {
            name: format!("case {}", folder.display()),
            mesh: case.mesh,
            contact_ohm_m: case.contact_ohm_m,
            sigma0,
        });
    }
    let preset = match section.preset.unwrap_or_default() {
        PresetName::PaperSheet => {
            Preset::PaperSheet(section.paper_sheet.clone().unwrap_or_default())
        }
        PresetName::DiscTank => Preset::DiscTank(section.disc_tank.clone().unwrap_or_default()),
    };
    let mesh = preset.mesh().map_err(|cause| chain(&cause))?;
    let name = match &preset {
        Preset::PaperSheet(_) => "preset paper-sheet",
        Preset::DiscTank(_) => "preset disc-tank",
    };
    Ok(Geometry {
        name: name.to_owned(),
        sigma0: vec![preset.conductance(); mesh.triangles().len()],
        contact_ohm_m: preset.contact_ohm_m(),
        mesh: Arc::new(mesh),
    })
}

/// Loads the model file, or prepares the method for frames taken at this current.
pub(crate) fn model(
    section: &ModelSection,
    current: Amps,
    geometry: &Geometry,
    protocol: &Protocol,
) -> Result<Model, ModelFault> {
    let mut model = match &section.file {
        Some(path) => {
            let loss_only = section.loss_only.unwrap_or(false);
            from_file(path, loss_only, geometry, protocol)?
        }
        None => match section.method.unwrap_or_default() {
            MethodName::OneStep => one_step(section, current, geometry, protocol)?,
            MethodName::Tv => total_variation(section, current, geometry, protocol)?,
        },
    };
    if let Some(path) = &section.calibration {
        model.calibration = Some(Arc::new(calibration(path, geometry, &model)?));
    }
    Ok(model)
}

/// Reads a calibration and checks that it was fitted to this method's maps on this geometry.
fn calibration(path: &Path, geometry: &Geometry, model: &Model) -> Result<Calibration, ModelFault> {
    let refused = |why: String| ModelFault::Calibration {
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
            short(&calibration.mesh),
            short(geometry.mesh.hash()),
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

/// Loads a model file and checks that it was made for this survey and this geometry. `loss_only` cuts its maps.
pub(crate) fn from_file(
    path: &Path,
    loss_only: bool,
    geometry: &Geometry,
    protocol: &Protocol,
) -> Result<Model, ModelFault> {
    if is_onnx(path) {
        return onnx(path, loss_only, geometry, protocol);
    }
    let loaded = eit::model::load(path).map_err(|cause| ModelFault::File {
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
) -> Result<Model, ModelFault> {
    let network = load_onnx(path, Arc::clone(&geometry.mesh), protocol)?;
    let bytes = std::fs::read(path).map_err(|cause| ModelFault::File {
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
    geometry: &Geometry,
    protocol: &Protocol,
) -> Result<(), ModelFault> {
    let name = path.display().to_string();
    if model.protocol() != protocol {
        return Err(ModelFault::Survey {
            model: name,
            asks: model.protocol().len(),
            model_electrodes: model.protocol().electrodes(),
            model_hash: short(&model.protocol().hash()),
            rig: protocol.len(),
            rig_electrodes: protocol.electrodes(),
            rig_hash: short(&protocol.hash()),
            half: model
                .protocol()
                .answered_by(protocol, &vec![Reading::NotMeasured; protocol.len()])
                .is_some(),
        });
    }
    if model.mesh().hash() != geometry.mesh.hash() {
        return Err(ModelFault::Geometry {
            model: name,
            model_hash: short(model.mesh().hash()),
            rig_hash: short(geometry.mesh.hash()),
            geometry: geometry.name.clone(),
        });
    }
    Ok(())
}

/// Prepares the one-step method for frames taken at this current; settings not given have their defaults.
pub(crate) fn one_step(
    section: &ModelSection,
    current: Amps,
    geometry: &Geometry,
    protocol: &Protocol,
) -> Result<Model, ModelFault> {
    let prior = match section.prior.unwrap_or_default() {
        PriorName::Tikhonov => Prior::Tikhonov,
        PriorName::Noser => Prior::noser(section.prior.is_some(), section.exponent),
        PriorName::Laplace => Prior::Laplace,
        PriorName::Gaussian => Prior::Gaussian {
            length_m: section.length_mm.map_or(SMOOTH_LENGTH_M, |mm| 1e-3 * mm),
        },
    };
    let hyper = match (section.lambda, section.noise_figure, section.noise_uv) {
        (Some(_), Some(_), _) | (Some(_), _, Some(_)) | (_, Some(_), Some(_)) => {
            return Err(ModelFault::Setting(
                "give one of lambda, noise_figure and noise_uv".to_owned(),
            ));
        }
        (Some(lambda), None, None) => Hyper::Lambda(lambda),
        (None, Some(figure), None) => Hyper::NoiseFigure(figure),
        (None, None, noise) => Hyper::Noise {
            volts: noise.unwrap_or(DEFAULT_NOISE_UV) * 1e-6,
            current: current.0,
        },
    };
    let loss_only = section.loss_only.unwrap_or(false);
    if loss_only && matches!(prior, Prior::Gaussian { .. }) {
        return Err(ModelFault::Setting(
            "loss_only with the gaussian prior takes longer than a frame; take tikhonov, noser or laplace, and \
             tactus-lab reconstruct for the gaussian one"
                .to_owned(),
        ));
    }
    let options = OneStepOptions {
        prior,
        hyper,
        loss_only,
        map_error: section.map_error,
        ..OneStepOptions::default()
    };
    let one_step = OneStep::new(
        Arc::clone(&geometry.mesh),
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        protocol,
        options,
    )?;
    Ok(Model {
        reconstructor: Arc::new(one_step),
        hash: None,
        calibration: None,
    })
}

/// Prepares total variation for frames taken at this current, with cold starts: a map depends on its frame alone.
fn total_variation(
    section: &ModelSection,
    current: Amps,
    geometry: &Geometry,
    protocol: &Protocol,
) -> Result<Model, ModelFault> {
    let usual = TvOptions::default();
    let options = TvOptions {
        noise_v: section.noise_uv.unwrap_or(DEFAULT_NOISE_UV) * 1e-6,
        current_a: current.0,
        loss_only: section.loss_only.unwrap_or(false),
        gap: section.gap.unwrap_or(usual.gap),
        ..usual
    };
    let tv = Tv::new(
        Arc::clone(&geometry.mesh),
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        protocol,
        options,
    )?;
    Ok(Model {
        reconstructor: Arc::new(tv),
        hash: None,
        calibration: None,
    })
}

fn short(hash: &str) -> String {
    hash.chars().take(12).collect()
}
