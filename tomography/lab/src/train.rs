//! `tactus-lab train`, and the networks that `reconstruct` trains for a case and keeps.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eit::{
    Case, Jitter, Model, Network, Noise, Preset, Report, Samples, Simulation, TrainingReport,
    TrainingSettings, model, train_rbf_on,
};
use outfile::Existing;

use crate::args::{self, Profile};
use crate::dataset::DataSet;
use crate::failure::Failure;
use crate::noise_figure::with_noise_figure;
use crate::{choice, deep, geometry, linear, progress};

/// Above this ratio of spread to median distance a few samples rule the spread of Eq. 13.
pub(crate) const SPREAD_RULED: f64 = 10.0;

/// Trains and writes the model file.
pub(crate) fn train(network: &args::Network) -> Result<(), Failure> {
    let options = match network {
        args::Network::Rbf(options) => options,
        args::Network::Dnn(options) => return deep::train_deep(options),
        args::Network::Linear(options) => return linear::train_linear(options),
    };
    choice::positive(
        "--noise-v",
        Some(options.noise_v),
        "the noise of one reading in volts, e.g. 2e-6",
    )?;
    choice::positive("--gamma", Some(options.gamma), "the paper's is 0.01")?;
    if options.cases < options.neurons {
        eprintln!(
            "tactus-lab: {} cases for {} neurons: with fewer cases than neurons the network repeats the cases rather \
             than learns from them; the paper has 15000 cases for 100 neurons",
            options.cases, options.neurons
        );
    }
    let case = match &options.case {
        Some(folder) => geometry::read(folder)?,
        None => geometry::case(&Preset::default(), 1e-3)?,
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
                current_a: current(&case)?,
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
    let model = network_for(&case, settings, samples, &format!("rbf {profile}"))?;
    model::save(&options.out, options.replacing.existing(), &model)
        .map_err(|fault| Failure::of("cannot write the model", &fault))?;
    let report = found(&model);
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

/// The one current of a case's readings.
pub(crate) fn current(case: &Case) -> Result<f64, Failure> {
    let first = case.currents.first().copied().unwrap_or(1.0);
    if case.currents.iter().all(|current| *current == first) {
        Ok(first.abs())
    } else {
        Err(Failure::because(
            "noise in volts needs one current for all readings; protocol.csv has several",
        ))
    }
}

fn network_for(
    case: &Case,
    settings: TrainingSettings,
    samples: Option<&dyn Samples>,
    name: &str,
) -> Result<Model, Failure> {
    let sigma0 = geometry::sigma0(case);
    let bars = progress::Training::new();
    let show = |stage, done, of| bars.show(stage, done, of);
    let failed = |fault| Failure::of("the training", &fault);
    let simulation = Simulation::new(
        &case.mesh,
        &case.contact_ohm_m,
        &sigma0,
        &case.protocol,
        &settings,
    )
    .map_err(failed)?;
    let samples = samples.unwrap_or(&simulation);
    let (network, report) = train_rbf_on(samples, &settings, &show).map_err(failed)?;
    drop(bars);
    if report.spread_over_median > SPREAD_RULED {
        eprintln!(
            "tactus-lab: the spread is {:.0} median distances: a few cases near electrodes rule it (Eq. 13)",
            report.spread_over_median
        );
    }
    let jitter = (settings.jitter.clone(), settings.open.spread, settings.seed);
    let model = Model::new(
        name,
        Arc::clone(&case.mesh),
        &case.protocol,
        Network::Rbf(network),
        settings,
        Report::Rbf(report),
        None,
    )
    .map_err(|fault| Failure::of("the training", &fault))?;
    let noise = Noise::new(&jitter.0, jitter.1, samples.baseline(), jitter.2).map_err(failed)?;
    Ok(with_noise_figure(model, case, &sigma0, &noise))
}

/// The RBF network of a case, see [`kept`].
pub(crate) fn cached(case: &Case, settings: TrainingSettings) -> Result<Model, Failure> {
    kept(case, &settings, "rbf", || {
        network_for(case, settings.clone(), None, "rbf")
    })
}

/// The model of a case: from the cache if it was trained before with the same settings, else trained and kept there.
pub(crate) fn kept(
    case: &Case,
    settings: &TrainingSettings,
    kind: &str,
    make: impl FnOnce() -> Result<Model, Failure>,
) -> Result<Model, Failure> {
    let path = cache_file(case, settings, kind);
    if let Some(path) = &path
        && let Ok(model) = model::load(path)
        && model.check(&case.protocol, &case.mesh).is_ok()
        && model.metadata().training == *settings
    {
        return Ok(model);
    }
    let model = make()?;
    if let Some(path) = path {
        let kept = path
            .parent()
            .map_or(Ok(()), |folder| {
                outfile::make_folder(folder, Existing::Replace)
            })
            .map_err(|refused| refused.to_string())
            .and_then(|()| {
                model::save(&path, Existing::Replace, &model).map_err(|fault| fault.to_string())
            });
        match kept {
            Ok(()) => eprintln!(
                "tactus-lab: the trained network is kept in {}",
                path.display()
            ),
            Err(why) => eprintln!("tactus-lab: the trained network is not kept: {why}"),
        }
    }
    Ok(model)
}

/// `$XDG_CACHE_HOME/tactus/KIND-HASH.safetensors`; the hash is of everything that the training depends on.
fn cache_file(case: &Case, settings: &TrainingSettings, kind: &str) -> Option<PathBuf> {
    let base = std::env::var_os("XDG_CACHE_HOME")
        .filter(|base| Path::new(base).is_absolute())
        .map(PathBuf::from)
        .or_else(|| std::env::var_os("HOME").map(|home| Path::new(&home).join(".cache")))?;
    let said = serde_json::json!({
        "geometry": case.mesh.hash(),
        "survey": case.protocol.hash(),
        "contact": case.contact_ohm_m,
        "sigma0": case.sigma.get("homog"),
        "settings": settings,
    });
    let hash = eit::model::fingerprint(said.to_string().as_bytes());
    Some(
        base.join("tactus")
            .join(format!("{kind}-{}.safetensors", &hash[..16])),
    )
}
