//! The best of the methods: one step with NOSER p = 0.25, bounded to losses unless the frame shows gains, and shapes if
//! the noise is stated. Networks of the paper's size blur presses of 10 mm at any noise, so they are never chosen.

use std::collections::BTreeMap;
use std::sync::Arc;

use eit::{Case, OneStepOptions, Prior, Scale, Shapes};

use super::Prepared;
use super::hyper_parameter::{hyper, noise_v};
use super::one_step::{raised, solver};
use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::settings::ReconstructionSettings;

/// Largest share of the squared change that losses alone may leave unexplained. Frames of losses of many shapes leave up to
/// 0.12, those of a tank with one conducting object (Kuopio) 0.32 or more.
const GAIN: f64 = 0.2;

pub(super) fn prepare(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Prepared, BuildError> {
    let one_step = super::for_unknowns(settings, conditions, one_step)?;
    // an explicit prior or rule selects a linear method
    if settings.noise_uv.is_none() || settings.prior.is_some() || settings.choose.is_some() {
        return Ok(one_step);
    }
    with_shapes(settings, conditions, one_step)
}

/// The one-step method, bounded to losses unless the frame shows gains.
fn one_step(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Prepared, BuildError> {
    let prior = settings.one_step_prior();
    let (hyper, note) = hyper(settings, conditions)?;
    let always = settings.loss_only == Some(true);
    // bounded maps with the gaussian prior take minutes: only if selected explicitly
    let loss_only = always || !matches!(prior, Prior::Gaussian { .. });
    let one_step = solver(
        conditions,
        OneStepOptions {
            prior,
            hyper,
            loss_only,
            most_gain: Some(GAIN).filter(|_| !always),
            ..OneStepOptions::default()
        },
    )?;
    let mut notes: Vec<String> = note.into_iter().chain(raised(&one_step)).collect();
    notes.push(
        "best: networks of 100 neurons blur small loads at any noise, and are not used".to_owned(),
    );
    Ok(Prepared::quick(one_step, notes, conditions))
}

/// Shapes where they explain a frame, else the maps of another method.
fn with_shapes(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
    otherwise: Prepared,
) -> Result<Prepared, BuildError> {
    let mut notes = otherwise.notes;
    let geometry = conditions.geometry;
    let currents = match &conditions.scale {
        Scale::Currents(currents) => currents.clone(),
        _ => vec![conditions.current.0; conditions.protocol.len()],
    };
    let case = Case {
        mesh: Arc::clone(&geometry.mesh),
        contact_ohm_m: geometry.contact_ohm_m.clone(),
        protocol: conditions.protocol.clone(),
        currents,
        sigma: BTreeMap::new(),
        has_region: true,
    };
    let noise_v = noise_v(settings, conditions);
    let shapes = Shapes::new(&case, &geometry.sigma0, noise_v, otherwise.reconstructor)?;
    notes.push(
        "best: with the noise known, a frame that one to four shapes explain to it is the mean over what they may be; the \
         others get the map of the method above"
            .to_owned(),
    );
    Ok(Prepared {
        slow: true,
        ..Prepared::quick(shapes, notes, conditions)
    })
}
