//! Total variation as a command line asks for it.

use std::sync::Arc;

use eit::{
    Case, Hyper, OneStep, OneStepOptions, Prior, Reconstructor, Scale, Strength, Tv, TvOptions,
};

use super::options::MethodOptions;
use super::start::Start;
use super::{Choice, positive};
use crate::failure::Failure;
use imaging::recorded::FrameTable;

/// The paper's alpha, and its one iteration.
const PAPER_ALPHA: f64 = 1e-6;

/// `--lambda` is alpha of the formula with readings as they are; else alpha follows from the noise, and where nobody
/// says that either, from the frames themselves as the one-step method's lambda does.
pub(super) fn prepare(
    options: &MethodOptions,
    case: &Case,
    recording: &FrameTable,
) -> Result<Choice, Failure> {
    positive("--gap", options.gap, "a share of the objective, e.g. 1e-3")?;
    if options.prior.is_some() {
        return Err(Failure::usage(
            "--prior belongs to the one-step method; total variation is a prior of its own"
                .to_owned(),
        ));
    }
    let prior = OneStepOptions::default().prior;
    let start = Start::new(options, prior, case, recording)?;
    let mut notes = start.notes.clone();
    let (noise_v, current_a) = match start.hyper {
        Hyper::Noise { volts, current } => (volts, current),
        Hyper::Lambda(_) if options.lambda.is_none() => {
            let unit = match start.scale {
                Scale::Currents(_) => case.currents.first().copied().unwrap_or(1.0),
                _ => 1.0,
            };
            (start.one_step(prior, false)?.noise(), unit)
        }
        Hyper::Lambda(_) | Hyper::Paper(_) | Hyper::NoiseFigure(_) => {
            (TvOptions::default().noise_v, TvOptions::default().current_a)
        }
    };
    let tv = Tv::new(
        Arc::clone(&case.mesh),
        &case.contact_ohm_m,
        &start.sigma0,
        &case.protocol,
        TvOptions {
            noise_v,
            current_a,
            strength: options
                .lambda
                .map_or(TvOptions::default().strength, Strength::Alpha),
            loss_only: options.loss_only,
            gap: options.gap.unwrap_or(TvOptions::default().gap),
            scale: start.scale.clone(),
            ..TvOptions::default()
        },
    )
    .map_err(|fault| Failure::of("total variation", &fault))?;
    notes.push(format!("{}: {}", tv.method(), tv.assumptions().join("; ")));
    Ok(Choice {
        reconstructor: Box::new(tv),
        notes,
        slow: false,
    })
}

/// Eq. 4 and 5 of the paper as printed: one linear step with the square of the gradient, alpha 1e-6 unless `--lambda`
/// says another.
pub(super) fn paper(
    options: &MethodOptions,
    case: &Case,
    recording: &FrameTable,
) -> Result<Choice, Failure> {
    for (name, given) in [
        ("--prior", options.prior.is_some()),
        ("--gap", options.gap.is_some()),
        ("--noise-v", options.noise_v.is_some()),
        ("--loss-only", options.loss_only),
    ] {
        if given {
            return Err(Failure::usage(format!(
                "{name} has no meaning with --method tv-paper: it is one linear step as the paper prints it; --lambda is \
                 its alpha"
            )));
        }
    }
    let alpha = options.lambda.unwrap_or(PAPER_ALPHA);
    // the noise is not looked at; a lambda keeps it from being estimated
    let start = Start::new(
        &MethodOptions {
            lambda: Some(alpha),
            ..options.clone()
        },
        Prior::Variation,
        case,
        recording,
    )?;
    let mut notes = start.notes.clone();
    let one_step = OneStep::new(
        Arc::clone(&case.mesh),
        &case.contact_ohm_m,
        &start.sigma0,
        &case.protocol,
        OneStepOptions {
            prior: Prior::Variation,
            hyper: Hyper::Paper(alpha),
            scale: start.scale.clone(),
            ..OneStepOptions::default()
        },
    )
    .map_err(|fault| Failure::of("total variation as the paper prints it", &fault))?;
    notes.push(format!(
        "total variation as the paper prints it (Eq. 4 and 5: quadratic), alpha {alpha:e}, one iteration; dv over the \
         largest reading and dsigma over sigma0 are our reading; lambda {:.3e}",
        one_step.lambda()
    ));
    Ok(Choice {
        reconstructor: Box::new(one_step),
        notes,
        slow: false,
    })
}
