//! The trained linear map: the matrix with the smallest mean square error over a training set and the noise of its
//! profile.
//!
//! x = W dv with W = E[x dv'] (E[dv dv'] + N)^-1. Moments are about zero, so that the map of zero change is empty. N is
//! the exact covariance of the jitter, not that of samples, which more copies would only approximate. The map is stored
//! as a network of one layer (f32, f16 or int8), which every program that loads networks can load.

use std::sync::Arc;

use eit::inverse::learned::network::{Layer, Rounding, TrainingDistribution, Weights};
use eit::{
    Case, DeepNetwork, DeepReport, DeepSettings, Jitter, Model, Network, Precision, Report,
    TrainingSettings,
};
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::model_cache::{Cached, kept};
use crate::noise_figure::with_noise_figure;
use crate::samples::{Noise, Progress, Samples, Simulation, Stage, TrainError, dense_target};
use crate::symmetry::Symmetric;

/// Number of samples that are read in parallel and then summed in order.
const BLOCK: usize = 256;
/// Number of inputs for the distribution of training inputs.
const TRAINING_DISTRIBUTION: usize = 4000;

/// The linear map of a case: from the cache if it was trained before with the same settings, otherwise trained and
/// cached.
///
/// # Errors
/// See [`fit`].
pub fn cached(
    case: &Case,
    settings: &TrainingSettings,
    progress: Progress<'_>,
) -> Result<Cached, TrainError> {
    kept(case, settings, "linear", || {
        fit(
            case,
            settings.clone(),
            None,
            true,
            Precision::F32,
            "linear",
            progress,
        )
    })
}

/// Jitter by white noise of one level, V, or of several levels used in turn.
pub fn matched(levels: &[f64], current_a: f64) -> Jitter {
    match levels {
        [noise_v] => Jitter::Matched {
            noise_v: *noise_v,
            current_a,
        },
        _ => Jitter::Levels {
            noise_v: levels.to_vec(),
            current_a,
        },
    }
}

/// Sums the moments, case by case, and solves for the matrix. Cases are `samples`, or simulated with `settings`; with
/// `symmetric`, the set is extended by every symmetry of the sheet.
///
/// # Errors
/// A set that cannot be simulated or read, or a covariance that is not definite.
pub fn fit(
    case: &Case,
    settings: TrainingSettings,
    samples: Option<&dyn Samples>,
    symmetric: bool,
    precision: Precision,
    name: &str,
    progress: Progress<'_>,
) -> Result<Model, TrainError> {
    let sigma0 = case.unloaded_conductance();
    let simulation = Simulation::of_case(case, &settings)?;
    let once: &dyn Samples = samples.unwrap_or(&simulation);
    // the last cases are held out for evaluation, together with all their symmetric copies
    let held_out = (once.len() / 10).min(500);
    let learnt = once.len() - held_out;
    let all = Symmetric::new(once, case, &sigma0);
    let views = if symmetric { all.views() } else { 1 };
    let (inputs, outputs) = (once.inputs(), once.outputs());
    let noise = Noise::new(
        &settings.jitter,
        settings.open.spread,
        once.baseline(),
        settings.seed,
    )?;
    let mut covariance = DMatrix::<f64>::zeros(inputs, inputs);
    // one row per reading, one column per triangle; a case adds to the columns of its changed triangles
    let mut cross = DMatrix::<f64>::zeros(inputs, outputs);
    let mut seen: Vec<f32> = Vec::new();
    let read = |case: usize| {
        (0..views)
            .map(|view| all.sample(case * all.views() + view))
            .collect::<Result<Vec<_>, _>>()
    };
    let mut first = 0;
    while first < learnt {
        let last = (first + BLOCK).min(learnt);
        let block = (first..last)
            .into_par_iter()
            .map(read)
            .collect::<Result<Vec<_>, _>>()?;
        let block: Vec<_> = block.into_iter().flatten().collect();
        let columns = DMatrix::from_fn(inputs, block.len(), |i, k| f64::from(block[k].input[i]));
        covariance.gemm(1.0, &columns, &columns.transpose(), 1.0);
        for (k, sample) in block.iter().enumerate() {
            for &(unknown, change) in &sample.target {
                cross
                    .column_mut(unknown as usize)
                    .axpy(f64::from(change), &columns.column(k), 1.0);
            }
            if seen.len() < TRAINING_DISTRIBUTION * inputs {
                let mut row = sample.input.clone();
                let item = first * views + k;
                noise.add(&mut row, item % noise.levels(), item, learnt * views);
                seen.extend(row);
            }
        }
        first = last;
        progress(Stage::Cases, first, learnt);
    }
    let count = (learnt * views) as f64;
    covariance /= count;
    cross /= count;
    let mut with_noise = covariance.as_slice().to_vec();
    noise.add_covariance(&mut with_noise);
    let factor = DMatrix::from_vec(inputs, inputs, with_noise)
        .cholesky()
        .ok_or(TrainError::Covariance)?;
    // column-major storage: a column for each triangle is a row of the layer's weights
    let solved = factor.solve(&cross);
    let weights: Vec<f32> = solved.iter().map(|value| *value as f32).collect();
    let layer = Layer {
        weights: Weights::F32(weights),
        bias: vec![0.0; outputs],
    };
    let exact = DeepNetwork::new(
        vec![0.0; inputs],
        vec![1.0; inputs],
        vec![0.0; inputs],
        vec![layer],
    )
    .map_err(TrainError::Network)?;
    let network = exact.with_precision(precision);
    let (mut loss, mut kept_loss, mut empty, mut moved, mut size) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for k in learnt..once.len() {
        let sample = once.sample(k)?;
        let mut row = sample.input.clone();
        noise.add(&mut row, k % noise.levels(), k, once.len());
        let truth = dense_target(&sample.target, outputs);
        let (map, kept) = (exact.predict(&row), network.predict(&row));
        for ((map, kept), truth) in map.iter().zip(&kept).zip(&truth) {
            let (map, kept, truth) = (f64::from(*map), f64::from(*kept), f64::from(*truth));
            loss += 0.5 * (map - truth).powi(2);
            kept_loss += 0.5 * (kept - truth).powi(2);
            empty += 0.5 * truth * truth;
            moved += (map - kept).powi(2);
            size += map * map;
        }
    }
    let judged = held_out.max(1) as f64;
    let familiar = TrainingDistribution::learn(&seen, inputs).ok_or(TrainError::Alike)?;
    let report = DeepReport {
        settings: DeepSettings {
            hidden_layers: 0,
            width: 0,
            batch_normalisation: false,
            held_out,
            epochs: 1,
            ..DeepSettings::default()
        },
        parameters: inputs * outputs,
        samples: learnt * views,
        epochs: 1,
        best_epoch: 1,
        // a second pass over the learnt cases would be needed for their own loss; docs/reference/json.md says so, too
        training_loss: loss / judged,
        held_out_loss: loss / judged,
        empty_loss: empty / judged,
        kept: Rounding {
            precision,
            map_change: if size > 0.0 {
                (moved / size).sqrt()
            } else {
                0.0
            },
            held_out_loss: kept_loss / judged,
        },
    };
    let model = Model::new(
        name,
        Arc::clone(&case.mesh),
        &case.protocol,
        Network::Deep(network, familiar),
        settings,
        Report::Deep(report),
        None,
    )?;
    Ok(with_noise_figure(model, case, &sigma0, &noise))
}
