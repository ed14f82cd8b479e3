//! What a configuration means: everything found out that can be found out without touching an instrument.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rig::MeterSettings;
use sha2::{Digest, Sha256};
use survey::{Amps, Limits, Plan, PlanError, Protocol, Timing, Volts, Wiring, WiringError};

use crate::config::{Config, RecordingSection, RigKind, WiringKind};
use crate::model::{Geometry, Model, chain, geometry, model};
use crate::place::Place;
use crate::problems::{Problem, Source};
use crate::recording::{Playing, Recording};
use crate::schedule::Schedule;

/// A configuration understood.
pub(crate) struct Prepared {
    pub setup: Setup,
    pub frames: FramesFrom,
}

/// What stays the same while the daemon runs.
pub(crate) struct Setup {
    /// With all paths and defaults in it.
    pub config: Config,
    pub config_toml: String,
    pub config_hash: String,
    pub protocol: Protocol,
    pub geometry: Geometry,
    pub model: Model,
    pub schedule: Schedule,
    pub record_directory: PathBuf,
}

/// Where frames come from.
pub(crate) enum FramesFrom {
    Rig(Arc<RigPlan>),
    Recording {
        recording: Box<Recording>,
        baseline: Box<survey::Baseline>,
    },
}

/// What a rig is to do, and on which instruments.
pub(crate) struct RigPlan {
    pub plan: Plan,
    pub limits: Limits,
    pub timing: Timing,
    pub meter: MeterSettings,
    pub wiring: WiringKind,
    pub instruments: Places,
    pub bench: Option<(bench::Profile, bench::Scene)>,
}

/// Where the instruments are, and how long each may take to answer.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Places {
    pub source: (Place, Duration),
    pub switch: (Place, Duration),
    pub voltmeter: (Place, Duration),
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

    fn taken<T>(&mut self, key: &str, outcome: Result<T, String>) -> Option<T> {
        outcome.map_err(|text| self.add(key, text)).ok()
    }
}

/// Reads and understands a file. Nothing is opened but files.
///
/// # Errors
/// Every problem found.
pub(crate) fn prepare(path: &Path) -> Result<Prepared, Vec<Problem>> {
    let (source, config) = load(path)?;
    let mut findings = Findings {
        source: &source,
        found: Vec::new(),
    };
    let prepared = understand(config, &mut findings);
    match prepared {
        Some(prepared) if findings.found.is_empty() => Ok(prepared),
        _ => Err(findings.found),
    }
}

/// Reads a file into its effective configuration, paths resolved.
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
    let config = source.read()?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    Ok((source, config.resolved(&folder)))
}

fn understand(config: Config, findings: &mut Findings<'_>) -> Option<Prepared> {
    numbers(&config, findings);
    if !(config.bus.peer || config.bus.session || config.bus.system) {
        findings.add(
            "bus",
            "nobody could reach the daemon; offer peer, session or system",
        );
    }
    let case = config
        .recording
        .as_ref()
        .filter(|_| config.rig.kind == RigKind::Recording)
        .and_then(|recording| recording.case.as_deref());
    let geometry = findings.taken("geometry", geometry(&config.geometry, case));
    let (protocol, frames) = match config.rig.kind {
        RigKind::Recording => {
            let (protocol, recording, baseline) = recorded(&config, findings)?;
            let frames = FramesFrom::Recording {
                recording: Box::new(recording),
                baseline: Box::new(baseline),
            };
            (protocol, Some(frames))
        }
        _ => {
            let protocol = asked(&config, geometry.as_ref(), findings)?;
            let plan = rig_plan(&config, &protocol, findings);
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
                "the survey asks {} electrodes, the geometry ({}) has {}",
                protocol.electrodes(),
                geometry.name,
                geometry.electrodes()
            ),
        );
        return None;
    }
    let key = if config.model.file.is_some() {
        "model.file"
    } else {
        "model"
    };
    let model = findings.taken(
        key,
        model(&config.model, &config.survey, &geometry, &protocol).map_err(|fault| chain(&fault)),
    );
    let config_toml = findings.taken(
        "rig",
        toml::to_string(&config).map_err(|cause| cause.to_string()),
    )?;
    let hash = Sha256::digest(config_toml.as_bytes());
    let setup = Setup {
        config_hash: hash.iter().map(|byte| format!("{byte:02x}")).collect(),
        config_toml,
        schedule: Schedule {
            every: seconds(config.schedule.every_s.unwrap_or(0.0)),
            count: config.schedule.count,
            lasts: config.schedule.for_s.map(seconds),
        },
        record_directory: config.record.directory.clone()?,
        protocol,
        geometry,
        model: model?,
        config,
    };
    Some(Prepared {
        setup,
        frames: frames?,
    })
}

/// Numbers that cannot be, whatever the rest says.
fn numbers(config: &Config, findings: &mut Findings<'_>) {
    let survey = &config.survey;
    let positive = [
        ("survey.current_ua", survey.current_ua),
        ("survey.compliance_v", survey.compliance_v),
        ("survey.range_v", survey.range_v),
    ];
    for (key, value) in positive {
        if !(value > 0.0 && value.is_finite()) {
            findings.add(key, format!("{value} is not a positive number"));
        }
    }
    let not_negative = [
        ("survey.settle_ms", Some(survey.settle_ms)),
        ("schedule.every_s", config.schedule.every_s),
        ("schedule.for_s", config.schedule.for_s),
        (
            "recording.speed",
            config.recording.as_ref().and_then(|r| r.speed),
        ),
    ];
    for (key, value) in not_negative {
        if let Some(value) = value
            && !(value >= 0.0 && value.is_finite())
        {
            findings.add(key, format!("{value} is not a number from 0 on"));
        }
    }
    if let Some(rate) = config.recording.as_ref().and_then(|r| r.frames_per_s)
        && !(rate > 0.0 && rate.is_finite())
    {
        findings.add(
            "recording.frames_per_s",
            format!("{rate} is not a positive number"),
        );
    }
    let allowed = [0.02, 0.2, 1.0, 2.0, 10.0, 20.0, 100.0, 200.0];
    if !allowed.contains(&survey.nplc) {
        findings.add(
            "survey.nplc",
            format!(
                "{} is none of 0.02, 0.2, 1, 2, 10, 20, 100, 200",
                survey.nplc
            ),
        );
    }
    let ranges = [0.1, 1.0, 10.0, 100.0, 300.0];
    if survey.range_v > 0.0 && !ranges.contains(&survey.range_v) {
        findings.add(
            "survey.range_v",
            format!("{} is none of 0.1, 1, 10, 100, 300", survey.range_v),
        );
    }
    if ![50.0, 60.0].contains(&survey.line_hz) {
        findings.add(
            "survey.line_hz",
            format!("{} is neither 50 nor 60", survey.line_hz),
        );
    }
}

/// The questions asked of a rig.
fn asked(
    config: &Config,
    geometry: Option<&Geometry>,
    findings: &mut Findings<'_>,
) -> Option<Protocol> {
    let electrodes = config
        .survey
        .electrodes
        .or_else(|| geometry.map(Geometry::electrodes))?;
    findings.taken(
        "survey.electrodes",
        Protocol::sheffield(electrodes).map_err(|cause| chain(&cause)),
    )
}

fn rig_plan(config: &Config, protocol: &Protocol, findings: &mut Findings<'_>) -> Option<RigPlan> {
    let survey = &config.survey;
    let electrodes = config.wiring.electrodes.unwrap_or(protocol.electrodes());
    let slot = config.wiring.slot;
    let wiring = match config.wiring.kind {
        WiringKind::Pairs34924a => Wiring::pairs_34924a(slot, electrodes),
        WiringKind::Matrix34932a => Wiring::matrix_34932a(slot, electrodes),
        WiringKind::GpioBoard => Wiring::gpio_board(electrodes),
    };
    let wiring = findings.taken("wiring", wiring.map_err(|cause| chain(&cause)));
    let places = places(config, findings);
    let bench = match config.rig.kind {
        RigKind::Simulated | RigKind::Mixed => Some(simulated(config, findings)),
        RigKind::Instruments | RigKind::Recording => {
            for (key, given) in [
                ("rig.profile", &config.rig.profile),
                ("rig.scene", &config.rig.scene),
            ] {
                if given.is_some() {
                    findings.add(
                        key,
                        "only a simulated rig has one; set rig.kind = \"simulated\"",
                    );
                }
            }
            None
        }
    };
    let plan = Plan::new(
        protocol,
        &wiring?,
        Amps(survey.current_ua * 1e-6),
        Volts(survey.compliance_v),
        seconds(survey.settle_ms * 1e-3),
    )
    .map_err(|cause| match cause {
        PlanError::Wiring(WiringError::Electrodes {
            wiring,
            wired,
            asked,
        }) => (
            "wiring.electrodes",
            format!("wiring '{wiring}' has {wired} electrodes, the survey asks {asked}"),
        ),
        other => ("survey", chain(&other)),
    });
    let plan = match plan {
        Ok(plan) => plan,
        Err((key, text)) => {
            findings.add(key, text);
            return None;
        }
    };
    let (limits, timing) = match config.wiring.kind {
        WiringKind::Pairs34924a => (Limits::REED, Timing::reed(survey.nplc, survey.line_hz)),
        WiringKind::Matrix34932a => (
            Limits::ARMATURE,
            Timing::armature(survey.nplc, survey.line_hz),
        ),
        WiringKind::GpioBoard => (
            Limits::GPIO_BOARD_5V,
            Timing::gpio_board(survey.nplc, survey.line_hz),
        ),
    };
    let timing = Timing {
        autozero: survey.autozero,
        ..timing
    };
    if let Err(faults) = plan.check(&limits) {
        for fault in faults {
            findings.add("survey", chain(&fault));
        }
        return None;
    }
    let bench = match bench {
        Some(bench) => Some(bench?),
        None => None,
    };
    Some(RigPlan {
        plan,
        limits,
        timing,
        meter: MeterSettings {
            range: Volts(survey.range_v),
            nplc: survey.nplc,
            autozero: survey.autozero,
        },
        wiring: config.wiring.kind,
        instruments: places?,
        bench,
    })
}

fn simulated(
    config: &Config,
    findings: &mut Findings<'_>,
) -> Option<(bench::Profile, bench::Scene)> {
    let board = config.wiring.kind == WiringKind::GpioBoard;
    let profile = config
        .rig
        .profile
        .as_deref()
        .unwrap_or(match config.wiring.kind {
            WiringKind::Pairs34924a => "pairs-34924a",
            WiringKind::Matrix34932a => "matrix-34932a",
            WiringKind::GpioBoard => "gpio-board",
        });
    let profile = findings.taken(
        "rig.profile",
        bench::Profile::load(profile).map_err(|cause| chain(&cause)),
    );
    if board
        && let Some(profile) = &profile
        && profile.board.is_none()
    {
        findings.add(
            "rig.profile",
            "the wiring needs the multiplexer board, the profile has none; add [board] to it",
        );
    }
    let scene = findings.taken(
        "rig.scene",
        match config.rig.scene.as_deref() {
            Some(scene) => crate::simulation::load_scene(scene),
            None => Ok(bench::Scene::quiet()),
        },
    );
    Some((profile?, scene?))
}

/// Longest time an instrument may need for one answer where the configuration says nothing: a scan of 26 channels at
/// 200 PLC takes 104 s, at 1 PLC half a second.
fn deadline(config: &Config, given: Option<f64>) -> Duration {
    let frame_s = 26.0 * config.survey.nplc * 2.0 / config.survey.line_hz;
    seconds(given.map_or(5.0 + 2.0 * frame_s, |given_ms| given_ms * 1e-3))
}

fn places(config: &Config, findings: &mut Findings<'_>) -> Option<Places> {
    let sections = [
        ("source", &config.source),
        ("switch", &config.switch),
        ("voltmeter", &config.voltmeter),
    ];
    if config.rig.kind == RigKind::Simulated {
        for (name, section) in sections {
            if section.is_some() {
                findings.add(
                    name,
                    "a simulated rig has no addresses; set rig.kind to \"instruments\" or \"mixed\"",
                );
            }
        }
        let memory = (Place::Simulated, deadline(config, None));
        return Some(Places {
            source: memory.clone(),
            switch: memory.clone(),
            voltmeter: memory,
        });
    }
    let mut read = sections.into_iter().map(|(name, section)| {
        let Some(section) = section else {
            findings.add(name, format!("the rig has no [{name}]; give its address"));
            return None;
        };
        match section.address.parse::<Place>() {
            Ok(Place::Simulated) if config.rig.kind == RigKind::Instruments => {
                findings.add(
                    &format!("{name}.address"),
                    "a simulated instrument in a rig of instruments; set rig.kind = \"mixed\" if that is meant",
                );
                None
            }
            Ok(place) => Some((place, deadline(config, section.deadline_ms))),
            Err(refusal) => {
                findings.add(&format!("{name}.address"), refusal.to_string());
                None
            }
        }
    });
    let (source, switch, voltmeter) = (read.next()?, read.next()?, read.next()?);
    let places = Places {
        source: source?,
        switch: switch?,
        voltmeter: voltmeter?,
    };
    if config.wiring.kind != WiringKind::GpioBoard && places.switch.0 != places.voltmeter.0 {
        findings.add(
            "voltmeter.address",
            "this wiring switches with the mainframe whose voltmeter measures: give both the same address",
        );
        return None;
    }
    Some(places)
}

fn recorded(
    config: &Config,
    findings: &mut Findings<'_>,
) -> Option<(Protocol, Recording, survey::Baseline)> {
    let Some(section) = &config.recording else {
        findings.add("rig.kind", "a recording needs a section [recording]");
        return None;
    };
    let playing = Playing {
        negate: section.negate,
        frames_per_s: section.frames_per_s,
        speed: section.speed.unwrap_or(1.0),
    };
    let (protocol, recording) = match section {
        RecordingSection {
            session: Some(session),
            case: None,
            ..
        } => {
            let opened = Recording::session(session, playing).map_err(|cause| chain(&cause));
            let (recording, protocol) = findings.taken("recording.session", opened)?;
            (protocol, recording)
        }
        RecordingSection {
            session: None,
            case: Some(case),
            frames: Some(frames),
            ..
        } => {
            let read =
                eit::read_protocol(&case.join("protocol.csv"), None).map_err(|cause| chain(&cause));
            let (protocol, currents) = findings.taken("recording.case", read)?;
            let current = Amps(currents.first().copied().unwrap_or(1.0));
            let opened =
                Recording::csv(frames, &protocol, current, playing).map_err(|cause| chain(&cause));
            (protocol, findings.taken("recording.frames", opened)?)
        }
        _ => {
            findings.add(
                "recording",
                "give either session = \"FILE\", or case = \"FOLDER\" and frames = \"FILE\"",
            );
            return None;
        }
    };
    let baseline = recording
        .baseline(section.baseline.as_deref(), &protocol, chrono::Utc::now())
        .map_err(|cause| chain(&cause));
    let baseline = findings.taken("recording.baseline", baseline)?;
    Some((protocol, recording, baseline))
}

/// Seconds as time; the longest there is for more than that.
pub(crate) fn seconds(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
}

impl Prepared {
    /// Whether voltages come from a simulated sheet.
    pub(crate) fn is_simulated(&self) -> bool {
        match &self.frames {
            FramesFrom::Rig(rig) => rig.bench.is_some(),
            FramesFrom::Recording { recording, .. } => recording.is_simulated(),
        }
    }
}
