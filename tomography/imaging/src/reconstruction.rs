//! From settings to a reconstructor, with every mismatch named by both sides.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eit::inverse::learned::network::OnnxError;
use eit::{Calibration, Reconstructor, Scale};
use survey::{Amps, Protocol, Reading};

use crate::after_frames::AfterFrames;
use crate::geometry::Geometry;
use crate::methods;
use crate::model_file::load;
use crate::settings::{Method, PriorName, ReconstructionSettings};
use crate::stored_models::short_hash;

/// Frames that are known before a method is settled, with the unloaded state: what its rules look at.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// The unloaded state.
    pub baseline: Vec<Reading>,
    /// The frames.
    pub frames: Vec<Vec<Reading>>,
}

/// What frames are taken with, and what is known of them before any is reconstructed.
#[derive(Debug, Clone)]
pub struct Conditions<'a> {
    /// The sheet or tank.
    pub geometry: &'a Geometry,
    /// The readings of a frame.
    pub protocol: &'a Protocol,
    /// Current of the frames, or the factor from the model's readings at 1 A to the recording's unit.
    pub current: Amps,
    /// Standard deviation of one reading, V, where the settings do not say it; else
    /// [`DEFAULT_NOISE_UV`](crate::noise::DEFAULT_NOISE_UV).
    pub noise_v: Option<f64>,
    /// How the baseline's own scale enters the model-based methods.
    pub scale: Scale,
    /// Frames that are known; without them a method that looks at frames is settled by the first
    /// [`FRAMES_LOOKED_AT`](crate::FRAMES_LOOKED_AT) that it is given.
    pub sample: Option<&'a Sample>,
}

impl<'a> Conditions<'a> {
    /// Of frames that are still to be measured.
    pub fn live(geometry: &'a Geometry, protocol: &'a Protocol, current: Amps) -> Self {
        Self {
            geometry,
            protocol,
            current,
            noise_v: None,
            scale: Scale::default(),
            sample: None,
        }
    }
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
    /// The forward model cannot be solved.
    #[error("the forward model: {0}")]
    Forward(#[from] eit::ForwardError),
    /// A recording that was not made with this geometry.
    #[error(
        "the baseline does not look like this geometry: it is zero, its readings have the opposite sign of the model's, or \
         none is valid; if they are magnitudes, say --negate"
    )]
    Unlike,
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

/// Loads the model file, or prepares the method, as the settings say. Settings that the method does not look at have no
/// effect; [`ReconstructionSettings::ignored`] names them.
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
    let fits = match &model.after_frames {
        Some(after_frames) => after_frames.may_make(&calibration.method),
        None => calibration.method == model.reconstructor.method(),
    };
    if !fits {
        return Err(refused(format!(
            "it was fitted to maps of '{}', the configured method is '{}'",
            calibration.method,
            model.reconstructor.method()
        )));
    }
    Ok(calibration)
}
