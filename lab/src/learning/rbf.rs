//! `tactus-lab train rbf`.

use eit::{Jitter, Model, Preset, Report, TrainingReport, TrainingSettings, model};
use studies::methods::positive;
use studies::{Failure, progress};
use survey::Amps;
use training::dataset::DataSet;
use training::samples::Samples;
use training::{rbf, single_current};

use crate::args::{Profile, TrainOptions};
use crate::geometry;

/// Trains and writes the model file.
pub(super) fn train(options: &TrainOptions) -> Result<(), Failure> {
    positive(
        "--noise-v",
        Some(options.noise_v),
        "the noise of one reading in volts, e.g. 2e-6",
    )?;
    positive("--gamma", Some(options.gamma), "the paper's is 0.01")?;
    if options.cases < options.neurons {
        eprintln!(
            "tactus-lab: {} cases for {} neurons: with fewer cases than neurons the network repeats the cases rather \
             than learns from them; the paper has 15000 cases for 100 neurons",
            options.cases, options.neurons
        );
    }
    let case = match &options.case {
        Some(folder) => geometry::read(folder)?,
        None => geometry::case(&Preset::default(), Amps(1e-3))?,
    };
    let (jitter, profile) = match options.profile {
        Profile::Paper => (
            Jitter::Paper {
                gamma: options.gamma,
            },
            "paper",
        ),
        Profile::Matched => (
            Jitter::Matched {
                noise_v: options.noise_v,
                current_a: single_current(&case)?,
            },
            "matched",
        ),
    };
    let set = match &options.dataset {
        Some(folder) => Some(DataSet::open(folder, &case)?),
        None => None,
    };
    let drawn = match &set {
        Some(set) => set.settings().clone(),
        None => TrainingSettings {
            cases: options.cases,
            ..TrainingSettings::default()
        },
    };
    let settings = TrainingSettings {
        repeats: options.repeats,
        neurons: options.neurons,
        spread_times: options.spread_times,
        seed: options.seed,
        jitter,
        ..drawn
    };
    let samples = set.as_ref().map(|set| set as &dyn Samples);
    let bars = progress::Training::default();
    let show = |stage, done, of| bars.show(stage, done, of);
    let model = rbf::fit(&case, settings, samples, &format!("rbf {profile}"), &show)?;
    drop(bars);
    model::save(&options.out, options.replacing.existing(), &model)
        .map_err(|fault| Failure::of("cannot write the model", &fault))?;
    let report = found(&model);
    if let Some(note) = rbf::spread_note(report) {
        eprintln!("tactus-lab: {note}");
    }
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
            "{}: {} of {} simulated cases, {} of them without a load\n\
             jitter on the inputs: {:.2e} of the largest baseline reading (standard deviation)\n\
             width b of the neurons (Eq. 13): {:.3e} of the largest baseline reading, {:.1} times the median distance \
             between samples\n\
             least squares: rank {} of {}, condition {:.1e}, largest weight {:.1e} (relative change of conductance)\n\
             sha256 {}",
            options.out.display(),
            model.metadata().name,
            model.metadata().training.cases,
            report.unchanged,
            report.jitter,
            report.spread,
            report.spread_over_median,
            report.rank,
            options.neurons,
            report.condition,
            report.largest_weight,
            model.hash()
        );
    }
    Ok(())
}

/// What the training of an RBF network found.
fn found(model: &Model) -> &TrainingReport {
    match &model.metadata().report {
        Report::Rbf(report) => report,
        Report::Deep(_) => unreachable!("an RBF network was trained"),
    }
}
