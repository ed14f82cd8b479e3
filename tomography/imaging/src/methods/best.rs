//! The default method `best`: total variation with the full forward model on the whole sheet, or discs if these explain
//! the frame as well. With an explicit prior, exponent, hyper-parameter or rule, with `unknowns = "region"`, and for changes that
//! fill a layer it is the one-step method (NOSER p = 0.25 unless another prior is given), bounded to losses unless the
//! frame shows gains. Networks of the paper's size blur presses of 10 mm at any noise and are never chosen.

use std::sync::Arc;

use eit::{NonlinearTv, NonlinearTvOptions, OneStepOptions, Prior, Reconstructor};

use super::Prepared;
use super::hyper_parameter::{hyper, known_noise_v};
use super::one_step::{raised, solver};
use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::settings::{ReconstructionSettings, Unknowns};

/// Largest share of the squared change that losses alone may leave unexplained. Frames of losses of many shapes leave
/// up to 0.12, those of a tank with one conducting object (Kuopio) 0.32 or more.
const GAIN: f64 = 0.2;

pub(super) fn prepare(
    settings: &ReconstructionSettings,
    conditions: &Conditions<'_>,
) -> Result<Prepared, BuildError> {
    let geometry = conditions.geometry;
    let layer = geometry.mesh.depth().is_some_and(|depth| depth.has_layer());
    // an explicit prior, exponent or rule belongs to the linear method, and changes that fill a layer have a linear model only
    let noise_v = known_noise_v(settings, conditions);
    let linear = settings.prior.is_some()
        || settings.exponent.is_some()
        || settings.choose.is_some()
        || settings.lambda.is_some()
        || settings.noise_figure.is_some()
        || settings.map_error.is_some();
    let nonlinear = !linear && !layer && settings.unknowns != Some(Unknowns::Region);
    if !nonlinear {
        return super::for_unknowns(settings, conditions, one_step);
    }
    let nonlinear = NonlinearTv::new(
        Arc::clone(&geometry.mesh),
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        conditions.protocol,
        NonlinearTvOptions {
            noise_v,
            current_a: conditions.current.0,
            most_gain: Some(GAIN).filter(|_| settings.loss_only != Some(true)),
            scale: conditions.scale.clone(),
        },
    )?;
    let notes = nonlinear.assumptions();
    Ok(Prepared {
        slow: true,
        ..Prepared::quick(nonlinear, notes, conditions)
    })
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
        "best: networks are not used, because those of 100 neurons blur small loads at any noise"
            .to_owned(),
    );
    Ok(Prepared::quick(one_step, notes, conditions))
}

#[cfg(test)]
mod tests {
    use eit::{DiscTank, Preset};
    use survey::{Amps, Protocol};

    use super::*;
    use crate::geometry::Geometry;
    use crate::settings::{Method, PriorName};

    #[test]
    fn an_exponent_selects_the_one_step_method() {
        let tank = DiscTank {
            fineness: 0.25,
            ..DiscTank::default()
        };
        let geometry = Geometry::from_preset(&Preset::DiscTank(tank)).unwrap();
        let protocol = Protocol::sheffield(geometry.electrodes()).unwrap();
        let conditions = Conditions::live(&geometry, &protocol, Amps(1e-3));
        let method = |prior, exponent| {
            let settings = ReconstructionSettings {
                method: Some(Method::Best),
                prior,
                exponent,
                ..ReconstructionSettings::default()
            };
            let prepared = prepare(&settings, &conditions).unwrap();
            prepared.reconstructor.method().to_owned()
        };
        let one_step = method(Some(PriorName::Noser), Some(0.7));
        assert_eq!(method(None, Some(0.7)), one_step);
        assert_ne!(method(None, None), one_step);
    }
}
