//! What a model-based reconstruction of a recording starts from: conductance, scale, and what is known of the noise.

use std::sync::Arc;

use eit::{
    Case, Forward, Hyper, Mesh, OneStep, OneStepError, OneStepOptions, Prior, Scale,
    l_curve_lambda, probable_lambda,
};
use survey::{Protocol, Reading};

use super::LOOKED_AT;
use super::options::{Choose, MethodOptions};
use crate::failure::Failure;
use imaging::recorded::FrameTable;

/// A known conductance is believed, and the formula taken as it stands, while the baseline is within this factor of it.
const BELIEVED: f64 = 1.25;
/// What the model does not explain of a real recording is not white, as the most probable lambda takes it to be: it is
/// multiplied by this.
const NOT_WHITE: f64 = 2.0;

/// What a one-step reconstruction of this recording starts from.
pub(super) struct Start<'a> {
    pub(super) case: &'a Case,
    pub(super) sigma0: Vec<f64>,
    pub(super) scale: Scale,
    pub(super) hyper: Hyper,
    pub(super) notes: Vec<String>,
    map_error: Option<f64>,
}

impl<'a> Start<'a> {
    pub(super) fn new(
        options: &MethodOptions,
        prior: Prior,
        case: &'a Case,
        recording: &FrameTable,
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
                factor(&recording.unloaded.readings, &at_current)?,
                factor(&recording.unloaded.readings, model.as_slice())?,
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
                let by = options.choose.unwrap_or(Choose::Evidence);
                let (lambda, told) = match by {
                    Choose::NoiseFigure(figure) => (
                        Some(Hyper::NoiseFigure(figure)),
                        "lambda is the one with the noise figure asked for",
                    ),
                    Choose::Evidence => (
                        from_frames(probable_lambda, case, &sigma0, prior, &scale, recording)?
                            .map(|lambda| Hyper::Lambda(NOT_WHITE * lambda)),
                        "no --noise-v: lambda is twice the one that makes the frames most probable",
                    ),
                    Choose::LCurve => (
                        from_frames(l_curve_lambda, case, &sigma0, prior, &scale, recording)?
                            .map(Hyper::Lambda),
                        "lambda is at the corner of the frames' L-curve",
                    ),
                };
                notes.push(match lambda {
                    Some(_) => told,
                    None => "no --noise-v, and no frame that could tell it: lambda is for 2 uV at 1 mA",
                }
                .to_owned());
                lambda.unwrap_or(OneStepOptions::default().hyper)
            }
        };
        Ok(Self {
            case,
            sigma0,
            scale,
            hyper,
            notes,
            map_error: options.map_error,
        })
    }

    pub(super) fn one_step(&self, prior: Prior, loss_only: bool) -> Result<OneStep, Failure> {
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
                map_error: self.map_error,
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

/// A rule that finds lambda from frames.
type Rule = fn(
    &Arc<Mesh>,
    &[f64],
    &[f64],
    &Protocol,
    &OneStepOptions,
    &[Reading],
    &[&[Reading]],
) -> Result<Option<f64>, OneStepError>;

/// The lambda that the frames themselves say.
fn from_frames(
    rule: Rule,
    case: &Case,
    sigma0: &[f64],
    prior: Prior,
    scale: &Scale,
    recording: &FrameTable,
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
    rule(
        &case.mesh,
        &case.contact_ohm_m,
        sigma0,
        &case.protocol,
        &options,
        &recording.unloaded.readings,
        &frames,
    )
    .map_err(|fault| Failure::of("the one-step method", &fault))
}
