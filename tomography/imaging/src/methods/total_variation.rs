//! Total variation without warm starts, so that a map depends on its frame alone; and the paper's "total variation"
//! step.

use std::sync::Arc;

use eit::{Hyper, OneStepOptions, Prior, Reconstructor, Strength, Tv, TvOptions};

use super::Prepared;
use super::hyper_parameter::hyper;
use super::one_step::solver;
use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::settings::ReconstructionSettings;

/// The paper's alpha, for its single iteration.
const PAPER_ALPHA: f64 = 1e-6;

/// `lambda` is alpha of the formula with readings in V. Without it alpha is derived from the errors of the frame or
/// from the noise, like lambda of the one-step method.
pub(super) fn prepare(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Prepared, BuildError> {
    let usual = TvOptions::default();
    let (hyper, note) = hyper(settings, conditions)?;
    let (noise_v, frame_rule) = match hyper {
        Hyper::Noise { volts, .. } => (Some(volts), None),
        Hyper::Frame { rule, volts, .. } => (volts, Some(rule)),
        _ => (usual.noise_v, None),
    };
    let geometry = conditions.geometry;
    let tv = Tv::new(
        Arc::clone(&geometry.mesh),
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        conditions.protocol,
        TvOptions {
            noise_v,
            frame_rule,
            current_a: conditions.current.0,
            strength: settings.lambda.map_or(usual.strength, Strength::Alpha),
            loss_only: settings.loss_only.unwrap_or(false),
            gap: settings.gap.unwrap_or(usual.gap),
            scale: conditions.scale.clone(),
            shown: conditions.shown_unknowns(),
            ..usual
        },
    )?;
    let about = format!("{}: {}", tv.method(), tv.assumptions().join("; "));
    let notes = note.into_iter().chain([about]).collect();
    Ok(Prepared::quick(tv, notes, conditions))
}

/// Eq. 4 and 5 of the paper as printed: one linear step with the square of the gradient, alpha 1e-6 unless `lambda` is
/// given.
pub(super) fn paper(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Prepared, BuildError> {
    let alpha = settings.lambda.unwrap_or(PAPER_ALPHA);
    let one_step = solver(
        conditions,
        OneStepOptions {
            prior: Prior::Variation,
            hyper: Hyper::Paper(alpha),
            ..OneStepOptions::default()
        },
    )?;
    let notes = vec![format!(
        "total variation as the paper prints it (Eq. 4 and 5: quadratic), alpha {alpha:e}, one iteration; dv over the \
         largest reading and dsigma over sigma0 are our reading; lambda {:.3e}",
        one_step.lambda().unwrap_or_default()
    )];
    Ok(Prepared::quick(one_step, notes, conditions))
}
