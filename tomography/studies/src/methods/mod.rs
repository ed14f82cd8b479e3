//! A method chosen by options, and what it is prepared with. Left to others: the mathematics (`eit`), and training
//! (`training`).

mod options;
mod recording;
mod start;
mod total_variation;

use std::sync::Arc;

use eit::inverse::learned::network::{is_onnx, load_onnx};
use eit::{
    Case, Jitter, LossOnly, OneStep, OneStepOptions, Prior, Reconstructor, SMOOTH_LENGTH_M, Shapes,
    TrainingSettings, model,
};

use crate::failure::Failure;
use crate::progress;
use imaging::recorded::FrameTable;
pub use options::{Choose, Method, MethodOptions};
pub use recording::read_frames;
use start::Start;
use training::{Cached, linear, rbf, single_current};

/// Maps of which more than this share (of their square, by area) is gain are not made of losses alone.
const GAIN: f64 = 0.2;
/// Frames that are looked at before lambda or bounds are decided.
const LOOKED_AT: usize = 32;

/// A reconstructor, and what a person should know about the choice.
pub struct Choice {
    /// The method.
    pub reconstructor: Box<dyn Reconstructor>,
    /// What was decided, and what to know of it.
    pub notes: Vec<String>,
    /// Whether a frame takes so long that frames are better made side by side.
    pub slow: bool,
}

impl Choice {
    /// A quick method that has nothing to be said about it.
    fn quick(reconstructor: Box<dyn Reconstructor>) -> Self {
        Self {
            reconstructor,
            notes: Vec::new(),
            slow: false,
        }
    }

    /// A model that was trained for the case.
    fn cached(cached: Cached, loss_only: bool) -> Self {
        Self {
            notes: cached.notes,
            ..Self::trained(cached.model.into_reconstructor(), loss_only)
        }
    }

    /// A trained map, cut to losses where that is asked for.
    fn trained(reconstructor: Box<dyn Reconstructor>, loss_only: bool) -> Self {
        Self::quick(match loss_only {
            true => Box::new(LossOnly::new(reconstructor)),
            false => reconstructor,
        })
    }
}

/// Prepares what the options ask for.
///
/// # Errors
/// Options that contradict each other, a model that does not fit the case, or a method that cannot be prepared.
pub fn prepare(
    options: &MethodOptions,
    case: &Case,
    recording: &FrameTable,
) -> Result<Choice, Failure> {
    if let Some(path) = &options.model {
        only_for_one_step(options, "--model")?;
        if is_onnx(path) {
            let network = load_onnx(path, Arc::clone(&case.mesh), &case.protocol)
                .map_err(|fault| Failure::of("cannot use the model", &fault))?;
            return Ok(Choice {
                notes: network.assumptions(),
                ..Choice::trained(network, options.loss_only)
            });
        }
        let failed = |fault| Failure::of("cannot use the model", &fault);
        let model = model::load(path).map_err(failed)?;
        model.check(&case.protocol, &case.mesh).map_err(failed)?;
        return Ok(Choice::trained(
            model.into_reconstructor(),
            options.loss_only,
        ));
    }
    positive(
        "--noise-v",
        options.noise_v,
        "the noise of one reading in volts, e.g. 2e-6",
    )?;
    positive("--map-error", options.map_error, "a share, e.g. 1e-3")?;
    if options.method != Method::OneStep {
        for (name, given) in [
            ("--choose", options.choose.is_some()),
            ("--map-error", options.map_error.is_some()),
        ] {
            if given {
                return Err(Failure::usage(format!(
                    "{name} belongs to --method one-step"
                )));
            }
        }
    }
    positive(
        "--lambda",
        options.lambda,
        "as a first guess leave it out, and see what is chosen",
    )?;
    match options.method {
        Method::Best => best(options, case, recording),
        Method::OneStep => one_step(options, case, recording),
        Method::Tv => total_variation::prepare(options, case, recording),
        Method::TvPaper => total_variation::paper(options, case, recording),
        Method::Rbf => {
            only_for_one_step(options, "--method rbf")?;
            let jitter = match options.noise_v {
                Some(noise_v) => Jitter::Matched {
                    noise_v,
                    current_a: single_current(case)?,
                },
                None => Jitter::paper(),
            };
            let settings = TrainingSettings {
                cases: options.cases,
                neurons: TrainingSettings::default().neurons.min(options.cases),
                jitter,
                ..TrainingSettings::default()
            };
            let bars = progress::Training::default();
            let show = |stage, done, of| bars.show(stage, done, of);
            Ok(Choice::cached(
                rbf::cached(case, &settings, &show)?,
                options.loss_only,
            ))
        }
        Method::Linear => {
            only_for_one_step(options, "--method linear")?;
            let bars = progress::Training::default();
            let show = |stage, done, of| bars.show(stage, done, of);
            Ok(Choice::cached(
                linear::cached(case, options.noise_v, options.cases, &show)?,
                options.loss_only,
            ))
        }
        Method::Dnn => Err(Failure::usage(
            "--method dnn: train a network with tactus-lab train dnn --case DIR, and give its file with --model",
        )),
    }
}

/// Refuses what is not a positive number.
///
/// # Errors
/// The option with its value.
pub fn positive(option: &str, value: Option<f64>, hint: &str) -> Result<(), Failure> {
    match value {
        Some(value) if !(value > 0.0 && value.is_finite()) => Err(Failure::usage(format!(
            "{option} {value}: a positive number is expected ({hint})"
        ))),
        _ => Ok(()),
    }
}

/// A trained network takes no prior, hyper-parameter or conductance.
fn only_for_one_step(options: &MethodOptions, with: &str) -> Result<(), Failure> {
    let given = [
        ("--prior", options.prior.is_some()),
        ("--lambda", options.lambda.is_some()),
        ("--sigma0", options.sigma0.is_some()),
        ("--gap", options.gap.is_some()),
        ("--choose", options.choose.is_some()),
        ("--map-error", options.map_error.is_some()),
    ];
    match given.iter().find(|(_, given)| *given) {
        Some((name, _)) => Err(Failure::usage(format!(
            "{name} belongs to the model-based methods and has no meaning with {with}"
        ))),
        None => Ok(()),
    }
}

/// Only an iterative method stops at a gap.
fn no_gap(options: &MethodOptions) -> Result<(), Failure> {
    match options.gap {
        Some(_) => Err(Failure::usage(
            "--gap belongs to --method tv; the one-step method is exact".to_owned(),
        )),
        None => Ok(()),
    }
}

fn one_step(
    options: &MethodOptions,
    case: &Case,
    recording: &FrameTable,
) -> Result<Choice, Failure> {
    no_gap(options)?;
    let prior = match &options.prior {
        Some(text) => prior(text)?,
        None => OneStepOptions::default().prior,
    };
    let start = Start::new(options, prior, case, recording)?;
    let mut notes = start.notes.clone();
    let one_step = start.one_step(prior, options.loss_only)?;
    notes.extend(raised(&one_step));
    let figure = one_step.noise_figure();
    notes.push(format!(
        "{}, lambda {:.3e}{}",
        one_step.method(),
        one_step.lambda(),
        figure.map_or(String::new(), |figure| format!(
            ", noise figure {figure:.3}"
        ))
    ));
    if options.map_error.is_some() {
        notes.extend(one_step.assumptions().pop());
    }
    Ok(Choice {
        reconstructor: Box::new(one_step),
        notes,
        slow: false,
    })
}

/// Of the methods there are: one step with NOSER p = 0.25, bounded to losses unless the frames themselves show gains.
/// The networks of the paper's size blur presses of 10 mm at any noise, so they are never the best.
fn best(options: &MethodOptions, case: &Case, recording: &FrameTable) -> Result<Choice, Failure> {
    let prior = match &options.prior {
        Some(text) => prior(text)?,
        None => OneStepOptions::default().prior,
    };
    let start = Start::new(options, prior, case, recording)?;
    let mut notes = start.notes.clone();
    let linear = start.one_step(prior, false)?;
    let areas = case.mesh.region_areas();
    let (mut gain, mut all) = (0.0, 0.0);
    let step = recording.frames.len().div_ceil(LOOKED_AT).max(1);
    for (_, frame) in recording.frames.iter().step_by(step) {
        let Ok(map) = linear.reconstruct(&recording.unloaded.readings, frame) else {
            continue; // the frame is refused again, by name, when its turn comes
        };
        for (value, area) in map.values.iter().zip(&areas) {
            gain += value.max(0.0).powi(2) * area;
            all += value * value * area;
        }
    }
    let share = if all > 0.0 { gain / all } else { 0.0 };
    let bounded = options.loss_only || share <= GAIN;
    // bounded maps with the gaussian prior take minutes: only where they are asked for by name
    let one_step = if bounded && !matches!(prior, Prior::Gaussian { .. }) {
        start.one_step(prior, true)?
    } else {
        linear
    };
    notes.extend(raised(&one_step));
    notes.push(format!(
        "best: {}, lambda {:.3e}: {:.0} % of the unbounded maps is gain of conductance ({}); networks of 100 neurons \
         blur small loads at any noise",
        one_step.method(),
        one_step.lambda(),
        100.0 * share,
        if bounded { "taken for ringing of losses" } else { "too much to be ringing of losses" },
    ));
    let reconstructor: Box<dyn Reconstructor> = match options.noise_v {
        // what an explicit prior asks for is a linear method
        Some(noise_v) if options.prior.is_none() => {
            let shapes = Shapes::new(case, &start.sigma0, noise_v, Box::new(one_step))
                .map_err(|fault| Failure::of("shapes", &fault))?;
            notes.push(
                "best: with the noise known, a frame that one to four shapes explain to it is the mean over what they may be; \
                 the others get the map of the method above"
                    .to_owned(),
            );
            notes.extend(shapes.assumptions());
            Box::new(shapes)
        }
        _ => Box::new(one_step),
    };
    Ok(Choice {
        slow: reconstructor.method() == "shapes",
        reconstructor,
        notes,
    })
}

/// What there is to say where the noise is too small to be believed.
fn raised(one_step: &OneStep) -> Option<String> {
    one_step.raised().then(|| {
        format!(
            "--noise-v asks for more than a linear model can give: lambda is raised to {:.3e}, {:e} of the model's size",
            one_step.lambda(),
            eit::MODEL_SHARE
        )
    })
}

/// `tikhonov`, `noser`, `noser:P`, `laplace`, `gaussian` or `gaussian:MM`.
fn prior(text: &str) -> Result<Prior, Failure> {
    let (name, exponent) = text.split_once(':').unwrap_or((text, ""));
    match (name, exponent) {
        ("tikhonov", "") => Ok(Prior::Tikhonov),
        ("laplace", "") => Ok(Prior::Laplace),
        ("noser", "") => Ok(Prior::default()),
        ("noser", p) => match p.parse() {
            Ok(p) if (0.0..=2.0).contains(&p) => Ok(Prior::Noser { p }),
            _ => Err(Failure::usage(format!(
                "--prior {text}: the exponent of noser is a number from 0 to 2"
            ))),
        },
        ("gaussian", "") => Ok(Prior::Gaussian {
            length_m: SMOOTH_LENGTH_M,
        }),
        ("gaussian", mm) => match mm.parse::<f64>() {
            Ok(mm) if mm > 0.0 && mm.is_finite() => Ok(Prior::Gaussian {
                length_m: 1e-3 * mm,
            }),
            _ => Err(Failure::usage(format!(
                "--prior {text}: the length of gaussian is a number of millimetres above 0"
            ))),
        },
        _ => Err(Failure::usage(format!(
            "--prior {text}: tikhonov, noser, noser:P, laplace, gaussian or gaussian:MM is expected"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn priors_are_read_by_name() {
        assert_eq!(prior("noser").unwrap(), Prior::Noser { p: 0.5 });
        assert_eq!(prior("noser:0.25").unwrap(), Prior::Noser { p: 0.25 });
        assert_eq!(
            prior("gaussian:15").unwrap(),
            Prior::Gaussian { length_m: 0.015 }
        );
        for wrong in [
            "gaussian:0",
            "gaussian:x",
            "noser:x",
            "noser:-1",
            "laplace:2",
            "total variation",
        ] {
            assert!(prior(wrong).is_err(), "{wrong}");
        }
    }
}
