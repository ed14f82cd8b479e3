//! Which reconstructor a command line asks for, and what it is prepared with.

use std::sync::Arc;

use eit::{
    Case, Forward, Hyper, Jitter, OneStep, OneStepOptions, Prior, Reconstructor, Scale,
    TrainingSettings, model, probable_lambda,
};
use survey::Reading;

use crate::args::{Method, ReconstructOptions};
use crate::failure::Failure;
use crate::recording::Recording;
use crate::train;

/// A known conductance is believed, and the formula taken as it stands, while the baseline is within this factor of it.
const BELIEVED: f64 = 1.25;
/// What the model does not explain of a real recording is not white, as the most probable lambda takes it to be: it is
/// multiplied by this.
const NOT_WHITE: f64 = 2.0;
/// Maps of which more than this share (of their square, by area) is gain are not made of losses alone.
const GAIN: f64 = 0.2;
/// Frames that are looked at before lambda or bounds are decided.
const LOOKED_AT: usize = 32;

/// A reconstructor, and what a person should know about the choice.
pub(crate) struct Choice {
    pub(crate) reconstructor: Box<dyn Reconstructor>,
    pub(crate) notes: Vec<String>,
}

/// Prepares what the options ask for.
pub(crate) fn prepare(
    options: &ReconstructOptions,
    case: &Case,
    recording: &Recording,
) -> Result<Choice, Failure> {
    if let Some(path) = &options.model {
        only_for_one_step(options, "--model")?;
        let failed = |fault| Failure::of("cannot use the model", &fault);
        let model = model::load(path).map_err(failed)?;
        model.check(&case.protocol, &case.mesh).map_err(failed)?;
        return Ok(Choice {
            reconstructor: model.into_reconstructor(),
            notes: Vec::new(),
        });
    }
    positive(
        "--noise-v",
        options.noise_v,
        "the noise of one reading in volts, e.g. 2e-6",
    )?;
    positive(
        "--lambda",
        options.lambda,
        "as a first guess leave it out, and see what is chosen",
    )?;
    match options.method {
        Method::Best => best(options, case, recording),
        Method::OneStep => one_step(options, case, recording),
        Method::Rbf => {
            only_for_one_step(options, "--method rbf")?;
            let jitter = match options.noise_v {
                Some(noise_v) => Jitter::Matched {
                    noise_v,
                    current_a: train::current(case)?,
                },
                None => Jitter::paper(),
            };
            let settings = TrainingSettings {
                cases: options.cases,
                neurons: TrainingSettings::default().neurons.min(options.cases),
                jitter,
                ..TrainingSettings::default()
            };
            Ok(Choice {
                reconstructor: train::cached(case, settings)?.into_reconstructor(),
                notes: Vec::new(),
            })
        }
        Method::Tv | Method::Linear | Method::Dnn => {
            let name = match options.method {
                Method::Tv => "tv",
                Method::Linear => "linear",
                _ => "dnn",
            };
            Err(Failure::usage(format!(
                "--method {name} is not in this version; use best, one-step or rbf"
            )))
        }
    }
}

/// Refuses what is not a positive number.
pub(crate) fn positive(option: &str, value: Option<f64>, hint: &str) -> Result<(), Failure> {
    match value {
        Some(value) if !(value > 0.0 && value.is_finite()) => Err(Failure::usage(format!(
            "{option} {value}: a positive number is expected ({hint})"
        ))),
        _ => Ok(()),
    }
}

/// A trained network takes no prior, hyper-parameter, bound or conductance.
fn only_for_one_step(options: &ReconstructOptions, with: &str) -> Result<(), Failure> {
    let given = [
        ("--prior", options.prior.is_some()),
        ("--lambda", options.lambda.is_some()),
        ("--loss-only", options.loss_only),
        ("--sigma0", options.sigma0.is_some()),
    ];
    match given.iter().find(|(_, given)| *given) {
        Some((name, _)) => Err(Failure::usage(format!(
            "{name} belongs to the one-step method and has no meaning with {with}"
        ))),
        None => Ok(()),
    }
}

fn one_step(
    options: &ReconstructOptions,
    case: &Case,
    recording: &Recording,
) -> Result<Choice, Failure> {
    let prior = match &options.prior {
        Some(text) => prior(text)?,
        None => OneStepOptions::default().prior,
    };
    let start = Start::new(options, prior, case, recording)?;
    let mut notes = start.notes.clone();
    let one_step = start.one_step(prior, options.loss_only)?;
    notes.extend(raised(&one_step));
    notes.push(format!(
        "{}, lambda {:.3e}",
        one_step.method(),
        one_step.lambda()
    ));
    Ok(Choice {
        reconstructor: Box::new(one_step),
        notes,
    })
}

/// Of the methods there are: one step with NOSER p = 0.25, bounded to losses unless the frames themselves show gains.
/// The networks of the paper's size blur presses of 10 mm at any noise, so they are never the best.
fn best(
    options: &ReconstructOptions,
    case: &Case,
    recording: &Recording,
) -> Result<Choice, Failure> {
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
        let Ok(map) = linear.reconstruct(&recording.baseline, frame) else {
            continue; // the frame is refused again, by name, when its turn comes
        };
        for (value, area) in map.values.iter().zip(&areas) {
            gain += value.max(0.0).powi(2) * area;
            all += value * value * area;
        }
    }
    let share = if all > 0.0 { gain / all } else { 0.0 };
    let bounded = options.loss_only || share <= GAIN;
    let one_step = if bounded && prior != Prior::Laplace {
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
    Ok(Choice {
        reconstructor: Box::new(one_step),
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

/// What a one-step reconstruction of this recording starts from.
struct Start<'a> {
    case: &'a Case,
    sigma0: Vec<f64>,
    scale: Scale,
    hyper: Hyper,
    notes: Vec<String>,
}

impl<'a> Start<'a> {
    fn new(
        options: &ReconstructOptions,
        prior: Prior,
        case: &'a Case,
        recording: &Recording,
    ) -> Result<Self, Failure> {
        let mut notes = Vec::new();
        let failed = |fault| Failure::of("the forward model", &fault);
        let forward = Forward::new(Arc::clone(&case.mesh), &case.contact_ohm_m).map_err(failed)?;
        // baseline over model at the case's own currents, and over the model at 1 A
        let factors = |sigma: &[f64]| -> Result<(f64, f64), Failure> {
            let model = forward.readings(sigma, &case.protocol).map_err(failed)?;
            let at_current: Vec<f64> = model
                .iter()
                .zip(&case.currents)
                .map(|(volts, current)| volts * current)
                .collect();
            Ok((
                factor(&recording.baseline, &at_current)?,
                factor(&recording.baseline, model.as_slice())?,
            ))
        };
        let named = match &options.sigma0 {
            Some(name) => Some(
                case.sigma(name)
                    .map_err(|fault| Failure::of("cannot read --sigma0", &fault))?,
            ),
            None => case.sigma.get("homog").cloned(),
        };
        let (sigma0, believed) = match named {
            Some(sigma0) => {
                let (own, _) = factors(&sigma0)?;
                let believed = (BELIEVED.recip()..=BELIEVED).contains(&own);
                if !believed {
                    notes.push(format!(
                        "the baseline is {own:.3} times what the given conductance and currents say: scaled to it"
                    ));
                }
                (sigma0, believed)
            }
            None => {
                let mut uniform = vec![1.0; case.mesh.triangles().len()];
                // V(c sigma, z / c) = V / c, and z matters little: three rounds are more than enough
                for _ in 0..3 {
                    let (own, _) = factors(&uniform)?;
                    for sigma in &mut uniform {
                        *sigma /= own;
                    }
                }
                notes.push(format!(
                    "sigma0 is a uniform fit to the baseline: {:.4e} S per square",
                    uniform[0]
                ));
                (uniform, false)
            }
        };
        let scale = if believed {
            Scale::Currents(case.currents.clone())
        } else {
            Scale::ByDistance
        };
        let hyper = match (options.lambda, options.noise_v) {
            (Some(lambda), _) => Hyper::Lambda(lambda),
            (None, Some(volts)) => Hyper::Noise {
                volts,
                current: factors(&sigma0)?.1,
            },
            (None, None) => {
                let lambda = probable(case, &sigma0, prior, &scale, recording)?;
                notes.push(match lambda {
                    Some(_) => "no --noise-v: lambda is twice the one that makes the frames most probable",
                    None => "no --noise-v, and no frame that could tell it: lambda is for 2 uV at 1 mA",
                }
                .to_owned());
                lambda.map_or(OneStepOptions::default().hyper, |lambda| {
                    Hyper::Lambda(NOT_WHITE * lambda)
                })
            }
        };
        Ok(Self {
            case,
            sigma0,
            scale,
            hyper,
            notes,
        })
    }

    fn one_step(&self, prior: Prior, loss_only: bool) -> Result<OneStep, Failure> {
        OneStep::new(
            Arc::clone(&self.case.mesh),
            &self.case.contact_ohm_m,
            &self.sigma0,
            &self.case.protocol,
            OneStepOptions {
                prior,
                hyper: self.hyper,
                loss_only,
                scale: self.scale.clone(),
                deviations: None,
            },
        )
        .map_err(|fault| Failure::of("the one-step method", &fault))
    }
}

/// Baseline over model in the sense of least squares.
fn factor(baseline: &[Reading], model: &[f64]) -> Result<f64, Failure> {
    let (mut cross, mut square) = (0.0, 0.0);
    for (reading, model) in baseline.iter().zip(model) {
        if let Some(volts) = reading.volts() {
            cross += volts.0 * model;
            square += model * model;
        }
    }
    let factor = cross / square;
    if factor.is_finite() && factor > 0.0 {
        Ok(factor)
    } else {
        Err(Failure::because(
            "the baseline is zero, or its readings have the opposite sign of the case's: give --negate if the instrument \
             gives magnitudes",
        ))
    }
}

/// The lambda that the frames themselves make most probable.
fn probable(
    case: &Case,
    sigma0: &[f64],
    prior: Prior,
    scale: &Scale,
    recording: &Recording,
) -> Result<Option<f64>, Failure> {
    let step = recording.frames.len().div_ceil(LOOKED_AT).max(1);
    let frames: Vec<&[Reading]> = recording
        .frames
        .iter()
        .step_by(step)
        .map(|(_, frame)| frame.as_slice())
        .collect();
    let options = OneStepOptions {
        prior,
        scale: scale.clone(),
        ..OneStepOptions::default()
    };
    probable_lambda(
        &case.mesh,
        &case.contact_ohm_m,
        sigma0,
        &case.protocol,
        &options,
        &recording.baseline,
        &frames,
    )
    .map_err(|fault| Failure::of("the one-step method", &fault))
}

/// `tikhonov`, `noser`, `noser:P` or `laplace`.
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
        _ => Err(Failure::usage(format!(
            "--prior {text}: tikhonov, noser, noser:P or laplace is expected"
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
        for wrong in ["noser:x", "noser:-1", "laplace:2", "total variation"] {
            assert!(prior(wrong).is_err(), "{wrong}");
        }
    }
}
