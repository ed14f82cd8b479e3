//! One-step difference reconstruction.

use std::sync::Arc;

use eit::{Hyper, OneStep, OneStepOptions, Prior, Reconstructor};

use super::Prepared;
use super::hyper_parameter::hyper;
use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::settings::ReconstructionSettings;

pub(super) fn prepare(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Prepared, BuildError> {
    let prior = settings.one_step_prior();
    let (hyper, mut notes) = hyper(settings, conditions, prior)?;
    let loss_only = settings.loss_only.unwrap_or(false);
    let one_step = solver(conditions, prior, hyper, loss_only, settings.map_error)?;
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
    if settings.map_error.is_some() {
        notes.extend(one_step.assumptions().pop());
    }
    Ok(Prepared::quick(one_step, notes, conditions))
}

/// The reconstructor for these conditions.
pub(super) fn solver(
    conditions: &Conditions<'_>,
    prior: Prior,
    hyper: Hyper,
    loss_only: bool,
    map_error: Option<f64>,
) -> Result<OneStep, BuildError> {
    let geometry = conditions.geometry;
    Ok(OneStep::new(
        Arc::clone(&geometry.mesh),
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        conditions.protocol,
        OneStepOptions {
            prior,
            hyper,
            loss_only,
            scale: conditions.scale.clone(),
            deviations: None,
            map_error,
            shown: conditions.shown_unknowns(),
        },
    )?)
}

/// The remark for a noise that is too small to be plausible.
pub(super) fn raised(one_step: &OneStep) -> Option<String> {
    one_step.raised().then(|| {
        format!(
            "the noise asks for more than a linear model can give: lambda is raised to {:.3e}, {:e} of the model's size",
            one_step.lambda(),
            eit::MODEL_SHARE
        )
    })
}
