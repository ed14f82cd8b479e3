//! The options of a method, shared by all programs that have them on the command line.

use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;
use survey::Bounds;

use crate::settings::{
    DriftRule, HyperChoice, Ignored, Method, PriorName, ReconstructionSettings, Unknowns,
};

/// Exponent of the NOSER prior.
const EXPONENT: Bounds = Bounds::Within(0.0, 10.0);

/// How voltages become a map.
#[derive(Debug, Clone, Default, PartialEq, Args)]
#[command(next_help_heading = "Reconstruction")]
pub struct MethodArguments {
    /// Method [default: what the session used; best for a recording without a configuration]
    #[arg(long, value_enum, value_name = "METHOD", conflicts_with = "model")]
    pub method: Option<Method>,
    /// Trained model file in place of a method
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Prior of the one-step method: tikhonov, noser (p = 0.5), noser:P, laplace, gaussian (10 mm), gaussian:MM
    /// [default: what the session used, else noser:0.25]
    #[arg(long, value_name = "PRIOR", conflicts_with = "model")]
    pub prior: Option<PriorArgument>,
    /// Exponent of the NOSER prior, as in noser:P; a number from 0 to 10 [default: 0.5 with --prior noser, else 0.25]
    #[arg(long, value_name = "P", conflicts_with = "model", value_parser = EXPONENT.parser(), allow_hyphen_values = true)]
    pub exponent: Option<f64>,
    /// Standard deviation of the white noise of one reading, V: lower limit of a frame's errors, and the noise that the
    /// quality check of maps expects [default: what the session used, else measured from the baseline]
    #[arg(long, value_name = "SD", conflicts_with = "model", value_parser = above_zero, allow_hyphen_values = true)]
    pub noise_v: Option<f64>,
    /// Hyper-parameter: lambda of the one-step method, alpha of total variation (for readings in V, not normalised); a
    /// number above 0 [default: by --choose]
    #[arg(long, value_name = "X", conflicts_with = "model", value_parser = above_zero, allow_hyphen_values = true)]
    pub lambda: Option<f64>,
    /// How the hyper-parameter is chosen: evidence (the most probable one for each frame), l-curve (the corner of each
    /// frame's), noise (one for all frames, by --noise-v), noise-figure:X [default: what the session used, else
    /// evidence; with --map-error noise]
    #[arg(long, value_name = "RULE", conflicts_with_all = ["model", "lambda"])]
    pub choose: Option<ChooseArgument>,
    /// One-step: use a faster low-rank product for maps whose proved error is at most this share of their largest
    /// value, e.g. 1e-3 [default: what the session used, else exact]
    #[arg(long, value_name = "X", conflicts_with_all = ["model", "loss_only"], value_parser = share, allow_hyphen_values = true)]
    pub map_error: Option<f64>,
    /// Total variation: stop within this share of the minimum [default: what the session used, else 1e-3]
    #[arg(long, value_name = "X", conflicts_with = "model", value_parser = share, allow_hyphen_values = true)]
    pub gap: Option<f64>,
    /// Bound the map to losses, -1 <= x <= 0: one-step and tv find the best map within the bounds, maps of a model are
    /// clipped
    #[arg(long)]
    pub loss_only: bool,
    /// One-step, tv and best: which conductances are unknown [default: what the session used, else sheet]
    #[arg(long, value_enum, value_name = "WHICH", conflicts_with = "model")]
    pub unknowns: Option<Unknowns>,
    /// Treatment of drift since the baseline, if the baseline is not tracked (see --tracked) [default: what the session
    /// used, else off]
    #[arg(long, value_enum, value_name = "RULE")]
    pub drift: Option<DriftRule>,
}

/// Whether and how a recording's baseline is followed.
#[derive(Debug, Clone, Default, PartialEq, Args)]
#[command(next_help_heading = "Reconstruction")]
pub struct TrackedArguments {
    /// Track the drift of the baseline through all frames, and report for each frame whether its map can be relied
    /// on; --tracked=off: use the baseline as recorded [default: as in the session; off for a recording without a
    /// configuration]
    #[arg(long, value_name = "on|off", num_args = 0..=1, require_equals = true, default_missing_value = "on", value_parser = on_or_off)]
    pub tracked: Option<bool>,
    /// With --tracked, for frames without times: time from one frame to the next, s
    #[arg(long, value_name = "S", value_parser = above_zero, allow_hyphen_values = true)]
    pub period_s: Option<f64>,
}

impl TrackedArguments {
    /// The time from one frame to the next, s; `None` if the frames have times. `follows`: whether the baseline is
    /// tracked.
    ///
    /// # Errors
    /// Tracking of frames without times needs a period; a period is refused without tracking, or if the frames have
    /// times.
    pub fn period_s(&self, follows: bool, have_times: bool) -> Result<Option<f64>, String> {
        let refused = match (follows, have_times, self.period_s) {
            (false, _, Some(_)) => "--period-s belongs to --tracked",
            (true, true, Some(_)) => "the frames have their own times; omit --period-s",
            (true, false, None) => {
                "--tracked needs the time of each frame, and these have none; give --period-s S"
            }
            (_, _, period_s) => return Ok(period_s),
        };
        Err(refused.to_owned())
    }

    /// The standard deviation of one reading, V, for a tracked baseline.
    ///
    /// # Errors
    /// The noise is not known.
    pub fn noise_v(known: Option<f64>) -> Result<f64, String> {
        known.ok_or_else(|| {
            "--tracked needs the noise of a reading, which this baseline does not show; give --noise-v SD".to_owned()
        })
    }
}

fn on_or_off(text: &str) -> Result<bool, String> {
    match text {
        "on" => Ok(true),
        "off" => Ok(false),
        _ => Err("on or off is expected".to_owned()),
    }
}

/// A prior with its parameter: `noser:0.25`, `gaussian:15`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorArgument {
    name: PriorName,
    /// Exponent of NOSER.
    exponent: Option<f64>,
    /// Length of the Gaussian prior, mm.
    length_mm: Option<f64>,
}

impl FromStr for PriorArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, parameter) = match text.split_once(':') {
            Some((name, parameter)) => (name, Some(parameter)),
            None => (text, None),
        };
        let named = |name| Self {
            name,
            exponent: None,
            length_mm: None,
        };
        match (name, parameter) {
            ("tikhonov", None) => Ok(named(PriorName::Tikhonov)),
            ("laplace", None) => Ok(named(PriorName::Laplace)),
            ("noser", None) => Ok(named(PriorName::Noser)),
            ("gaussian", None) => Ok(named(PriorName::Gaussian)),
            ("noser", Some(p)) => Ok(Self {
                exponent: Some(
                    EXPONENT
                        .parse(p)
                        .map_err(|why| format!("the exponent of noser: {why}"))?,
                ),
                ..named(PriorName::Noser)
            }),
            ("gaussian", Some(mm)) => {
                let length = above_zero(mm).map_err(|_| {
                    "the length of gaussian is a number of millimetres above 0".to_owned()
                })?;
                Ok(Self {
                    length_mm: Some(length),
                    ..named(PriorName::Gaussian)
                })
            }
            _ => Err(format!(
                "'{text}': tikhonov, noser, noser:P, laplace, gaussian or gaussian:MM is expected"
            )),
        }
    }
}

/// How the hyper-parameter is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ChooseArgument {
    /// By this rule.
    Rule(HyperChoice),
    /// The value with this noise figure.
    NoiseFigure(f64),
}

impl FromStr for ChooseArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let figure = text.strip_prefix("noise-figure:").map(above_zero);
        match (text, figure) {
            ("evidence", _) => Ok(Self::Rule(HyperChoice::Evidence)),
            ("l-curve", _) => Ok(Self::Rule(HyperChoice::LCurve)),
            ("noise", _) => Ok(Self::Rule(HyperChoice::Noise)),
            (_, Some(Ok(figure))) => Ok(Self::NoiseFigure(figure)),
            _ => Err(
                "evidence, l-curve, noise or noise-figure:X with a number above 0 is expected"
                    .to_owned(),
            ),
        }
    }
}

impl MethodArguments {
    /// The settings given by the options, without defaults.
    ///
    /// # Errors
    /// An exponent that is given twice, or with a prior other than NOSER.
    pub fn settings(&self) -> Result<ReconstructionSettings, String> {
        let prior = self.prior;
        if let (Some(_), Some(prior)) = (self.exponent, prior)
            && (prior.exponent.is_some() || prior.name != PriorName::Noser)
        {
            return Err("--exponent belongs to --prior noser; write it once".to_owned());
        }
        let (rule, figure) = match self.choose {
            Some(ChooseArgument::Rule(rule)) => (Some(rule), None),
            Some(ChooseArgument::NoiseFigure(figure)) => (None, Some(figure)),
            None => (None, None),
        };
        Ok(ReconstructionSettings {
            file: self.model.clone(),
            method: self.method,
            prior: prior.map(|prior| prior.name),
            exponent: self.exponent.or(prior.and_then(|prior| prior.exponent)),
            length_mm: prior.and_then(|prior| prior.length_mm),
            noise_uv: self.noise_v.map(|volts| volts * 1e6),
            lambda: self.lambda,
            noise_figure: figure,
            choose: rule,
            map_error: self.map_error,
            loss_only: self.loss_only.then_some(true),
            gap: self.gap,
            unknowns: self.unknowns,
            map_every: None,
            tracking: None,
            drift: self.drift,
            calibration: None,
        })
    }

    /// Refuses options that the method does not use.
    ///
    /// # Errors
    /// An error naming the first such option; an option without effect is a mistake.
    pub fn check(requested: &ReconstructionSettings, method: Method) -> Result<(), String> {
        let settings = ReconstructionSettings {
            method: Some(method),
            ..requested.clone()
        };
        match settings.ignored().first() {
            None => Ok(()),
            Some(Ignored { key, by, used_by }) => Err(format!(
                "--{} belongs to --{by} {}; it does not apply to {}",
                option(key),
                used_by.join(", "),
                match *by {
                    "prior" => settings.prior.unwrap_or_default().name(),
                    _ => method.name(),
                }
            )),
        }
    }
}

/// The command-line option for a configuration key.
fn option(key: &str) -> String {
    match key {
        "noise_uv" => "noise-v".to_owned(),
        "noise_figure" => "choose".to_owned(),
        "length_mm" => "prior".to_owned(),
        other => other.replace('_', "-"),
    }
}

fn above_zero(text: &str) -> Result<f64, String> {
    Bounds::Above(0.0, 1e30)
        .parse(text)
        .map_err(|refusal| format!("{refusal}, for example 2e-6"))
}

fn share(text: &str) -> Result<f64, String> {
    Bounds::Between(0.0, 1.0)
        .parse(text)
        .map_err(|refusal| format!("{refusal}, for example 1e-3"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use eit::Prior;

    #[test]
    fn priors_are_read_by_name() {
        let prior = |text: &str| {
            let arguments = MethodArguments {
                prior: Some(text.parse().unwrap()),
                ..MethodArguments::default()
            };
            arguments.settings().unwrap().one_step_prior()
        };
        assert_eq!(prior("noser"), Prior::Noser { p: 0.5 });
        assert_eq!(prior("noser:0.25"), Prior::Noser { p: 0.25 });
        assert_eq!(prior("gaussian:15"), Prior::Gaussian { length_m: 0.015 });
        for wrong in [
            "gaussian:0",
            "gaussian:x",
            "noser:x",
            "noser:-1",
            "laplace:2",
            "total variation",
        ] {
            assert!(wrong.parse::<PriorArgument>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn an_option_that_the_method_ignores_is_refused() {
        let requested = ReconstructionSettings {
            noise_uv: Some(1.0),
            ..ReconstructionSettings::default()
        };
        let refused = MethodArguments::check(&requested, Method::TvPaper).unwrap_err();
        assert!(refused.starts_with("--noise-v belongs to"), "{refused}");
        assert_eq!(MethodArguments::check(&requested, Method::Tv), Ok(()));
    }
}
