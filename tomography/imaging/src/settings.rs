//! Settings of the reconstruction, as in a configuration: the methods and their parameters.

use std::path::PathBuf;

use eit::{HyperRule, Prior, SMOOTH_LENGTH_M};
use serde::{Deserialize, Serialize};

/// How voltages become a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "arguments", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// One-step difference reconstruction
    #[default]
    OneStep,
    /// Shapes, a smooth load or total variation, by the full forward model; the map states which, and why
    Best,
    /// Total variation, to a stated gap
    Tv,
    /// The paper's Eq. 4 and 5 as printed: one linear, quadratic step, alpha 1e-6 unless lambda is given
    TvPaper,
    /// Trained linear map: a model file; tactus-lab reconstruct trains one for the case
    Linear,
    /// Radial-basis-function network: a model file; tactus-lab reconstruct trains one for the case
    Rbf,
    /// Deep network: a model file, trained beforehand
    Dnn,
}

impl Method {
    /// Its name in a configuration and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::OneStep => "one-step",
            Self::Best => "best",
            Self::Tv => "tv",
            Self::TvPaper => "tv-paper",
            Self::Linear => "linear",
            Self::Rbf => "rbf",
            Self::Dnn => "dnn",
        }
    }
}

/// Prior of the one-step method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PriorName {
    /// Small changes.
    Tikhonov,
    /// Small changes, weighed by sensitivity.
    #[default]
    Noser,
    /// Smooth changes.
    Laplace,
    /// Smooth changes of a stated correlation length: 10 mm unless another is given.
    Gaussian,
}

impl PriorName {
    /// Its name in a configuration and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tikhonov => "tikhonov",
            Self::Noser => "noser",
            Self::Laplace => "laplace",
            Self::Gaussian => "gaussian",
        }
    }
}

/// How the hyper-parameter is chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HyperChoice {
    /// For each frame the most probable one; the noise is a lower limit of the frame's errors.
    Evidence,
    /// For each frame the one at the corner of its L-curve.
    LCurve,
    /// One for all frames, from the noise alone.
    Noise,
}

impl HyperChoice {
    /// The rule that chooses for each frame; `None` if one value serves all frames.
    fn of_frames(self) -> Option<HyperRule> {
        match self {
            Self::Evidence => Some(HyperRule::Evidence),
            Self::LCurve => Some(HyperRule::LCurve),
            Self::Noise => None,
        }
    }
}

/// Which conductances a method solves for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "arguments", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Unknowns {
    /// Those of the whole sheet: a load outside of the region is not mapped into it
    Sheet,
    /// Those of the region; the sheet outside of it is taken to be as it was at the baseline
    Region,
}

/// A given key without effect.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ignored {
    /// The key.
    pub key: &'static str,
    /// The key that decides whether it has one: `method` or `prior`.
    pub by: &'static str,
    /// The values of `by` with which it has one.
    pub used_by: Vec<&'static str>,
}

/// What is done about the drift of the sheet since the baseline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "arguments", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum DriftRule {
    /// Frames are compared with the baseline as it is
    #[default]
    Off,
    /// Drift of gain, contacts and smooth fields is estimated in each frame and removed
    Frame,
}

/// The section `[model]` of a configuration; a key that is `None` has its default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReconstructionSettings {
    /// A trained model (safetensors or ONNX) in place of a method.
    pub file: Option<PathBuf>,
    /// Default: the one-step method.
    pub method: Option<Method>,
    /// Prior of the one-step method; default NOSER with exponent 0.25.
    pub prior: Option<PriorName>,
    /// Exponent of the NOSER prior; default 0.5 if the prior is named, otherwise 0.25.
    pub exponent: Option<f64>,
    /// Correlation length of the Gaussian prior, mm.
    pub length_mm: Option<f64>,
    /// Standard deviation of the noise of one reading, uV, in place of the baseline's. It is the lower limit of a
    /// frame's errors and the noise that the quality check of maps expects.
    pub noise_uv: Option<f64>,
    /// Hyper-parameter: lambda of the one-step method, alpha of total variation.
    pub lambda: Option<f64>,
    /// Noise figure for which lambda of the one-step method is chosen.
    pub noise_figure: Option<f64>,
    /// How the hyper-parameter is chosen; default: by evidence, or by the noise if `map_error` is given.
    pub choose: Option<HyperChoice>,
    /// Faster one-step maps: largest error allowed, as a share of a map's largest value; default exact.
    pub map_error: Option<f64>,
    /// Bounds the relative change to [-1, 0]; default false.
    pub loss_only: Option<bool>,
    /// Total variation stops within this share of the minimum; default 1e-3.
    pub gap: Option<f64>,
    /// Which conductances are solved for; default the whole sheet.
    pub unknowns: Option<Unknowns>,
    /// A running rig makes a map of every n-th frame; default 1, all frames.
    pub map_every: Option<u64>,
    /// Tracks the baseline through the frames, so that maps remain valid while the sheet drifts; default: on for the
    /// preset sheet on a rig, otherwise off.
    pub tracking: Option<bool>,
    /// Treatment of drift if the baseline is not tracked; default off.
    pub drift: Option<DriftRule>,
    /// File of the calibration from maps to pressure.
    pub calibration: Option<PathBuf>,
}

/// The prior that each of its parameters belongs to.
const OF_PRIOR: [(&str, PriorName); 2] = [
    ("exponent", PriorName::Noser),
    ("length_mm", PriorName::Gaussian),
];

/// The methods that use each setting.
const USED_BY: [(&str, &[Method]); 11] = {
    use Method::{Best, Linear, OneStep, Rbf, Tv, TvPaper};
    [
        ("prior", &[OneStep, Best]),
        ("exponent", &[OneStep, Best]),
        ("length_mm", &[OneStep, Best]),
        ("noise_uv", &[OneStep, Best, Tv, Linear, Rbf]),
        ("lambda", &[OneStep, Best, Tv, TvPaper]),
        ("noise_figure", &[OneStep, Best]),
        ("choose", &[OneStep, Best, Tv]),
        ("map_error", &[OneStep]),
        ("gap", &[Tv]),
        ("loss_only", &[OneStep, Best, Tv, Linear, Rbf]),
        ("unknowns", &[OneStep, Best, Tv]),
    ]
};

impl ReconstructionSettings {
    /// Whether the noise is measured from the baseline: the settings give none, and the method needs it.
    pub fn takes_noise_of_baseline(&self) -> bool {
        self.file.is_none()
            && self.noise_uv.is_none()
            && self.lambda.is_none()
            && self.noise_figure.is_none()
            && is_used("noise_uv", self.method.unwrap_or_default())
    }

    /// Whether a map takes only a few milliseconds: a model file, or one-step without bounds.
    pub fn is_quick(&self) -> bool {
        let one_step = self.method.unwrap_or_default() == Method::OneStep;
        self.file.is_some() || one_step && self.loss_only != Some(true)
    }

    /// The rule that chooses the regularisation strength for each frame; `None` if one strength serves all frames.
    pub(crate) fn frame_rule(&self) -> Option<HyperRule> {
        if self.lambda.is_some() || self.noise_figure.is_some() {
            return None;
        }
        // an error relative to a map's largest value can be proved only if the method is one matrix for all frames
        let usual = match self.map_error {
            Some(_) => HyperChoice::Noise,
            None => HyperChoice::Evidence,
        };
        self.choose.unwrap_or(usual).of_frames()
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

    /// Defaults for a recording without a configuration: the best method.
    pub fn for_recording(mut self) -> Self {
        self.method.get_or_insert(Method::Best);
        self
    }

    /// These settings, completed by those stored in a session. A prior, an exponent or a lambda selects the one-step
    /// method, whatever method the session used. The session's prior and hyper-parameter are used only with the
    /// session's method, its prior also only without another exponent, which belongs to NOSER.
    pub fn over(self, kept: Self) -> Self {
        let one_step = self.prior.is_some() || self.exponent.is_some() || self.lambda.is_some();
        let method = self.method.or(kept.method.filter(|_| !one_step));
        let strength =
            self.lambda.is_some() || self.noise_figure.is_some() || self.choose.is_some();
        let other = method.unwrap_or_default() != kept.method.unwrap_or_default();
        let same_prior = self.prior.is_none() && self.exponent.is_none() && !other;
        Self {
            file: self.file,
            method,
            prior: self.prior.or(kept.prior.filter(|_| same_prior)),
            exponent: self.exponent.or(kept.exponent.filter(|_| same_prior)),
            length_mm: self.length_mm.or(kept.length_mm.filter(|_| same_prior)),
            noise_uv: self.noise_uv.or(kept.noise_uv),
            lambda: self.lambda.or(kept.lambda.filter(|_| !strength && !other)),
            noise_figure: self
                .noise_figure
                .or(kept.noise_figure.filter(|_| !strength && !other)),
            choose: self.choose.or(kept.choose.filter(|_| !strength && !other)),
            map_error: self.map_error.or(kept.map_error.filter(|_| !other)),
            loss_only: self.loss_only.or(kept.loss_only),
            gap: self.gap.or(kept.gap),
            unknowns: self.unknowns.or(kept.unknowns),
            map_every: kept.map_every,
            tracking: self.tracking.or(kept.tracking),
            drift: self.drift.or(kept.drift),
            calibration: self.calibration,
        }
    }

    /// Whether a running rig makes a map of the frame with this number: the first, and every `map_every`-th after it.
    pub fn has_map(&self, sequence: u64) -> bool {
        sequence
            .saturating_sub(1)
            .is_multiple_of(self.map_every.unwrap_or(1).max(1))
    }

    /// The keys of the method that are given.
    pub fn given(&self) -> Vec<&'static str> {
        [
            ("method", self.method.is_some()),
            ("prior", self.prior.is_some()),
            ("exponent", self.exponent.is_some()),
            ("length_mm", self.length_mm.is_some()),
            ("noise_figure", self.noise_figure.is_some()),
            ("map_error", self.map_error.is_some()),
            ("noise_uv", self.noise_uv.is_some()),
            ("lambda", self.lambda.is_some()),
            ("choose", self.choose.is_some()),
            ("gap", self.gap.is_some()),
            ("loss_only", self.loss_only == Some(true)),
            ("unknowns", self.unknowns.is_some()),
        ]
        .into_iter()
        .filter_map(|(key, given)| given.then_some(key))
        .collect()
    }

    /// The given keys that the method does not use, and the parameters of other priors than the one in use.
    pub fn ignored(&self) -> Vec<Ignored> {
        let method = self.method.unwrap_or_default();
        let prior = self.prior.unwrap_or_default();
        let given = self.given();
        let by_method = USED_BY
            .iter()
            .filter(|(key, _)| given.contains(key) && !is_used(key, method))
            .map(|(key, methods)| Ignored {
                key,
                by: "method",
                used_by: methods.iter().map(|method| method.name()).collect(),
            });
        let by_prior = OF_PRIOR
            .iter()
            .filter(|(key, of)| given.contains(key) && is_used(key, method) && prior != *of)
            .map(|(key, of)| Ignored {
                key,
                by: "prior",
                used_by: vec![of.name()],
            });
        by_method.chain(by_prior).collect()
    }
}

fn is_used(key: &str, method: Method) -> bool {
    USED_BY
        .iter()
        .any(|(known, methods)| *known == key && methods.contains(&method))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_a_method_ignores_are_named_with_their_owners() {
        let settings = ReconstructionSettings {
            method: Some(Method::TvPaper),
            noise_uv: Some(2.0),
            lambda: Some(1e-6),
            gap: Some(1e-3),
            ..ReconstructionSettings::default()
        };
        let ignored = settings.ignored();
        assert_eq!(ignored[0].key, "noise_uv");
        assert_eq!((ignored[1].key, ignored[1].by), ("gap", "method"));
        assert_eq!(ignored[1].used_by, ["tv"]);
        assert_eq!(ignored.len(), 2);
    }

    #[test]
    fn parameters_of_another_prior_are_named_with_theirs() {
        let ignored = |method, prior, [exponent, length_mm]: [Option<f64>; 2]| {
            let settings = ReconstructionSettings {
                method,
                prior,
                exponent,
                length_mm,
                ..ReconstructionSettings::default()
            };
            let ignored = settings.ignored().into_iter();
            ignored
                .map(|ignored| (ignored.key, ignored.by, ignored.used_by.join(" ")))
                .collect::<Vec<_>>()
        };
        let exponent = [Some(0.3), None];
        let length = [None, Some(15.0)];
        let of_noser = [("exponent", "prior", "noser".to_owned())];
        let of_gaussian = [("length_mm", "prior", "gaussian".to_owned())];
        for other in [PriorName::Tikhonov, PriorName::Laplace, PriorName::Gaussian] {
            assert_eq!(ignored(None, Some(other), exponent), of_noser);
        }
        for prior in [None, Some(PriorName::Noser)] {
            assert_eq!(ignored(None, prior, exponent), []);
            assert_eq!(ignored(Some(Method::Best), prior, length), of_gaussian);
        }
        assert_eq!(ignored(None, Some(PriorName::Gaussian), length), []);
        // a method without a prior is the first thing to change
        let tv = ignored(Some(Method::Tv), None, length);
        let of_methods = ("length_mm", "method", "one-step best".to_owned());
        assert_eq!(tv, [of_methods]);
    }

    #[test]
    fn an_exponent_replaces_a_kept_prior_and_its_length() {
        let kept = ReconstructionSettings {
            prior: Some(PriorName::Gaussian),
            length_mm: Some(15.0),
            ..ReconstructionSettings::default()
        };
        let requested = ReconstructionSettings {
            exponent: Some(0.3),
            ..ReconstructionSettings::default()
        };
        let settings = requested.over(kept);
        assert_eq!(settings.one_step_prior(), Prior::Noser { p: 0.3 });
        assert_eq!(settings.ignored(), []);
    }

    #[test]
    fn every_third_frame_has_a_map_from_the_first_on() {
        let settings = ReconstructionSettings {
            map_every: Some(3),
            ..ReconstructionSettings::default()
        };
        let with_map: Vec<u64> = (1..10).filter(|n| settings.has_map(*n)).collect();
        assert_eq!(with_map, [1, 4, 7]);
        assert!((1..10).all(|n| ReconstructionSettings::default().has_map(n)));
    }

    #[test]
    fn kept_prior_and_lambda_are_not_of_another_method() {
        let kept = ReconstructionSettings {
            lambda: Some(1e-3),
            prior: Some(PriorName::Gaussian),
            length_mm: Some(15.0),
            map_error: Some(1e-3),
            loss_only: Some(true),
            ..ReconstructionSettings::default()
        };
        let requested = |method| ReconstructionSettings {
            method,
            ..ReconstructionSettings::default()
        };
        let same = requested(None).over(kept.clone());
        assert_eq!((same.lambda, same.loss_only), (Some(1e-3), Some(true)));
        assert_eq!((same.prior, same.length_mm), (kept.prior, Some(15.0)));
        // the stored settings of the method, such as the prior, are ignored: `best` with a prior would be the one-step
        // method
        for method in [Method::Best, Method::Tv] {
            let other = ReconstructionSettings {
                loss_only: Some(true),
                ..requested(Some(method))
            };
            assert_eq!(requested(Some(method)).over(kept.clone()), other);
        }
    }
}
