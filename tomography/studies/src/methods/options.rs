//! The options of a method, as a command line and the words of a study give them.

use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args, Parser, ValueEnum};

use crate::failure::Failure;

/// How maps are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// The best of the methods there are for the given noise; says what it chose and why
    Best,
    /// One-step difference reconstruction
    OneStep,
    /// Total variation, to a stated gap
    Tv,
    /// The paper's Eq. 4 and 5 as printed: one linear, quadratic step, alpha 1e-6 (--lambda: another)
    TvPaper,
    /// Trained linear map, on the case's own mesh
    Linear,
    /// Radial-basis-function network
    Rbf,
    /// Deep network: trained beforehand, and given by --model
    Dnn,
}

/// How lambda is chosen where nobody says the noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Choose {
    /// The one that makes the frames most probable, doubled.
    Evidence,
    /// At the corner of the frames' L-curve.
    LCurve,
    /// The one with this noise figure.
    NoiseFigure(f64),
}

impl FromStr for Choose {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let figure = text.strip_prefix("noise-figure:");
        match (text, figure.map(str::parse::<f64>)) {
            ("evidence", _) => Ok(Self::Evidence),
            ("l-curve", _) => Ok(Self::LCurve),
            (_, Some(Ok(figure))) if figure > 0.0 && figure.is_finite() => {
                Ok(Self::NoiseFigure(figure))
            }
            _ => Err(
                "evidence, l-curve or noise-figure:X with a number above 0 is expected".to_owned(),
            ),
        }
    }
}

/// A method and what it is told.
#[derive(Debug, Clone, Args)]
pub struct MethodOptions {
    /// Method
    #[arg(long, value_enum, default_value_t = Method::Best, conflicts_with = "model")]
    pub method: Method,
    /// Model file in place of a method
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Prior of the one-step method: tikhonov, noser (p = 0.5), noser:P, laplace, gaussian (10 mm), gaussian:MM
    /// [default: noser:0.25]
    #[arg(long, value_name = "P")]
    pub prior: Option<String>,
    /// White noise of one reading, V
    #[arg(long, value_name = "SD", conflicts_with = "lambda")]
    pub noise_v: Option<f64>,
    /// Hyper-parameter: lambda of the one-step method, alpha of total variation (readings as they are, V)
    #[arg(long, value_name = "X")]
    pub lambda: Option<f64>,
    /// How the one-step method's lambda is chosen where neither --noise-v nor --lambda is given: evidence (the most probable
    /// one for the frames, doubled), l-curve (the corner of the frames' own), noise-figure:X [default: evidence]
    #[arg(long, value_name = "RULE", conflicts_with_all = ["lambda", "noise_v"])]
    pub choose: Option<Choose>,
    /// One-step: make frames quicker where a map is proved to be within this share of its largest value, e.g. 1e-3
    #[arg(long, value_name = "X", conflicts_with = "loss_only")]
    pub map_error: Option<f64>,
    /// Total variation: stop within this share of the minimum [default: 1e-3]
    #[arg(long, value_name = "X")]
    pub gap: Option<f64>,
    /// Bound the map to losses, -1 <= x <= 0: one-step and tv find the best map within the bounds, maps of trained networks and
    /// of the linear matrix are cut
    #[arg(long)]
    pub loss_only: bool,
    /// Unloaded conductance: a name in the case or a file [default: homog if there is one, else fitted to the baseline]
    #[arg(long, value_name = "NAME|FILE")]
    pub sigma0: Option<String>,
    /// Simulated cases where a network is trained for the case
    #[arg(long, value_name = "N", default_value_t = 15_000)]
    pub cases: usize,
}

/// The options alone, without a program's name before them.
#[derive(Debug, Parser)]
#[command(no_binary_name = true, name = "reconstruct")]
struct Words {
    #[command(flatten)]
    options: MethodOptions,
}

impl MethodOptions {
    /// From words such as `--method tv --loss-only`; `name` is what a refusal calls the method.
    ///
    /// # Errors
    /// Words that are no options of a method.
    pub fn parse(name: &str, words: &[String]) -> Result<Self, Failure> {
        Words::try_parse_from(words)
            .map(|words| words.options)
            .map_err(|fault| Failure::usage(format!("method '{name}': {fault}")))
    }
}
