//! The hyper-parameter: from the settings, by a rule from frames, or from the noise of a reading.

use eit::{Hyper, OneStepOptions, Prior, l_curve_lambda, probable_lambda};
use survey::Reading;

use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::noise::DEFAULT_NOISE_UV;
use crate::settings::{HyperRule, ReconstructionSettings};

/// Factor of the most probable lambda, which assumes that the unexplained part of a recording is white; that of real
/// ones is not.
const NOT_WHITE: f64 = 2.0;

/// Noise of one reading, V.
pub(super) fn noise_v(settings: &ReconstructionSettings, conditions: &Conditions<'_>) -> f64 {
    settings
        .noise_uv
        .map(|noise| noise * 1e-6)
        .or(conditions.noise_v)
        .unwrap_or(DEFAULT_NOISE_UV * 1e-6)
}

/// The hyper-parameter, and its origin unless the settings give it.
pub(super) fn hyper(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
    prior: Prior,
) -> Result<(Hyper, Vec<String>), BuildError> {
    if settings.strengths() > 1 {
        return Err(BuildError::Setting(
            "give one of lambda, noise_figure, noise_uv and choose".to_owned(),
        ));
    }
    let from_noise = Hyper::Noise {
        volts: noise_v(settings, conditions),
        current: conditions.current.0,
    };
    if let Some(lambda) = settings.lambda {
        return Ok((Hyper::Lambda(lambda), Vec::new()));
    }
    if let Some(figure) = settings.noise_figure {
        let note = "lambda is the one with the noise figure asked for";
        return Ok((Hyper::NoiseFigure(figure), vec![note.to_owned()]));
    }
    let Some(rule) = settings.choose else {
        return Ok((from_noise, Vec::new()));
    };
    let (factor, note) = match rule {
        HyperRule::Evidence => (
            NOT_WHITE,
            "lambda is twice the one that makes the frames most probable",
        ),
        HyperRule::LCurve => (1.0, "lambda is at the corner of the frames' L-curve"),
    };
    Ok(match from_frames(conditions, prior, rule)? {
        Some(lambda) => (Hyper::Lambda(factor * lambda), vec![note.to_owned()]),
        None => (
            from_noise,
            vec![format!(
                "no frame tells lambda: it is for a noise of {:.2e} in the readings' unit",
                noise_v(settings, conditions)
            )],
        ),
    })
}

fn from_frames(
    conditions: &Conditions<'_>,
    prior: Prior,
    rule: HyperRule,
) -> Result<Option<f64>, BuildError> {
    let Some(sample) = conditions.sample else {
        return Ok(None);
    };
    let frames: Vec<&[Reading]> = sample.frames.iter().map(Vec::as_slice).collect();
    let options = OneStepOptions {
        prior,
        scale: conditions.scale.clone(),
        shown: conditions.shown_unknowns(),
        ..OneStepOptions::default()
    };
    let geometry = conditions.geometry;
    let rule = match rule {
        HyperRule::Evidence => probable_lambda,
        HyperRule::LCurve => l_curve_lambda,
    };
    Ok(rule(
        &geometry.mesh,
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        conditions.protocol,
        &options,
        &sample.baseline,
        &frames,
    )?)
}
