//! Errors of building a reconstructor.

use std::path::PathBuf;

use eit::inverse::learned::network::OnnxError;

/// Why a half frame is not completed for a model of whole frames: both readings of a pair would have the same noise,
/// and a model trained on independent noise would interpret that as a change of the sheet.
const HALF: &str = ", or set survey.half = false (a whole frame), or use method = \"one-step\", which accepts a half frame";

/// Why no reconstructor can be built.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The model file cannot be read.
    #[error(transparent)]
    File(#[from] eit::ModelError),
    /// The model was made for another protocol.
    #[error(
        "model {model} needs {asks} readings of {model_electrodes} electrodes (protocol {model_hash}), the frames have {rig} \
         of {rig_electrodes} (protocol {rig_hash}); use a model trained for this protocol{}",
        if *.half { HALF } else { "" }
    )]
    Survey {
        /// The model file.
        model: String,
        /// Readings of the model.
        asks: usize,
        /// Electrodes of the model.
        model_electrodes: usize,
        /// Hash of the model's protocol, shortened.
        model_hash: String,
        /// Readings of the frames.
        rig: usize,
        /// Electrodes of the frames.
        rig_electrodes: usize,
        /// Hash of the protocol in use, shortened.
        rig_hash: String,
        /// Whether the rig measures half of the model's readings, and the other half is equal by reciprocity.
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
        /// Hash of the model's geometry, shortened.
        model_hash: String,
        /// Hash of the geometry in use, shortened.
        rig_hash: String,
        /// Name of the geometry in use.
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
    /// The recording was not made with this geometry.
    #[error(
        "the baseline does not look like this geometry: it is zero, its readings have the opposite sign of the model's, or \
         none is valid; if they are magnitudes, give --negate"
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
    /// Whether the file is valid but made for something else.
    pub fn is_mismatch(&self) -> bool {
        matches!(
            self,
            Self::Survey { .. }
                | Self::Geometry { .. }
                | Self::Onnx(OnnxError::Shape { .. } | OnnxError::Other { .. })
        )
    }
}
