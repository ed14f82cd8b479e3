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
mod mqtt;
pub mod numbers;
mod observing;
pub mod problems;

use std::path::{Path, PathBuf};

use imaging::quantities::{QuantitySettings, RegionSettings};
use imaging::{GeometrySettings, ReconstructionSettings};
use serde::{Deserialize, Serialize};

pub use alarm::{AlarmSettings, HealthValue, Limit, Watched};
pub use archive::ArchiveSection;
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

/// `[recording]`: existing frames.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingSection {
    /// A session file.
    pub session: Option<PathBuf>,
    /// A case folder.
    pub case: Option<PathBuf>,
    /// A file of frames in the case folder.
    pub frames: Option<PathBuf>,
    /// The frames of the baseline: a file, or `first:N`.
    pub baseline: Option<String>,
    /// Whether the sign of all voltages is inverted, for recordings of magnitudes.
    pub negate: bool,
    /// Frames a second.
    pub frames_per_s: Option<f64>,
    /// Speed: 1 for the recorded rate, 0 for as fast as possible.
    pub speed: Option<f64>,
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

/// `[wiring]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WiringSection {
    /// The kind of wiring.
    pub kind: WiringKind,
    /// Slot of the first module.
    pub slot: u32,
    /// Slot of the injecting pairs.
    pub inject_slot: Option<u32>,
    /// A file with the wiring, relay by relay.
    pub file: Option<PathBuf>,
    /// Number of electrodes.
    pub electrodes: Option<usize>,
}

impl Default for WiringSection {
    fn default() -> Self {
        Self {
            kind: WiringKind::default(),
            slot: 1,
            inject_slot: None,
            file: None,
            electrodes: None,
        }
    }
}

/// `[survey]`: how a frame is measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurveySection {
    /// Number of electrodes; by default that of the sheet.
    pub electrodes: Option<usize>,
    /// Injected current, uA.
    pub current_ua: f64,
    /// Voltage limit of the source, V.
    pub compliance_v: f64,
    /// Settling time after a change of current, ms.
    pub settle_ms: f64,
    /// Range of the voltmeter, V.
    pub range_v: f64,
    /// Integration time, power-line cycles.
    pub nplc: f64,
    /// Whether every reading is followed by a zero reading.
    pub autozero: bool,
    /// Mains frequency, Hz.
    pub line_hz: f64,
    /// Number of readings that are averaged to one.
    pub averages: u32,
    /// Wait before each scanned channel, ms.
    pub channel_delay_ms: f64,
    /// Whether every injection is read with both polarities.
    pub reversal: bool,
    /// Number of electrodes between those of a pair.
    pub skip: usize,
    /// Whether only one of two reciprocal readings is taken.
    pub half: bool,
    /// Where the voltmeter's ranges come from.
    pub ranges: RangesName,
    /// Margin of planned ranges, a factor.
    pub range_margin: f64,
    /// With a matrix: whether all readings of an injection are requested in one message.
    pub chained: bool,
    /// A zero-current frame before the first and after this many frames; never if not given.
    pub zero_every: Option<u64>,
}

/// Where the voltmeter's ranges come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RangesName {
    /// One for every reading.
    #[default]
    Fixed,
    /// Individual ranges: from the baseline, or from the model of the sheet before there is one.
    Planned,
}

impl Default for SurveySection {
    fn default() -> Self {
        Self {
            electrodes: None,
            current_ua: 1000.0,
            compliance_v: 10.0,
            settle_ms: 2.0,
            range_v: 1.0,
            nplc: 1.0,
            autozero: false,
            line_hz: 50.0,
            averages: 1,
            channel_delay_ms: 0.0,
            reversal: false,
            skip: 0,
            half: false,
            ranges: RangesName::default(),
            range_margin: 1.5,
            chained: false,
            zero_every: None,
        }
    }
}

/// `[record]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordSection {
    /// Where session files are written.
    pub directory: Option<PathBuf>,
    /// Number of frames whose instrument messages are kept in memory.
    pub transcripts: usize,
    /// Time for which frames are gathered for one sync; 0: only frames already waiting are written together.
    pub group_ms: u64,
    /// File size at which the next part of the session starts; 0: never.
    pub roll_mb: u64,
    /// Whether the first frame of a day (UTC) starts the next part.
    pub roll_daily: bool,
    /// What to do if the disk is full.
    pub when_full: FullName,
    /// Free space below which a warning is given once.
    pub warn_below_mb: u64,
    /// Free space below which the disk counts as full.
    pub reserve_mb: u64,
    /// Whether the daemon resumes an interrupted session when it starts.
    pub resume: bool,
    /// Largest age of an interrupted session's last frame at which the session is still resumed, h.
    pub resume_within_h: f64,
    /// Most resumptions of a session within an hour.
    pub resume_per_hour: u64,
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

impl Default for RecordSection {
    fn default() -> Self {
        Self {
            directory: None,
            transcripts: 8,
            group_ms: 0,
            roll_mb: 4000,
            roll_daily: false,
            when_full: FullName::Stop,
            warn_below_mb: 2000,
            reserve_mb: 200,
            resume: true,
            resume_within_h: 72.0,
            resume_per_hour: 6,
        }
    }
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

/// `[bus]`: the daemon's D-Bus connections.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BusSection {
    /// Whether a unix socket is served.
    pub peer: bool,
    /// Its path.
    pub peer_path: Option<PathBuf>,
    /// Whether the session bus is served.
    pub session: bool,
    /// Whether the system bus is served.
    pub system: bool,
}

impl Default for BusSection {
    fn default() -> Self {
        Self {
            peer: true,
            peer_path: None,
            session: false,
            system: false,
        }
    }
}

/// `[schedule]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScheduleSection {
    /// Whether a session starts with the daemon.
    pub start: bool,
    /// Period from start to start of frames, s; 0: back to back.
    pub every_s: Option<f64>,
    /// Number of frames.
    pub count: Option<u64>,
    /// Duration of the session, s.
    pub for_s: Option<f64>,
}

/// `[relay_wear]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelayWearSection {
    /// Rated closures of a relay.
    pub relay_life_cycles: Option<u64>,
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
        for path in paths.into_iter().flatten() {
            *path = folder.join(&*path);
        }
        if let Some(recording) = &mut self.recording {
            for path in [&mut recording.session, &mut recording.case]
                .into_iter()
                .flatten()
            {
                *path = folder.join(&*path);
            }
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
            for path in [&mut mqtt.ca, &mut mqtt.password_file]
                .into_iter()
                .flatten()
            {
                *path = folder.join(&*path);
            }
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
