//! Total variation as a command line asks for it.

use std::sync::Arc;

use eit::{Case, Hyper, OneStepOptions, Reconstructor, Scale, Strength, Tv, TvOptions};

use super::start::Start;
use super::{Choice, positive};
use crate::args::ReconstructOptions;
use crate::failure::Failure;
use crate::recording::Recording;

/// `--lambda` is alpha of the formula with readings as they are; else alpha follows from the noise, and where nobody
/// says that either, from the frames themselves as the one-step method's lambda does.
pub(super) fn prepare(
    options: &ReconstructOptions,
    case: &Case,
    recording: &Recording,
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
        Hyper::Lambda(_) => (TvOptions::default().noise_v, TvOptions::default().current_a),
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
