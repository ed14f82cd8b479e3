//! The misfit of a trained model's maps for cases that were not in its training set.

use std::f64::consts::SQRT_2;
use std::ops::Range;

use eit::{Case, Model, ModelCheck, OwnMisfit, Scale, TrainingSettings};
use rayon::prelude::*;
use survey::Reading;

use crate::samples::{Noise, Samples, Simulation, TrainError};

/// Maximum number of simulated cases.
const CASES: usize = 3000;

/// Adds the misfit of maps of new cases to a model. The cases are drawn like those of the training, with the seed after
/// `drawn`, the seed of the training set.
///
/// # Errors
/// Cases that cannot be simulated.
pub fn of_fresh_cases(model: Model, case: &Case, drawn: u64) -> Result<Model, TrainError> {
    let settings = &model.metadata().training;
    let fresh = TrainingSettings {
        cases: settings.cases.min(CASES),
        repeats: 1,
        neurons: 1,
        seed: drawn.wrapping_add(1),
        ..settings.clone()
    };
    let simulation = Simulation::of_case(case, &fresh)?;
    let all = 0..simulation.len();
    of_cases(model, case, &simulation, all)
}

/// Adds the misfit of maps of these cases of a set to a model, each case with noise like that of the training. With too
/// few cases above the noise the model is unchanged.
///
/// # Errors
/// A sample that cannot be read, a noise that does not fit it, or a sheet that cannot be solved.
pub fn of_cases(
    model: Model,
    case: &Case,
    samples: &dyn Samples,
    cases: Range<usize>,
) -> Result<Model, TrainError> {
    let settings = &model.metadata().training;
    let before = samples.baseline();
    // the noise has another seed than in the training
    let seed = settings.seed.wrapping_add(1);
    let noise = Noise::new(&settings.jitter, settings.open.spread, before, seed)?;
    let top = before.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
    let check = ModelCheck::new(
        &case.mesh,
        &case.contact_ohm_m,
        &case.unloaded_conductance(),
        &case.protocol,
        Scale::Uniform,
        Some(noise.size() * top / SQRT_2),
    )?;
    let network = model.clone().into_reconstructor();
    let baseline = Reading::of_volts(before.iter().copied());
    let left = cases
        .into_par_iter()
        .map(|number| {
            let mut row = samples.sample(number)?.input;
            noise.add(&mut row, number % noise.levels(), number, samples.len());
            let changed = before
                .iter()
                .zip(&row)
                .map(|(v, x)| v + top * f64::from(*x));
            let frame = Reading::of_volts(changed);
            // cases that the network refuses have no map and are skipped
            let map = network.reconstruct(&baseline, &frame).ok();
            Ok(map.and_then(|map| check.own_misfit(&baseline, &frame, &map.values)))
        })
        .collect::<Result<Vec<_>, TrainError>>()?;
    let left = left.into_iter().flatten().collect();
    Ok(match OwnMisfit::of(noise.size(), left) {
        Some(misfit) => model.with_own_misfit(misfit)?,
        None => model,
    })
}
