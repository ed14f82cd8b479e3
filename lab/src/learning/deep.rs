//! `tactus-lab train dnn`: settings from a profile, a TOML file and flags; the set, the training, the model file.

use std::cell::RefCell;
use std::path::Path;
use std::sync::Arc;

use eit::{DeepReport, DeepSettings, Jitter, Model, Network, Report, TrainingSettings, model};
use indicatif::ProgressBar;
use serde::{Deserialize, Serialize};
use studies::{Failure, progress};
use training::deep::{self, Recipe, TrainingEvent};
use training::noise_figure::with_noise_figure;
use training::samples::{Noise, Samples, Simulation, TrainingSet};
use training::symmetry::Symmetric;

use super::data::Data;
use super::limits;
use super::model_file;
use super::settings_file::SettingsFile;
use crate::args::{DataOptions, DeepOptions, Profile};
use crate::output::print_line;

/// Version of the layout of a checkpoint.
const LAYOUT: u32 = 2;

/// The settings of a deep training: `[data]` and `[deep]` of a settings file.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Settings {
    data: TrainingSettings,
    deep: DeepSettings,
}

/// Trains and writes the model file.
pub(super) fn train(options: &DeepOptions) -> Result<(), Failure> {
    let data = Data::read(&options.data)?;
    let mut settings = settings(options, &data.jitter)?;
    if let Some(set) = &data.set {
        // the set determines how cases were drawn; jitter, copies and the seed of weights and order belong to this
        // training
        settings.data = TrainingSettings {
            jitter: settings.data.jitter,
            repeats: settings.data.repeats,
            seed: settings.data.seed,
            cases: set.settings().cases.saturating_sub(settings.deep.held_out),
            ..set.settings().clone()
        };
    }
    let checkpoint = match &options.checkpoint {
        Some(path) => path.clone(),
        None if outfile::is_stream(&options.out) => {
            return Err(Failure::usage(format!(
                "{} is not a file, so no checkpoint can be written next to it: give the checkpoint by --checkpoint FILE",
                options.out.display()
            )));
        }
        None => options.out.with_extension("checkpoint"),
    };
    let out: &Path = &options.out;
    if checkpoint == out {
        return Err(Failure::usage(format!(
            "--out {}: the checkpoint has the same name, and is removed when the model is complete; name another one by --checkpoint FILE",
            out.display()
        )));
    }
    let model = trained(&data, &settings, options, &checkpoint)?;
    let Report::Deep(report) = &model.metadata().report else {
        unreachable!("a deep network was trained");
    };
    limits::check_learnt(report.held_out_loss, report.empty_loss, options.data.yes)?;
    model_file::save(&options.out, &options.replacing, &model)?;
    // the model is complete, so the checkpoint is no longer needed
    let _ = std::fs::remove_file(&checkpoint);
    if options.json {
        let mut line = model_file::json(&options.out, &model, report);
        line["noise_figure"] = model.metadata().noise_figure.into();
        print_line!("{}", survey::printable_json(line.to_string()));
    } else {
        print_line!("{}", summary(&options.out, &model, report));
    }
    Ok(())
}

fn summary(path: &Path, model: &Model, report: &DeepReport) -> String {
    format!(
        "{}: {} of {} simulated cases, {} samples an epoch, {} weights and biases\n\
         loss (half the squared error of a map, summed over its triangles) at epoch {} of {}: training {:.3}, held out \
         {:.3}; of empty maps {:.3}\n\
         weights kept in {}: maps change by {:.1e} of their root mean square, held-out loss {:.3}\n\
         noise figure {}\n\
         {}\n\
         sha256 {}",
        path.display(),
        model.metadata().name,
        model.metadata().training.cases,
        report.samples,
        report.parameters,
        report.best_epoch,
        report.epochs,
        report.training_loss,
        report.held_out_loss,
        report.empty_loss,
        report.kept.precision.name(),
        report.kept.map_change,
        report.kept.held_out_loss,
        model
            .metadata()
            .noise_figure
            .map_or("unknown".to_owned(), |figure| format!("{figure:.2}")),
        model_file::misfit(model),
        model.hash()
    )
}

/// The settings of the profile, changed by the settings file and then by flags.
fn settings(options: &DeepOptions, jitter: &Jitter) -> Result<Settings, Failure> {
    let mut settings = Settings {
        data: TrainingSettings {
            jitter: jitter.clone(),
            ..TrainingSettings::default()
        },
        deep: DeepSettings::default(),
    };
    if options.data.profile != Profile::Paper {
        // 3e-5 of the largest reading, about 10 uV at 1 mA, so that small loads are not hidden
        settings.deep.normalisation_epsilon = 1e-9;
    }
    if let Some(path) = &options.settings {
        let refused = |why: String| Failure::usage(format!("settings file {why}"));
        let file = SettingsFile::read(path)
            .map_err(|cause| refused(format!("{}: {cause}", path.display())))?;
        let given: toml::Table = file.parsed().map_err(refused)?;
        // parsed again as settings, because errors of the table below have no line
        file.parsed::<Settings>().map_err(refused)?;
        if let Some((key, why)) = without_effect(&options.data, &given) {
            return Err(refused(file.about(&["data", key], &why)));
        }
        settings = changed(&settings, given).map_err(refused)?;
    }
    for (given, slot) in [
        (options.cases, &mut settings.data.cases),
        (options.repeats, &mut settings.data.repeats),
        (options.epochs, &mut settings.deep.epochs),
    ] {
        if let Some(given) = given {
            *slot = given;
        }
    }
    if let Some(seed) = options.seed {
        settings.data.seed = seed;
    }
    for text in &options.set {
        let refused = |why: String| Failure::usage(format!("--set {text}: {why}"));
        let (name, value) = text
            .split_once('=')
            .ok_or_else(|| refused("KEY=VALUE is expected, e.g. deep.width=512".to_owned()))?;
        let (table, key) = name.split_once('.').unwrap_or(("deep", name));
        let line = format!("[{table}]\n{key} = {value}");
        let given: toml::Table =
            toml::from_str(&line).map_err(|fault| refused(fault.message().to_owned()))?;
        if let Some((_, why)) = without_effect(&options.data, &given) {
            return Err(refused(why));
        }
        settings = changed(&settings, given).map_err(refused)?;
    }
    if let Some((setting, must)) = settings.deep.fault() {
        return Err(Failure::usage(format!(
            "setting deep.{setting} must be {must}"
        )));
    }
    Ok(settings)
}

/// Settings of `[data]` that belong to the training itself. The other ones determine the cases of a set.
const OF_TRAINING: [&str; 3] = ["jitter", "repeats", "seed"];

/// Settings of `[data]` that only RBF networks have.
const OF_RBF: [&str; 2] = ["neurons", "spread_times"];

/// A setting of `[data]` in `given` without effect, and the reason; `None` if all have one.
fn without_effect<'a>(options: &DataOptions, given: &'a toml::Table) -> Option<(&'a str, String)> {
    let noise = [
        ("--gamma", options.gamma.is_some()),
        ("--noise-v", !options.noise_v.is_empty()),
        ("--noise-frames", options.noise_frames.is_some()),
    ];
    let stated = noise.into_iter().find(|(_, stated)| *stated);
    let why = |key: &String| match (key.as_str(), stated) {
        (key, _) if OF_RBF.contains(&key) => Some(format!(
            "data.{key} is a setting of RBF networks and does not apply to a deep one"
        )),
        ("jitter", Some((option, _))) => Some(format!(
            "data.jitter and {option} both set the noise; leave one of them out"
        )),
        (key, _) if options.dataset.is_some() && !OF_TRAINING.contains(&key) => Some(format!(
            "data.{key} is that of the set of --dataset; `tactus-lab dataset --settings FILE` makes a set with another"
        )),
        _ => None,
    };
    let mut keys = given.get("data")?.as_table()?.keys();
    keys.find_map(|key| Some((key.as_str(), why(key)?)))
}

/// The settings, with their entries replaced by those of `given`; unknown keys are refused.
fn changed(settings: &Settings, given: toml::Table) -> Result<Settings, String> {
    let mut whole = toml::Table::try_from(settings).map_err(|fault| fault.to_string())?;
    for (name, table) in given {
        match (whole.get_mut(&name), table) {
            (Some(toml::Value::Table(whole)), toml::Value::Table(table)) => whole.extend(table),
            _ => {
                return Err(format!(
                    "'{name}' is not known; the tables are [data] and [deep]"
                ));
            }
        }
    }
    whole
        .try_into()
        .map_err(|fault: toml::de::Error| fault.message().to_owned())
}

fn trained(
    data: &Data,
    settings: &Settings,
    options: &DeepOptions,
    checkpoint: &Path,
) -> Result<Model, Failure> {
    let (case, given) = (&data.case, data.samples());
    let failed = |fault: &dyn std::error::Error| Failure::of("the training", fault);
    let sigma0 = case.unloaded_conductance();
    // the held-out cases follow the cases used for training
    let drawn = TrainingSettings {
        cases: settings.data.cases + settings.deep.held_out,
        neurons: 1,
        ..settings.data.clone()
    };
    // a given set is read from files sample by sample; a simulated one is solved once and kept in memory
    let made = match given {
        Some(_) => None,
        None => {
            limits::check_memory(drawn.cases, case.protocol.len(), 0)?;
            let bars = progress::Training::default();
            let simulation = Simulation::of_case(case, &drawn)?;
            let show = |stage, done, of| bars.show(stage, done, of);
            Some(TrainingSet::read(&simulation, &show)?)
        }
    };
    let once: &dyn Samples = match (&made, given) {
        (Some(set), _) => set,
        (None, Some(set)) => set,
        (None, None) => unreachable!("a set is given or made"),
    };
    let mirrored = Symmetric::new(once, case, &sigma0);
    let (samples, views): (&dyn Samples, usize) = match options.data.symmetric {
        true => (&mirrored, mirrored.views()),
        false => (once, 1),
    };
    let noise = Noise::new(
        &drawn.jitter,
        drawn.open.spread,
        samples.baseline(),
        drawn.seed,
    )
    .map_err(|fault| failed(&fault))?;
    let mut inputs = serde_json::json!({
        "geometry": case.mesh.hash(),
        "survey": case.protocol.hash(),
        "contact": case.contact_ohm_m,
        "sigma0": sigma0,
        "settings": settings,
        "drawn": data.set.as_ref().map(|set| set.settings()),
        "layout": LAYOUT,
        "build": env!("CARGO_PKG_VERSION"),
    });
    if options.data.symmetric {
        inputs["views"] = views.into();
    }
    let recipe = Recipe {
        samples,
        noise: &noise,
        repeats: settings.data.repeats,
        // all symmetric copies of a case belong to the same part, training or held out
        settings: DeepSettings {
            held_out: settings.deep.held_out * views,
            ..settings.deep.clone()
        },
        seed: settings.data.seed,
        precision: options.precision.into(),
        checkpoint: Some((
            checkpoint,
            model::fingerprint(inputs.to_string().as_bytes()),
        )),
    };
    let watch = Watch::default();
    let (network, familiar, report) =
        deep::train(&recipe, &|moment| watch.show(moment, &settings.deep))
            .map_err(|fault| failed(&fault))?;
    let model = Model::new(
        &format!("dnn {}", options.data.profile.name()),
        Arc::clone(&case.mesh),
        &case.protocol,
        Network::Deep(network, familiar),
        settings.data.clone(),
        Report::Deep(report),
        None,
    )
    .map_err(|fault| failed(&fault))?;
    let model = with_noise_figure(model, case, &sigma0, &noise);
    data.judged(model, settings.deep.held_out)
}

/// A progress bar for each epoch, and a line for each completed one.
#[derive(Default)]
struct Watch {
    bar: RefCell<Option<ProgressBar>>,
}

impl Watch {
    fn show(&self, moment: TrainingEvent, settings: &DeepSettings) {
        let mut bar = self.bar.borrow_mut();
        match moment {
            TrainingEvent::Resumed { epochs } => eprintln!(
                "tactus-lab: continuing from the checkpoint after epoch {epochs} of {}",
                settings.epochs
            ),
            TrainingEvent::Step { step, of, .. } => bar
                .get_or_insert_with(|| progress::bar(of, "steps"))
                .set_position(step as u64),
            TrainingEvent::Epoch {
                epoch,
                training,
                held_out,
                best,
            } => {
                let rate = bar.take().map(|bar| {
                    let rate = bar.per_sec() * settings.batch as f64;
                    bar.finish_and_clear();
                    rate
                });
                eprintln!(
                    "epoch {epoch} of {}: loss {training:.4}, held out {held_out:.4}{}, {:.0} samples/s",
                    settings.epochs,
                    if best { " (best)" } else { "" },
                    rate.unwrap_or_default()
                );
            }
        }
    }
}
