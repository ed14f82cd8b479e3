//! The best of the methods: one step with NOSER p = 0.25, bounded to losses unless the frames show gains, and shapes if
//! the noise is known. Networks of the paper's size blur presses of 10 mm at any noise, so they are never chosen.

use std::collections::BTreeMap;
use std::sync::Arc;

use eit::{Case, OneStep, Prior, Reconstructor, Scale, Shapes};

use super::Prepared;
use super::hyper_parameter::{hyper, noise_v};
use super::one_step::{raised, solver};
use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::settings::ReconstructionSettings;

/// Largest share of gain (of the squared map, by area) in maps that count as losses only.
const GAIN: f64 = 0.2;

pub(super) fn prepare(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Prepared, BuildError> {
    let one_step = super::for_unknowns(settings, conditions, one_step)?;
    // an explicit prior selects a linear method
    if settings.noise_uv.is_none() || settings.prior.is_some() {
        return Ok(one_step);
    }
    with_shapes(settings, conditions, one_step)
}

/// The one-step method, bounded to losses unless the frames show gains.
fn one_step(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Prepared, BuildError> {
    let prior = settings.one_step_prior();
    let (hyper, mut notes) = hyper(settings, conditions, prior)?;
    let linear = solver(conditions, prior, hyper, false, None)?;
    let share = gain(&linear, conditions);
    let bounded = settings.loss_only.unwrap_or(false) || share <= GAIN;
    // bounded maps with the gaussian prior take minutes: only if selected explicitly
    let one_step = match bounded && !matches!(prior, Prior::Gaussian { .. }) {
        true => solver(conditions, prior, hyper, true, None)?,
        false => linear,
    };
    notes.extend(raised(&one_step));
    notes.push(format!(
        "best: {}, lambda {:.3e}: {:.0} % of the unbounded maps is gain of conductance ({}); networks of 100 neurons \
         blur small loads at any noise",
        one_step.method(),
        one_step.lambda(),
        100.0 * share,
        if bounded { "taken for ringing of losses" } else { "too much to be ringing of losses" },
    ));
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
    notes.extend(shapes.assumptions());
    Ok(Prepared {
        slow: true,
        ..Prepared::quick(shapes, notes, conditions)
    })
}

/// Share of gain in the unbounded maps of the frames, by the square of the change and by area; 0 without frames.
fn gain(linear: &OneStep, conditions: &Conditions<'_>) -> f64 {
    let Some(sample) = conditions.sample else {
        return 0.0;
    };
    let areas = linear.mesh().region_areas();
    let (mut gain, mut all) = (0.0, 0.0);
    for frame in &sample.frames {
        let Ok(map) = linear.reconstruct(&sample.baseline, frame) else {
            continue; // the frame's error is reported when it is reconstructed
        };
        for (value, area) in map.values.iter().zip(&areas) {
            gain += value.max(0.0).powi(2) * area;
            all += value * value * area;
        }
    }
    if all > 0.0 { gain / all } else { 0.0 }
}
