//! Resolves a configuration as far as possible without connecting to an instrument.

mod alarms;
mod costs;
#[cfg(test)]
mod extremes;
mod machine;
#[cfg(test)]
mod mutated;
mod numbers;
mod recording;
mod rig_plan;
mod wiring;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use sha2::{Digest, Sha256};
use survey::{Amps, Protocol, ProtocolError, duration};

pub(crate) use crate::preparation::costs::costs;

use crate::acquisition::playback::Recording;
use crate::acquisition::schedule::Schedule;
use crate::instruments::rig_plan::RigPlan;
use crate::instruments::simulation::SimulatedRig;
use config::problems::{Problem, Source};
use config::{AlarmSettings, Config, RigKind, SurveySection};
use imaging::quantities::{Quantifier, RegionError, RegionSettings, check_regions};
use imaging::{Conditions, DriftRule, Geometry, Model, ReconstructionSettings, noise};
use survey::error_chain as chain;

/// A resolved configuration.
pub(crate) struct Prepared {
    pub setup: Setup,
    pub frames: FramesFrom,
    /// The file that the configuration was read from.
    pub source: Source,
}

/// Data that are constant until a reload.
pub(crate) struct Setup {
    /// The configuration with all paths and defaults.
    pub config: Config,
    pub config_toml: String,
    pub config_hash: String,
    pub protocol: Protocol,
    /// The current at which frames are measured.
    pub current: Amps,
    pub geometry: Geometry,
    pub model: Model,
    pub schedule: Schedule,
    pub record_directory: PathBuf,
    /// Frames whose transcripts are kept in memory.
    pub transcripts: usize,
}

/// The source of frames.
pub(crate) enum FramesFrom {
    Rig(Arc<RigPlan>),
    Recording {
        recording: Box<Recording>,
        baseline: Box<survey::Baseline>,
    },
}

/// The problems of one file, collected.
struct Findings<'a> {
    source: &'a Source,
    found: Vec<Problem>,
}

impl Findings<'_> {
    fn add(&mut self, key: &str, text: impl Into<String>) {
        self.found.push(self.source.problem(key, text));
    }

    fn value_or_problem<T>(&mut self, key: &str, outcome: Result<T, String>) -> Option<T> {
        outcome.map_err(|text| self.add(key, text)).ok()
    }
}

/// Reads and resolves a file. Opens only files.
///
/// # Errors
/// Every problem found.
pub(crate) fn prepare(path: &Path) -> Result<Prepared, Vec<Problem>> {
    let (source, config) = load(path)?;
    let mut findings = Findings {
        source: &source,
        found: Vec::new(),
    };
    let resolved = resolve(config, &mut findings);
    let found = findings.found;
    match resolved {
        Some((setup, frames)) if found.is_empty() => Ok(Prepared {
            setup,
            frames,
            source,
        }),
        _ => Err(found),
    }
}

/// The plan of a session whose survey settings differ from the configuration.
///
/// # Errors
/// The problems, one sentence each.
pub(crate) fn adjusted(setup: &Setup, survey: SurveySection) -> Result<RigPlan, Vec<String>> {
    let config = Config {
        survey,
        ..setup.config.clone()
    };
    let source = Source::new(Path::new("the session's options"), String::new());
    let mut findings = Findings {
        source: &source,
        found: Vec::new(),
    };
    numbers::check(&config, &mut findings);
    let protocol = pattern(setup.protocol.electrodes(), &config.survey)
        .map_err(|cause| vec![format!("skip: {}", chain(&cause))])?;
    let plan = rig_plan::rig_plan(&config, &protocol, Some(&setup.geometry), &mut findings);
    match plan {
        Some(plan) if findings.found.is_empty() => Ok(plan),
        _ => Err(findings.found.into_iter().map(|found| found.text).collect()),
    }
}

/// Reads a file to its effective configuration, with resolved paths.
///
/// # Errors
/// Every problem of its text.
pub(crate) fn load(path: &Path) -> Result<(Source, Config), Vec<Problem>> {
    let text = std::fs::read_to_string(path).map_err(|cause| {
        vec![Problem {
            file: path.to_owned(),
            place: None,
            text: format!("cannot be read: {cause}"),
        }]
    })?;
    let source = Source::new(path, text);
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let folder = absolute.parent().unwrap_or(Path::new("/"));
    let config = match source.read() {
        (Some(config), problems) if problems.is_empty() => config,
        (config, found) => {
            let mut findings = Findings {
                source: &source,
                found,
            };
            let model = match (source.without_rules(), config) {
                (Some(rest), _) => {
                    let resolved = resolve(rest.resolved(folder), &mut findings);
                    resolved.map(|(setup, _)| setup.model)
                }
                (None, Some(config)) => {
                    numbers::check(&config, &mut findings);
                    None
                }
                (None, None) => None,
            };
            of_sound_entries(model.as_ref(), &mut findings);
            return Err(findings.found);
        }
    };
    Ok((source, config.resolved(folder)))
}

fn resolve(mut config: Config, findings: &mut Findings<'_>) -> Option<(Setup, FramesFrom)> {
    numbers::check(&config, findings);
    if !(config.bus.peer || config.bus.session || config.bus.system) {
        findings.add(
            "bus",
            "no client could reach the daemon; set peer, session or system to true",
        );
    }
    let Some((geometry, protocol, frames)) = sources(&config, findings) else {
        of_entries(&config, None, findings);
        return None;
    };
    if let Some(FramesFrom::Recording {
        recording,
        baseline,
    }) = &frames
    {
        recording::complete(
            &mut config,
            recording.frames(),
            baseline,
            &geometry,
            &protocol,
        );
    }
    // stored with each session, so that replay does the same
    let tracks = config.rig.kind != RigKind::Recording
        && config.geometry.is_sheet()
        && config.model.drift.unwrap_or_default() == DriftRule::Off;
    config.model.tracking.get_or_insert(tracks);
    let current = Amps(config.survey.current_ua * 1e-6);
    let key = if config.model.file.is_some() {
        "model.file"
    } else {
        "model"
    };
    let conditions = Conditions::live(&geometry, &protocol, current);
    let built = imaging::check_live(&config.model)
        .and_then(|()| imaging::build(&config.model, &conditions));
    let model = findings.value_or_problem(key, built.map_err(|error| chain(&error)));
    of_entries(&config, model.as_ref(), findings);
    let (config_toml, config_hash) = findings.value_or_problem("rig", effective(&config))?;
    let setup = Setup {
        config_hash,
        config_toml,
        schedule: Schedule {
            every: duration(config.schedule.every_s.unwrap_or(0.0)),
            count: config.schedule.count,
            lasts: config.schedule.for_s.map(duration),
        },
        record_directory: config.record.directory.clone()?,
        transcripts: config.record.transcripts,
        protocol,
        current,
        geometry,
        model: model?,
        config,
    };
    Some((setup, frames?))
}

/// Geometry, measurements and the source of frames, which is `None` if it has a problem.
fn sources(
    config: &Config,
    findings: &mut Findings<'_>,
) -> Option<(Geometry, Protocol, Option<FramesFrom>)> {
    let case = config
        .recording
        .as_ref()
        .filter(|_| config.rig.kind == RigKind::Recording)
        .and_then(|recording| recording.case.as_deref());
    let geometry = findings.value_or_problem(
        "geometry",
        config
            .geometry
            .geometry(case)
            .map_err(|error| chain(&error)),
    );
    let (protocol, frames) = match config.rig.kind {
        RigKind::Recording => {
            let (protocol, recording, baseline) = recording::recorded(config, findings)?;
            let frames = FramesFrom::Recording {
                recording: Box::new(recording),
                baseline: Box::new(baseline),
            };
            (protocol, Some(frames))
        }
        _ => {
            let protocol = requested(config, geometry.as_ref(), findings)?;
            let plan = rig_plan::rig_plan(config, &protocol, geometry.as_ref(), findings);
            (protocol, plan.map(|plan| FramesFrom::Rig(Arc::new(plan))))
        }
    };
    let geometry = geometry?;
    if protocol.electrodes() != geometry.electrodes() {
        findings.add(
            if config.rig.kind == RigKind::Recording {
                "recording"
            } else {
                "survey.electrodes"
            },
            format!(
                "the survey has {} electrodes, the geometry ({}) has {}",
                protocol.electrodes(),
                geometry.name,
                geometry.electrodes()
            ),
        );
        return None;
    }
    Some((geometry, protocol, frames))
}

/// Checks every `[[region]]` and `[[alarm]]`.
fn of_entries(config: &Config, model: Option<&Model>, findings: &mut Findings<'_>) {
    of_regions(config.region.iter().enumerate(), config, model, findings);
    let rules = config.alarm.iter().enumerate();
    alarms::check(rules, Some(&config.region), config, model, findings);
}

/// Checks the valid regions and rules of a configuration that has other errors, so that their problems are reported
/// too.
fn of_sound_entries(model: Option<&Model>, findings: &mut Findings<'_>) {
    let (regions, all) = findings.source.sound::<RegionSettings>("region");
    let (rules, _) = findings.source.sound::<AlarmSettings>("alarm");
    let each = regions.iter().map(|(index, region)| (*index, region));
    of_regions(each, &Config::default(), model, findings);
    let config = Config {
        region: regions.into_iter().map(|(_, region)| region).collect(),
        ..Config::default()
    };
    let known = all.then_some(config.region.as_slice());
    let rules = rules.iter().map(|(index, rule)| (*index, rule));
    alarms::check(rules, known, &config, model, findings);
}

/// Each region must have a unique name and a shape, and overlap the map.
fn of_regions<'a>(
    regions: impl Iterator<Item = (usize, &'a RegionSettings)>,
    config: &Config,
    model: Option<&Model>,
    findings: &mut Findings<'_>,
) {
    let mut names = BTreeSet::new();
    for (index, region) in regions {
        let alone = std::slice::from_ref(region);
        let fault = match check_regions(alone) {
            Err((_, error)) => Some(error),
            Ok(()) if !names.insert(&region.name) => Some(RegionError::Twice(region.name.clone())),
            Ok(()) => {
                model.and_then(|model| Quantifier::new(model, &config.quantities, alone).err())
            }
        };
        if let Some(error) = fault {
            findings.add(&format!("region.{index}"), error.to_string());
        }
    }
}

/// A configuration in the form stored with a session, and its hash.
fn effective(config: &Config) -> Result<(String, String), String> {
    let text = toml::to_string(config).map_err(|cause| cause.to_string())?;
    let hash = Sha256::digest(text.as_bytes());
    Ok((text, survey::hex(&hash)))
}

impl Setup {
    /// The configuration stored with a session whose model has these settings, and its hash. Its maps can be recomputed
    /// from the session alone.
    pub(crate) fn stored_config(
        &self,
        settings: Option<&ReconstructionSettings>,
    ) -> (String, String) {
        let other = settings.filter(|settings| **settings != self.config.model);
        let with_settings = other.map(|settings| {
            let mut config = self.config.clone();
            config.model = settings.clone();
            effective(&config)
        });
        match with_settings {
            Some(Ok(kept)) => kept,
            // the error is not expected: this type of configuration was already serialised when it was prepared
            Some(Err(_)) | None => (self.config_toml.clone(), self.config_hash.clone()),
        }
    }
}

/// The protocol of a rig.
fn requested(
    config: &Config,
    geometry: Option<&Geometry>,
    findings: &mut Findings<'_>,
) -> Option<Protocol> {
    let electrodes = config
        .survey
        .electrodes
        .or_else(|| geometry.map(Geometry::electrodes))?;
    findings.value_or_problem(
        "survey.electrodes",
        pattern(electrodes, &config.survey).map_err(|cause| chain(&cause)),
    )
}

/// The protocol of a survey.
fn pattern(electrodes: usize, survey: &SurveySection) -> Result<Protocol, ProtocolError> {
    // a larger skip would give the same pairs in the opposite direction, or none
    if survey.skip + 2 > electrodes {
        return Err(ProtocolError::Empty);
    }
    let pattern = survey::skip(electrodes, survey.skip);
    let measurements = match survey.half {
        true => survey::half(pattern).collect(),
        false => pattern.collect(),
    };
    Protocol::new(electrodes, measurements)
}

impl Prepared {
    /// Whether voltages come from a simulated sheet.
    pub(crate) fn is_simulated(&self) -> bool {
        match &self.frames {
            FramesFrom::Rig(rig) => rig.simulation.is_some(),
            FramesFrom::Recording { recording, .. } => recording.frames().is_simulated(),
        }
    }

    /// Contradictions that are not errors, one sentence each. Reads the last baseline from the record, if possible.
    pub(crate) fn warnings(&self) -> Vec<String> {
        let (FramesFrom::Rig(rig), Some(noise_uv)) =
            (&self.frames, self.setup.config.model.noise_uv)
        else {
            return Vec::new();
        };
        let meter = &rig.meter;
        let resolution = rig
            .plan
            .resolution(meter.resolution, meter.range, meter.averages);
        let mut records = logbook::Index::load(&self.setup.record_directory);
        let last = match records.refresh() {
            Ok(()) => records.latest_baseline(chrono::Utc::now()).ok().flatten(),
            Err(_) => None,
        };
        let measured = last.and_then(|(_, baseline)| noise::contradiction(noise_uv, &baseline));
        let resolution = noise::below_the_voltmeter(noise_uv, resolution.rms.0);
        measured.or(resolution).into_iter().collect()
    }

    /// The simulated rig of the simulated instruments; `None` if none is simulated.
    ///
    /// # Errors
    /// A profile and a scene that do not match.
    pub(crate) fn simulated_rig(&self) -> Result<Option<SimulatedRig>, String> {
        match &self.frames {
            FramesFrom::Rig(plan) => plan
                .simulation
                .as_ref()
                .map(|(profile, scene)| SimulatedRig::new(profile, scene.clone()))
                .transpose()
                .map_err(|error| chain(&error)),
            FramesFrom::Recording { .. } => Ok(None),
        }
    }
}
