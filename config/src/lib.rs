//! The schema of `config.toml`: every key with its type, default and range. All keys are optional. Problems are
//! reported with file, line and column.
//!
//! This crate only parses: the daemon's preparation compares the values with what instruments, files and sheets allow.
//! Defaults are those of the paper's sheet on a simulated rig.
//!
//! ```
//! use config::problems::Source;
//! let text = "[survey]\nnplc = 3\n".to_owned();
//! let (_, problems) = Source::new("c.toml".as_ref(), text).read();
//! assert!(problems[0].to_string().starts_with("c.toml:2:8: survey.nplc: 3 is none of"));
//! ```

mod alarm;
mod archive;
mod bounds;
mod measuring;
mod mqtt;
pub mod numbers;
mod observing;
pub mod problems;
mod section;

use std::path::{Path, PathBuf};

use imaging::quantities::{QuantitySettings, RegionSettings};
use imaging::{GeometrySettings, ReconstructionSettings};
use serde::{Deserialize, Serialize};
use survey::Bounds::{Above, Within};

use crate::bounds::{COUNT, ELECTRODES, EVERY_S, FOR_S, MEGABYTES, SLOT, SPEED};
use crate::section::section;

pub use alarm::{AlarmSettings, HealthValue, Limit, Watched};
pub use archive::ArchiveSection;
pub use measuring::{RangesName, SurveySection};
pub use mqtt::MqttSection;
pub use observing::{MetricsSection, NotifySection};

/// The whole file.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// `[rig]`.
    pub rig: RigSection,
    /// `[source]`, the current source.
    pub source: Option<InstrumentSection>,
    /// `[switch]`.
    pub switch: Option<InstrumentSection>,
    /// `[voltmeter]`.
    pub voltmeter: Option<InstrumentSection>,
    /// `[recording]`.
    pub recording: Option<RecordingSection>,
    /// `[wiring]`.
    pub wiring: WiringSection,
    /// `[survey]`.
    pub survey: SurveySection,
    /// `[geometry]`.
    pub geometry: GeometrySettings,
    /// `[model]`.
    pub model: ReconstructionSettings,
    /// `[quantities]`.
    pub quantities: QuantitySettings,
    /// `[[region]]`, each one a part of the sheet with quantities of its own.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub region: Vec<RegionSettings>,
    /// `[[alarm]]`, each one a rule.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub alarm: Vec<AlarmSettings>,
    /// `[record]`.
    pub record: RecordSection,
    /// `[about]`.
    pub about: AboutSection,
    /// `[bus]`.
    pub bus: BusSection,
    /// `[schedule]`.
    pub schedule: ScheduleSection,
    /// `[relay_wear]`.
    pub relay_wear: RelayWearSection,
    /// `[notify]`.
    pub notify: NotifySection,
    /// `[metrics]`.
    pub metrics: MetricsSection,
    /// `[archive]`.
    pub archive: Option<ArchiveSection>,
    /// `[mqtt]`.
    pub mqtt: Option<MqttSection>,
}

/// Where frames come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RigKind {
    /// Every instrument simulated, joined to one simulated sheet.
    #[default]
    Simulated,
    /// All instruments real.
    Instruments,
    /// Each instrument simulated or real, by its section.
    Mixed,
    /// Frames of an existing recording.
    Recording,
}

/// `[rig]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RigSection {
    /// Where frames come from.
    pub kind: RigKind,
    /// Profile of a simulated rig, a name or a file.
    pub profile: Option<String>,
    /// Scene of a simulated rig, a name or a file.
    pub scene: Option<String>,
}

/// The enabling level of a multiplexer chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EnableName {
    /// Enabled at low level.
    Low,
    /// Enabled at high level.
    High,
}

/// One instrument.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InstrumentSection {
    /// `tcp:HOST:PORT`, `serial:PATH`, `serial:PATH@BAUD`, `gpiochip:PATH`, `gpiochip:PATH@OFFSET` or `simulated`.
    pub address: String,
    /// Timeout of a reply, ms.
    pub deadline_ms: Option<f64>,
    /// The enabling level of a multiplexer board on a gpiochip.
    pub enable: Option<EnableName>,
}

section! {
    /// `[recording]`: existing frames.
    RecordingSection, "recording" {
        /// A session file.
        session: Option<PathBuf>;
        /// A case folder.
        case: Option<PathBuf>;
        /// A file of frames in the case folder.
        frames: Option<PathBuf>;
        /// The frames of the baseline: a file, or `first:N`.
        baseline: Option<String>;
        /// Whether the sign of all voltages is inverted, for recordings of magnitudes.
        negate: bool;
        /// Frames a second.
        frames_per_s: Option<f64>, in Above(0.0, 1e6);
        /// Speed: 1 for the recorded rate, 0 for as fast as possible.
        speed: Option<f64>, in SPEED;
    }
}

/// Which modules connect the electrodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum WiringKind {
    /// Measuring pairs on bank 1, injecting pairs on bank 2 of a 34924A: 26 reading messages a frame.
    #[default]
    #[serde(rename = "pairs-34924a")]
    Pairs34924a,
    /// The same channel numbers on a 34922A: quieter and slower.
    #[serde(rename = "pairs-34922a")]
    Pairs34922a,
    /// Measuring pairs on a 34925A, injecting pairs on bank 2 of a 34924A in `inject_slot`: the fastest scan.
    #[serde(rename = "fast-34925a")]
    Fast34925a,
    /// Pairs as columns of a 34932A matrix.
    #[serde(rename = "matrix-34932a")]
    Matrix34932a,
    /// Single electrodes on a 34934A as 4 x 128.
    #[serde(rename = "matrix-34934a")]
    Matrix34934a,
    /// The multiplexer board on a serial line or a gpiochip.
    #[serde(rename = "gpio-board")]
    GpioBoard,
    /// Relay by relay, from a file.
    #[serde(rename = "file")]
    File,
}

section! {
    /// `[wiring]`.
    WiringSection, "wiring" {
        /// The kind of wiring.
        kind: WiringKind;
        /// Slot of the first module.
        slot: u32 = 1, in SLOT;
        /// Slot of the injecting pairs.
        inject_slot: Option<u32>, in SLOT;
        /// A file with the wiring, relay by relay.
        file: Option<PathBuf>;
        /// Number of electrodes.
        electrodes: Option<usize>, in ELECTRODES;
    }
}

section! {
    /// `[record]`.
    RecordSection, "record" {
        /// Where session files are written.
        directory: Option<PathBuf>;
        /// Number of frames whose instrument messages are kept in memory.
        // the messages of one frame take some 100 kB of memory
        transcripts: usize = 8, in Within(0.0, 1000.0);
        /// Time for which frames are gathered for one sync; 0: only frames already waiting are written together.
        // no frame is published while frames are gathered
        group_ms: u64 = 0, in Within(0.0, 60e3);
        /// File size at which the next part of the session starts; 0: never.
        roll_mb: u64 = 4000, in MEGABYTES;
        /// Whether the first frame of a day (UTC) starts the next part.
        roll_daily: bool;
        /// What to do if the disk is full.
        when_full: FullName = FullName::Stop;
        /// Free space below which a warning is given once.
        warn_below_mb: u64 = 2000, in MEGABYTES;
        /// Free space below which the disk counts as full.
        reserve_mb: u64 = 200, in MEGABYTES;
        /// Whether the daemon resumes an interrupted session when it starts.
        resume: bool = true;
        /// Largest age of an interrupted session's last frame at which the session is still resumed, h.
        resume_within_h: f64 = 72.0, in Within(0.0, 8766.0);
        /// Most resumptions of a session within an hour.
        resume_per_hour: u64 = 6, in Within(0.0, 3600.0);
    }
}

/// What to do if there is no space for the record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FullName {
    /// Acquisition pauses, and continues when there is space.
    #[default]
    Stop,
    /// The oldest closed sessions are deleted.
    Ring,
}

/// Notes about the experiment, stored with every session.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AboutSection {
    /// The sheet.
    pub sheet: String,
    /// The foam, with its batch.
    pub foam: String,
    /// The ink, with its batch.
    pub ink: String,
    /// The person who measures.
    pub operator: String,
    /// The cables.
    pub wiring: String,
    /// The calibration of the instruments.
    pub calibration: String,
}

section! {
    /// `[bus]`: the daemon's D-Bus connections.
    BusSection, "bus" {
        /// Whether a unix socket is served.
        peer: bool = true;
        /// Its path.
        peer_path: Option<PathBuf>;
        /// Whether the session bus is served.
        session: bool;
        /// Whether the system bus is served.
        system: bool;
    }
}

section! {
    /// `[schedule]`.
    ScheduleSection, "schedule" {
        /// Whether a session starts with the daemon.
        start: bool;
        /// Period from start to start of frames, s; 0: back to back.
        every_s: Option<f64>, in EVERY_S;
        /// Number of frames.
        count: Option<u64>, in COUNT;
        /// Duration of the session, s.
        for_s: Option<f64>, in FOR_S;
    }
}

section! {
    /// `[relay_wear]`.
    RelayWearSection, "relay_wear" {
        /// Rated closures of a relay.
        relay_life_cycles: Option<u64>, in Within(1.0, 1e15);
    }
}

impl Config {
    /// The configuration with all paths resolved against `folder`, and with the default paths of the environment.
    pub fn resolved(mut self, folder: &Path) -> Self {
        let paths = [
            &mut self.wiring.file,
            &mut self.geometry.case,
            &mut self.model.file,
            &mut self.model.calibration,
            &mut self.record.directory,
            &mut self.bus.peer_path,
        ];
        join(folder, paths);
        if let Some(recording) = &mut self.recording {
            join(folder, [&mut recording.session, &mut recording.case]);
            if let Some(case) = &recording.case {
                if let Some(frames) = &mut recording.frames {
                    *frames = case.join(&*frames);
                }
                if let Some(baseline) = &mut recording.baseline
                    && !baseline.starts_with("first:")
                {
                    *baseline = case.join(&*baseline).to_string_lossy().into_owned();
                }
            }
        }
        // a name without a slash or an extension is a shipped file
        for name in [&mut self.rig.profile, &mut self.rig.scene]
            .into_iter()
            .flatten()
        {
            if name.contains(['/', '.']) {
                *name = folder.join(&*name).to_string_lossy().into_owned();
            }
        }
        if let Some(archive) = &mut self.archive {
            archive.resolve(folder);
        }
        if let Some(mqtt) = &mut self.mqtt {
            join(folder, [&mut mqtt.ca, &mut mqtt.password_file]);
        }
        self.record
            .directory
            .get_or_insert_with(default_record_directory);
        if self.bus.peer {
            self.bus.peer_path.get_or_insert_with(default_peer_path);
        }
        self
    }

    /// The runtime directory, which lasts until the machine restarts; holds the peer socket.
    pub fn runtime_directory(&self) -> PathBuf {
        let peer = self.bus.peer_path.clone().unwrap_or_else(default_peer_path);
        peer.parent().map_or_else(PathBuf::new, Path::to_owned)
    }
}

/// Resolves paths against `folder`.
pub(crate) fn join<const N: usize>(folder: &Path, paths: [&mut Option<PathBuf>; N]) {
    for path in paths.into_iter().flatten() {
        *path = folder.join(&*path);
    }
}

/// The path in a variable of the environment, if it is set and not empty.
pub fn path_from_environment(name: &str) -> Option<PathBuf> {
    std::env::var_os(name)
        .filter(|value| !value.is_empty())
        .map(PathBuf::from)
}

/// `$STATE_DIRECTORY` (systemd), else `$XDG_STATE_HOME/tactus`, else `~/.local/state/tactus`, else `/var/lib/tactus`.
fn default_record_directory() -> PathBuf {
    path_from_environment("STATE_DIRECTORY")
        .or_else(|| Some(path_from_environment("XDG_STATE_HOME")?.join("tactus")))
        .or_else(|| Some(path_from_environment("HOME")?.join(".local/state/tactus")))
        .unwrap_or_else(|| PathBuf::from("/var/lib/tactus"))
}

/// `$RUNTIME_DIRECTORY/peer` (systemd), else `$XDG_RUNTIME_DIR/tactus/peer`, else `/run/tactus/peer`.
fn default_peer_path() -> PathBuf {
    path_from_environment("RUNTIME_DIRECTORY")
        .map(|directory| directory.join("peer"))
        .or_else(|| Some(path_from_environment("XDG_RUNTIME_DIR")?.join("tactus/peer")))
        .unwrap_or_else(|| PathBuf::from("/run/tactus/peer"))
}
