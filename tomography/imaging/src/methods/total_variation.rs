//! Total variation without warm starts, so that a map depends on its frame alone; and the paper's "total variation"
//! step.

use std::sync::Arc;

use eit::{Hyper, OneStepOptions, Prior, Reconstructor, Scale, Strength, Tv, TvOptions};

use super::Prepared;
use super::hyper_parameter::hyper;
use super::one_step::solver;
use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::settings::ReconstructionSettings;

/// The paper's alpha, for its single iteration.
const PAPER_ALPHA: f64 = 1e-6;

/// `lambda` is alpha of the formula with unscaled readings; otherwise alpha is derived from the noise or from frames,
/// like the one-step method's lambda.
pub(super) fn prepare(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Prepared, BuildError> {
    let usual = TvOptions::default();
    let prior = OneStepOptions::default().prior;
    let (hyper, mut notes) = hyper(settings, conditions, prior)?;
    let (noise_v, current_a) = match hyper {
        Hyper::Noise { volts, current } => (volts, current),
        Hyper::Lambda(_) if settings.lambda.is_none() => {
            let unit = match &conditions.scale {
                Scale::Currents(currents) => currents.first().copied().unwrap_or(1.0),
                _ => 1.0,
            };
            (solver(conditions, prior, hyper, false, None)?.noise(), unit)
        }
        _ => (usual.noise_v, usual.current_a),
    };
    let geometry = conditions.geometry;
    let tv = Tv::new(
        Arc::clone(&geometry.mesh),
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        conditions.protocol,
        TvOptions {
            noise_v,
            current_a,
            strength: settings.lambda.map_or(usual.strength, Strength::Alpha),
            loss_only: settings.loss_only.unwrap_or(false),
            gap: settings.gap.unwrap_or(usual.gap),
            scale: conditions.scale.clone(),
            shown: conditions.shown_unknowns(),
            ..usual
        },
    )?;
    notes.push(format!("{}: {}", tv.method(), tv.assumptions().join("; ")));
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
        Prior::Variation,
        Hyper::Paper(alpha),
        false,
        None,
    )?;
    let notes = vec![format!(
        "total variation as the paper prints it (Eq. 4 and 5: quadratic), alpha {alpha:e}, one iteration; dv over the \
         largest reading and dsigma over sigma0 are our reading; lambda {:.3e}",
        one_step.lambda()
    )];
    Ok(Prepared::quick(one_step, notes, conditions))
}
