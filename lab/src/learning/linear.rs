//! `tactus-lab train linear`.

use std::path::Path;

use eit::{Jitter, Preset, Report, TrainingSettings, model};
use studies::methods::{positive, read_frames};
use studies::{Failure, progress};
use survey::Amps;
use training::dataset::DataSet;
use training::samples::Samples;
use training::{linear, single_current};

use crate::args::{LinearOptions, Profile};
use crate::geometry;

/// Trains and writes the model file.
pub(super) fn train(options: &LinearOptions) -> Result<(), Failure> {
    for level in &options.noise_v {
        positive("--noise-v", Some(*level), "e.g. 2e-6")?;
    }
    positive("--gamma", Some(options.gamma), "the paper's is 0.01")?;
    let case = match &options.case {
        Some(folder) => geometry::read(folder)?,
        None => geometry::case(&Preset::default(), Amps(1e-3))?,
    };
    let jitter = match (options.profile, &options.repeats) {
        (Profile::Paper, _) => Jitter::Paper {
            gamma: options.gamma,
        },
        (Profile::Matched, Some(path)) => Jitter::Measured {
            volts: repeats(path, case.protocol.len())?,
            current_a: single_current(&case)?,
        },
        (Profile::Matched, None) => linear::matched(&options.noise_v, single_current(&case)?),
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
    let bars = progress::Training::default();
    let show = |stage, done, of| bars.show(stage, done, of);
    let model = linear::fit(
        &case,
        settings,
        samples,
        options.symmetric,
        options.precision.into(),
        &format!("linear {profile}"),
        &show,
    )?;
    drop(bars);
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

/// Repeats of the baseline, V: whole frames only.
fn repeats(path: &Path, readings: usize) -> Result<Vec<Vec<f64>>, Failure> {
    let recording = read_frames(path, "first:1", readings, false)?;
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
