//! `tactus-lab dataset`.

use eit::{Case, Preset, TrainingSettings};
use shards::{Shard, StopRequest, missing_list};
use studies::{Failure, progress};
use survey::Amps;
use training::dataset::{MadeShard, make_shard, merge, missing};

use super::recorded;
use super::settings_file::SettingsFile;
use crate::args::DatasetOptions;
use crate::geometry;
use crate::output::print_line;

/// Makes or resumes one shard, lists the missing shards, or merges the shards.
pub(crate) fn dataset(options: &DatasetOptions) -> Result<(), Failure> {
    let case = match &options.case {
        Some(folder) => geometry::read(folder)?,
        None => geometry::case(&Preset::default(), Amps(1e-3))?,
    };
    if let Some(folder) = &options.recorded {
        return recorded::dataset(options, &case, folder);
    }
    let settings = settings(options)?;
    if let Some(of) = options.shards.missing {
        let missing = missing(&case, &settings, of, &options.out)?;
        print_line!("{}", missing_list(&missing));
        return Ok(());
    }
    let stop = stop_request()?;
    let made = make(options, &case, &settings, &stop)?;
    match made.sha256 {
        None => print_line!(
            "{}: exists already, {} cases",
            made.file.display(),
            made.cases.len()
        ),
        Some(hash) => print_line!(
            "{}: cases {} to {} of {}, {} of them from an earlier run, sha256 {hash}",
            made.file.display(),
            made.cases.start,
            made.cases.end,
            settings.cases,
            made.kept
        ),
    }
    Ok(())
}

fn make(
    options: &DatasetOptions,
    case: &Case,
    settings: &TrainingSettings,
    stop: &StopRequest,
) -> Result<MadeShard, Failure> {
    if let (Some(of), Some(parts)) = (options.shards.merge, &options.shards.parts) {
        return Ok(merge(case, settings, [parts, &options.out], of, stop)?);
    }
    let shard = options.shards.shard.unwrap_or(Shard::WHOLE);
    let bars = progress::Training::default();
    let show = |done, of| bars.show(training::samples::Stage::Cases, done, of);
    let made = make_shard(case, settings, shard, &options.out, stop, &show)?;
    Ok(made)
}

/// Settings that belong to a training and do not affect the cases of a set.
const WITHOUT_EFFECT: [&str; 4] = ["jitter", "neurons", "repeats", "spread_times"];

fn settings(options: &DatasetOptions) -> Result<TrainingSettings, Failure> {
    let mut settings: TrainingSettings = match &options.settings {
        None => TrainingSettings::default(),
        Some(path) => {
            let file = SettingsFile::read(path)
                .map_err(|cause| Failure::of(&format!("{}", path.display()), &cause))?;
            let given: toml::Table = file.parsed().map_err(Failure::configuration)?;
            if let Some(key) = given
                .keys()
                .find(|key| WITHOUT_EFFECT.contains(&key.as_str()))
            {
                let why = format!(
                    "{key} has no effect on a set: omit it here, and give it when a model is trained (tactus-lab train)"
                );
                return Err(Failure::configuration(file.about(&[key], &why)));
            }
            file.parsed().map_err(Failure::configuration)?
        }
    };
    if let Some(seed) = options.seed {
        settings.seed = seed;
    }
    if let Some(cases) = options.cases {
        settings.cases = cases;
    }
    // a set is for any method, and `train rbf` has its own number of neurons
    settings.neurons = settings.neurons.min(settings.cases);
    Ok(settings)
}

/// After this call SIGTERM ends the command when the work in progress is complete.
pub(crate) fn stop_request() -> Result<StopRequest, Failure> {
    StopRequest::on_sigterm().map_err(|cause| Failure::of("SIGTERM cannot be handled", &cause))
}
