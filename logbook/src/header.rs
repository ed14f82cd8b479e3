//! Types of a session file other than readings: header, events, map records, summaries.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use chrono::{DateTime, Utc};
use serde::{Deserialize, Serialize};
use survey::{Frame, Map, Protocol, Quality};

/// The kind of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SessionKind {
    /// Frames of the unloaded sheet, and their mean.
    Baseline,
    /// Frames against a baseline.
    Measurement,
}

impl SessionKind {
    /// As written in the file: `baseline` or `measurement`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Baseline => "baseline",
            Self::Measurement => "measurement",
        }
    }

    pub(crate) fn parse(text: &str) -> Option<Self> {
        [Self::Baseline, Self::Measurement]
            .into_iter()
            .find(|kind| kind.as_str() == text)
    }
}

impl fmt::Display for SessionKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// An instrument as found at the start of the session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct InstrumentRecord {
    /// `source`, `switch`, `voltmeter`, or the rig's name for it.
    pub role: String,
    /// Its whole reply to `*IDN?`.
    pub identity: String,
    /// Its address, or `simulated`.
    pub address: String,
}

/// Free-text notes about the experiment; empty where not given.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct About {
    /// The sheet: its number, its material.
    pub sheet: String,
    /// The foam below it, with its batch.
    pub foam: String,
    /// The ink, with its batch.
    pub ink: String,
    /// Who measured.
    pub operator: String,
    /// Notes on the wiring of the electrodes that the configuration does not contain.
    pub wiring: String,
    /// Calibration of the instruments.
    pub calibration: String,
}

impl About {
    /// The notes that were given, each with its name.
    pub fn entries(&self) -> impl Iterator<Item = (&'static str, &str)> {
        [
            ("sheet", &self.sheet),
            ("foam", &self.foam),
            ("ink", &self.ink),
            ("operator", &self.operator),
            ("wiring", &self.wiring),
            ("calibration", &self.calibration),
        ]
        .into_iter()
        .map(|(name, words)| (name, words.as_str()))
        .filter(|(_, words)| !words.is_empty())
    }
}

/// Metadata of a session; written once, before the first frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SessionHeader {
    /// Unique in its folder, `[a-z0-9_]+`; also the file's name.
    pub id: String,
    /// Its kind.
    pub kind: SessionKind,
    /// Wall time of the start.
    pub started: DateTime<Utc>,
    /// Every instrument with its identity.
    pub instruments: Vec<InstrumentRecord>,
    /// Modules found in the mainframe, one display text for each slot.
    pub modules: Vec<String>,
    /// The effective configuration.
    pub config_toml: String,
    /// SHA-256 of the effective configuration, hex.
    pub config_hash: String,
    /// SHA-256 of the model file used for maps.
    pub model_hash: Option<String>,
    /// Hash of the mesh used for maps.
    pub geometry_hash: Option<String>,
    /// The measurements, in the order of the readings.
    pub protocol: Protocol,
    /// Version and commit of the program.
    pub build: String,
    /// Random seed, if one is used.
    pub seed: Option<u64>,
    /// Whether the voltages come from a simulated sheet.
    pub simulated: bool,
    /// A note of the operator.
    pub note: String,
    /// Notes about the experiment.
    pub about: About,
    /// The options that the session was started with (JSON), for resuming it after a crash; empty if it is never
    /// resumed.
    pub asked: String,
    /// Id of the part that this one continues; `None` for a session's first part.
    pub continues: Option<String>,
    /// Sequence of the first frame: 1, or one more than the earlier part's last.
    pub first_sequence: u64,
}

impl SessionHeader {
    /// Id of the session that this file is a part of: its first part's.
    pub fn session(&self) -> &str {
        crate::files::part_of(&self.id).0
    }

    /// The header of a measurement with real instruments; the other fields are empty and may be set.
    pub fn new(id: impl Into<String>, started: DateTime<Utc>, protocol: Protocol) -> Self {
        Self {
            id: id.into(),
            kind: SessionKind::Measurement,
            started,
            instruments: Vec::new(),
            modules: Vec::new(),
            config_toml: String::new(),
            config_hash: String::new(),
            model_hash: None,
            geometry_hash: None,
            protocol,
            build: String::new(),
            seed: None,
            simulated: false,
            note: String::new(),
            about: About::default(),
            asked: String::new(),
            continues: None,
            first_sequence: 1,
        }
    }
}

/// Summary of a map: enough to verify that a recomputed map is the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MapRecord {
    /// [`survey::Map::hash`]; in a record read from a file only its first 8 digits, or 16 if there is no sum. Compare
    /// with [`MapRecord::is_of`].
    pub hash: String,
    /// [`survey::Map::signed_sum`], seeded with the first 8 digits of the hash, from which [`MapRecord::distance`]
    /// estimates the distance to a map of another build or processor. Kept only with a SHA-256.
    pub sum: Option<f32>,
    /// [`survey::Map::method`].
    pub method: String,
    /// SHA-256 of the model file, where the method has one.
    pub model_hash: Option<String>,
    /// The program that made it.
    pub build: String,
    /// CPU features that its arithmetic used.
    pub cpu: String,
}

impl MapRecord {
    /// The summary of a map.
    pub fn new(map: &Map, model_hash: Option<String>, build: String, cpu: String) -> Self {
        let hash = map.hash();
        Self {
            sum: seed(&hash).map(|seed| map.signed_sum(seed) as f32),
            hash,
            method: map.method.clone(),
            model_hash,
            build,
            cpu,
        }
    }

    /// Estimated distance of the recorded map from another one, relative to the other's length
    /// ([`survey::Map::distance`]), in single precision: differences below 1e-7 are not resolved. `None` if no sum was
    /// kept.
    pub fn distance(&self, other: &Map) -> Option<f64> {
        let (sum, seed) = (self.sum?, seed(&self.hash)?);
        // rounded as the kept sum was
        let kept = other.signed_sum(seed) as f32 == sum;
        Some(match kept {
            true => 0.0,
            false => other.distance(f64::from(sum), seed),
        })
    }

    /// Whether the kept part of the hash matches: two different maps match by chance once in 4e9.
    pub fn is_of(&self, hash: &str) -> bool {
        !self.hash.is_empty() && hash.starts_with(&self.hash)
    }
}

/// Seed of the signs of a map's sum.
fn seed(hash: &str) -> Option<u32> {
    u32::from_str_radix(hash.get(..8)?, 16).ok()
}

/// A frame as read from the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// The frame, its sequence counted from 1.
    pub frame: Frame,
    /// Its quality checks.
    pub quality: Quality,
    /// Its map, if one was made.
    pub map: Option<MapRecord>,
}

/// When a frame was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Taken {
    /// Wall time.
    pub wall: DateTime<Utc>,
    /// Monotonic time, by the clock of the recording process: it restarts after a reboot.
    pub monotonic: Duration,
}

/// An event of a session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// When.
    pub at: DateTime<Utc>,
    /// Machine-readable kind, such as `frame-failed`; all are listed in `docs/reference/events.md`.
    pub kind: String,
    /// Text for people.
    pub text: String,
}

/// How a session ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Closing {
    /// When.
    pub at: DateTime<Utc>,
    /// Why, in words.
    pub reason: String,
}

/// Summary of a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SessionSummary {
    /// Its id.
    pub id: String,
    /// Its file.
    pub path: PathBuf,
    /// Its kind.
    pub kind: SessionKind,
    /// When it began.
    pub started: DateTime<Utc>,
    /// Wall time of the last frame.
    pub last: Option<DateTime<Utc>>,
    /// Frames in it.
    pub frames: u64,
    /// Sequence of its first frame, even if there is no frame yet.
    pub first_sequence: u64,
    /// The part that it continues.
    pub continues: Option<String>,
    /// How it ended; `None` while it runs, or if its writer was killed.
    pub closed: Option<Closing>,
    /// Whether the voltages come from a simulated sheet.
    pub simulated: bool,
    /// Electrodes of the ring.
    pub electrodes: usize,
    /// Readings a frame.
    pub readings: usize,
    /// A note of the operator.
    pub note: String,
}

impl SessionSummary {
    /// Id of the session that this file is a part of: its first part's.
    pub fn session(&self) -> &str {
        crate::files::part_of(&self.id).0
    }
}
