//! How maps are to be made, as a configuration says it.

use std::path::PathBuf;

use eit::{Prior, SMOOTH_LENGTH_M};
use serde::{Deserialize, Serialize};

/// Reconstruction without a trained model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "arguments", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// One-step difference reconstruction.
    #[default]
    OneStep,
    /// Total variation, to a gap of 1e-3 unless the session used another.
    Tv,
}

/// Prior of the one-step method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "arguments", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum PriorName {
    /// Small changes.
    Tikhonov,
    /// Small changes, weighed by sensitivity.
    #[default]
    Noser,
    /// Smooth changes.
    Laplace,
    /// Smooth changes of a stated correlation length: 10 mm unless the session used another.
    Gaussian,
}

/// The section `[model]` of a configuration: what is `None` has its default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReconstructionSettings {
    /// A trained model (safetensors or ONNX) in place of a method.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// Default: the one-step method.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub method: Option<Method>,
    /// Prior of the one-step method; default NOSER with exponent 0.25.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prior: Option<PriorName>,
    /// Exponent of the NOSER prior; default 0.5 where the prior is named, else 0.25.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exponent: Option<f64>,
    /// Correlation length of the Gaussian prior, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub length_mm: Option<f64>,
    /// Standard deviation of the noise of one reading, uV, in place of the baseline's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_uv: Option<f64>,
    /// Hyper-parameter of the one-step method.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lambda: Option<f64>,
    /// Noise figure that the one-step method's lambda is chosen for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_figure: Option<f64>,
    /// Share of a map's largest value by which a quicker frame may differ.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map_error: Option<f64>,
    /// Bounds the relative change to [-1, 0]; default false.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loss_only: Option<bool>,
    /// Total variation stops within this share of the minimum; default 1e-3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gap: Option<f64>,
    /// A calibration from maps to pressure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
}

impl ReconstructionSettings {
    /// Whether the method is set by the noise of the baseline: nothing else is named to set it by.
    pub fn takes_noise_of_baseline(&self) -> bool {
        self.file.is_none()
            && self.noise_uv.is_none()
            && self.lambda.is_none()
            && self.noise_figure.is_none()
    }

    /// The prior of the one-step method with its parameters.
    pub fn one_step_prior(&self) -> Prior {
        match self.prior.unwrap_or_default() {
            PriorName::Tikhonov => Prior::Tikhonov,
            PriorName::Noser => Prior::noser(self.prior.is_some(), self.exponent),
            PriorName::Laplace => Prior::Laplace,
            PriorName::Gaussian => Prior::Gaussian {
                length_m: self.length_mm.map_or(SMOOTH_LENGTH_M, |mm| 1e-3 * mm),
            },
        }
    }
}
