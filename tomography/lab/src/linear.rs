//! The trained linear map: the matrix of least mean square error over a training set and the noise of its profile.
//!
//! x = W dv with W = E[x dv'] (E[dv dv'] + N)^-1, moments about zero, so that no change is no load. N is the jitter's own
//! covariance, not a sample of it: more copies would only approach this. Kept as a network of one layer: every program
//! that loads networks loads it, in f32, f16 or int8.

use std::path::Path;
use std::sync::Arc;

use eit::inverse::learned::network::{Layer, Rounding, TrainingDistribution, Weights};
use eit::{
    Case, DeepNetwork, DeepReport, DeepSettings, Jitter, Model, Network, Noise, Precision, Preset,
    Report, Samples, Simulation, TrainingSettings, dense_target, model,
};
use nalgebra::DMatrix;
use rayon::prelude::*;
use training::symmetry::Symmetric;

use crate::args::{LinearOptions, Profile};
use crate::dataset::DataSet;
use crate::failure::Failure;
use crate::noise_figure::with_noise_figure;
use crate::{choice, geometry, progress, train};

/// Samples read side by side, and summed in their order.
const BLOCK: usize = 256;
/// Inputs from which the model learns what is familiar.
const FAMILIAR: usize = 4000;

/// Trains and writes the model file.
pub(crate) fn train_linear(options: &LinearOptions) -> Result<(), Failure> {
    for level in &options.noise_v {
        choice::positive("--noise-v", Some(*level), "e.g. 2e-6")?;
    }
    choice::positive("--gamma", Some(options.gamma), "the paper's is 0.01")?;
    let case = match &options.case {
        Some(folder) => geometry::read(folder)?,
        None => geometry::case(&Preset::default(), 1e-3)?,
    };
    let jitter = match (options.profile, &options.repeats) {
        (Profile::Paper, _) => Jitter::Paper {
            gamma: options.gamma,
        },
        (Profile::Matched, Some(path)) => Jitter::Measured {
            volts: repeats(path, case.protocol.len())?,
            current_a: train::current(&case)?,
        },
        (Profile::Matched, None) => matched(&options.noise_v, train::current(&case)?),
    };
    let set = match &options.dataset {
        Some(folder) => Some(DataSet::open(folder, &case)?),
        None => None,
    };
    let settings = TrainingSettings {
        jitter,
        repeats: 1,
        ..match &set {
            Some(set) => set.settings().clone(),
            None => TrainingSettings {
                cases: options.cases,
                seed: options.seed,
                ..TrainingSettings::default()
            },
        }
    };
    let profile = match options.profile {
        Profile::Paper => "paper",
        Profile::Matched => "matched",
    };
    let samples = set.as_ref().map(|set| set as &dyn Samples);
    let model = fit(
        &case,
        settings,
        samples,
        options.symmetric,
        options.precision.into(),
        &format!("linear {profile}"),
    )?;
    model::save(&options.out, options.replacing.existing(), &model)
        .map_err(|fault| Failure::of("cannot write the model", &fault))?;
    let Report::Deep(report) = &model.metadata().report else {
        unreachable!("a network of one layer was trained");
    };
    if options.json {
        let line = serde_json::json!({
            "model": options.out.display().to_string(),
            "hash": model.hash(),
            "name": model.metadata().name,
            "training": model.metadata().training,
            "report": report,
        });
        println!("{}", survey::printable_json(line.to_string()));
    } else {
        println!(
            "{}: {} of {} samples; loss on held-out cases {:.3}, {:.0} % of an empty map's\nsha256 {}",
            options.out.display(),
            model.metadata().name,
            report.samples,
            report.held_out_loss,
            100.0 * report.held_out_loss / report.empty_loss,
            model.hash()
        );
    }
    Ok(())
}

/// The map of a case: from the cache if it was trained before with the same settings, else trained and kept there.
pub(crate) fn cached(case: &Case, noise_v: Option<f64>, cases: usize) -> Result<Model, Failure> {
    let settings = TrainingSettings {
        cases,
        repeats: 1,
        jitter: match noise_v {
            Some(noise_v) => matched(&[noise_v], train::current(case)?),
            None => Jitter::paper(),
        },
        ..TrainingSettings::default()
    };
    train::kept(case, &settings, "linear", || {
        fit(case, settings.clone(), None, true, Precision::F32, "linear")
    })
}

fn matched(levels: &[f64], current_a: f64) -> Jitter {
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

/// Repeats of the baseline, V: whole frames only.
fn repeats(path: &Path, readings: usize) -> Result<Vec<Vec<f64>>, Failure> {
    let recording = crate::recording::read(path, "first:1", readings, false)?;
    recording
        .frames
        .iter()
        .map(|(name, frame)| {
            frame
                .iter()
                .map(|reading| reading.volts().map(|volts| volts.0))
                .collect::<Option<Vec<f64>>>()
                .ok_or_else(|| {
                    Failure::because(format!(
                        "{}: repeat '{name}' has missing readings",
                        path.display()
                    ))
                })
        })
        .collect()
}

/// Sums the moments, case by case, and solves for the matrix.
fn fit(
    case: &Case,
    settings: TrainingSettings,
    samples: Option<&dyn Samples>,
    symmetric: bool,
    precision: Precision,
    name: &str,
) -> Result<Model, Failure> {
    let failed = |fault: &dyn std::error::Error| Failure::of("the training", fault);
    let sigma0 = geometry::sigma0(case);
    let simulation = Simulation::new(
        &case.mesh,
        &case.contact_ohm_m,
        &sigma0,
        &case.protocol,
        &settings,
    )
    .map_err(|fault| failed(&fault))?;
    let once: &dyn Samples = samples.unwrap_or(&simulation);
    // the last cases judge; views of one case stay on one side
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
    )
    .map_err(|fault| failed(&fault))?;
    let mut covariance = DMatrix::<f64>::zeros(inputs, inputs);
    // a row a reading: what a case adds to a triangle is one column
    let mut cross = DMatrix::<f64>::zeros(inputs, outputs);
    let mut seen: Vec<f32> = Vec::new();
    let bar = progress::bar(learnt, "cases");
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
            .collect::<Result<Vec<_>, _>>()
            .map_err(|fault| failed(&fault))?;
        let block: Vec<_> = block.into_iter().flatten().collect();
        let columns = DMatrix::from_fn(inputs, block.len(), |i, k| f64::from(block[k].input[i]));
        covariance.gemm(1.0, &columns, &columns.transpose(), 1.0);
        for (k, sample) in block.iter().enumerate() {
            for &(unknown, change) in &sample.target {
                cross
                    .column_mut(unknown as usize)
                    .axpy(f64::from(change), &columns.column(k), 1.0);
            }
            if seen.len() < FAMILIAR * inputs {
                let mut row = sample.input.clone();
                noise.add(&mut row, 0, first * views + k, learnt * views);
                seen.extend(row);
            }
        }
        first = last;
        bar.set_position(first as u64);
    }
    bar.finish_and_clear();
    let count = (learnt * views) as f64;
    covariance /= count;
    cross /= count;
    let mut with_noise = covariance.as_slice().to_vec();
    noise.add_covariance(&mut with_noise);
    let factor = DMatrix::from_vec(inputs, inputs, with_noise)
        .cholesky()
        .ok_or_else(|| {
            Failure::because(
                "the readings' covariance is not definite: measured repeats of the baseline are too few to stand alone; \
                 give --noise-v",
            )
        })?;
    // a column a triangle is a row of the layer
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
    .map_err(Failure::because)?;
    let network = exact.with_precision(precision);
    let (mut loss, mut kept_loss, mut empty, mut moved, mut size) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for k in learnt..once.len() {
        let sample = once.sample(k).map_err(|fault| failed(&fault))?;
        let mut row = sample.input.clone();
        noise.add(&mut row, 0, k, once.len());
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
    let familiar = TrainingDistribution::learn(&seen, inputs).ok_or_else(|| {
        Failure::because("all samples of the training set are alike; more cases are needed")
    })?;
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
    )
    .map_err(|fault| Failure::of("the training", &fault))?;
    Ok(with_noise_figure(model, case, &sigma0, &noise))
}
