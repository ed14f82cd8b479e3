//! One-step difference reconstruction.

use std::sync::Arc;

use eit::{OneStep, OneStepOptions, Reconstructor};

use super::Prepared;
use super::hyper_parameter::hyper;
use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::settings::ReconstructionSettings;

pub(super) fn prepare(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Prepared, BuildError> {
    let (hyper, note) = hyper(settings, conditions)?;
    let one_step = solver(
        conditions,
        OneStepOptions {
            prior: settings.one_step_prior(),
            hyper,
            loss_only: settings.loss_only.unwrap_or(false),
            map_error: settings.map_error,
            ..OneStepOptions::default()
        },
    )?;
    let mut notes: Vec<String> = note.into_iter().chain(raised(&one_step)).collect();
    if let Some(lambda) = one_step.lambda() {
        let figure = one_step.noise_figure();
        notes.push(format!(
            "{}, lambda {lambda:.3e}{}",
            one_step.method(),
            figure.map_or(String::new(), |figure| format!(
                ", noise figure {figure:.3}"
            ))
        ));
    } else {
        notes.extend(one_step.assumptions().into_iter().next());
    }
    if settings.map_error.is_some() {
        notes.extend(one_step.assumptions().pop());
    }
    Ok(Prepared::quick(one_step, notes, conditions))
}

/// The reconstructor for these conditions, which replace `scale` and `shown` of the options.
pub(super) fn solver(
    conditions: &Conditions<'_>,
    options: OneStepOptions,
) -> Result<OneStep, BuildError> {
    let geometry = conditions.geometry;
    Ok(OneStep::new(
        Arc::clone(&geometry.mesh),
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        conditions.protocol,
        OneStepOptions {
            scale: conditions.scale.clone(),
            shown: conditions.shown_unknowns(),
            ..options
        },
    )?)
}

/// The remark on a lambda that was raised because the noise is below the accuracy of the linear model; `None` if it was
/// not raised.
pub(super) fn raised(one_step: &OneStep) -> Option<String> {
    let lambda = one_step.lambda().filter(|_| one_step.raised())?;
    Some(format!(
        "the noise is below the error of a linear model: lambda is raised to {lambda:.3e}, {:e} of the model's size",
        eit::MODEL_SHARE
    ))
}
