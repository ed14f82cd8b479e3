//! The hyper-parameter: from the settings, from each frame, or from the noise of a reading.

use eit::Hyper;

use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::noise::DEFAULT_NOISE_UV;
use crate::settings::ReconstructionSettings;

/// Noise of one reading, V, if it is stated or measured.
pub(crate) fn known_noise_v(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Option<f64> {
    let measured = conditions.noise_v.filter(|_| !conditions.noise_assumed);
    settings.noise_uv.map(|noise| noise * 1e-6).or(measured)
}

/// Noise of one reading, V: known, assumed for a recording, or the default.
pub(crate) fn noise_v(settings: &ReconstructionSettings, conditions: &Conditions<'_>) -> f64 {
    known_noise_v(settings, conditions)
        .or(conditions.noise_v)
        .unwrap_or(DEFAULT_NOISE_UV * 1e-6)
}

/// The hyper-parameter, and a remark on how it is chosen if it is neither given as a number nor chosen for each frame.
pub(super) fn hyper(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<(Hyper, Option<String>), BuildError> {
    let given = [
        settings.lambda.is_some(),
        settings.noise_figure.is_some(),
        settings.choose.is_some(),
    ];
    if given.into_iter().filter(|given| *given).count() > 1 {
        return Err(BuildError::Setting(
            "give one of lambda, noise_figure and choose".to_owned(),
        ));
    }
    if let Some(lambda) = settings.lambda {
        return Ok((Hyper::Lambda(lambda), None));
    }
    if let Some(figure) = settings.noise_figure {
        let note = "lambda is chosen for the requested noise figure";
        return Ok((Hyper::NoiseFigure(figure), Some(note.to_owned())));
    }
    let current = conditions.current.0;
    let Some(rule) = settings.frame_rule() else {
        let volts = noise_v(settings, conditions);
        let note = format!("lambda is chosen for a noise of {volts:.2e} in the readings' unit");
        return Ok((Hyper::Noise { volts, current }, Some(note)));
    };
    if settings.map_error.is_some() {
        return Err(BuildError::Setting(
            "map_error needs one lambda for all frames: choose = \"noise\", a noise_figure or a lambda".to_owned(),
        ));
    }
    let volts = known_noise_v(settings, conditions);
    Ok((
        Hyper::Frame {
            rule,
            volts,
            current,
        },
        None,
    ))
}
