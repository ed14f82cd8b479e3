//! What is kept beside the readings.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use chrono::{DateTime, Utc};
use serde::{Deserialize, Serialize};
use survey::{Frame, Map, Protocol, Quality};

/// What a session was for.
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

/// One instrument as it was found when the session began.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct InstrumentRecord {
    /// `source`, `switch`, `voltmeter`, or what the rig calls it.
    pub role: String,
    /// Its whole reply to `*IDN?`.
    pub identity: String,
    /// Where it was reached, or `simulated`.
    pub address: String,
}

/// What a lab needs to know later, in free words; what nobody said is empty.
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
    /// How the electrodes were wired, beyond what the configuration says.
    pub wiring: String,
    /// With which calibration the instruments stood.
    pub calibration: String,
}

impl About {
    /// What was said, each with its name.
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

/// With what a session is taken; written once, before the first frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SessionHeader {
    /// Unique in its folder, `[a-z0-9_]+`; also the file's name.
    pub id: String,
    /// What it is for.
    pub kind: SessionKind,
    /// Wall time of the beginning.
    pub started: DateTime<Utc>,
    /// Every instrument with its identity.
    pub instruments: Vec<InstrumentRecord>,
    /// Modules found in the mainframe, one entry a slot, as a person reads them.
    pub modules: Vec<String>,
    /// The effective configuration.
    pub config_toml: String,
    /// SHA-256 of the effective configuration, hex.
    pub config_hash: String,
    /// SHA-256 of the model file that maps are made with.
    pub model_hash: Option<String>,
    /// Hash of the mesh that maps are made on.
    pub geometry_hash: Option<String>,
    /// The questions asked, in the order of the readings.
    pub protocol: Protocol,
    /// Version and commit of the program.
    pub build: String,
    /// Seed of everything random, where there is such a thing.
    pub seed: Option<u64>,
    /// Whether the voltages come from a simulated sheet.
    pub simulated: bool,
    /// What a person wants remembered.
    pub note: String,
    /// What a lab needs to know later.
    pub about: About,
    /// The options that the session was started with (JSON), so that it can be resumed after a crash; empty where
    /// nobody will.
    pub asked: String,
    /// The part that this one goes on from, by its id; `None` for a session's first part.
    pub continues: Option<String>,
    /// Sequence of the first frame: 1, or one more than the earlier part's last.
    pub first_sequence: u64,
}

impl SessionHeader {
    /// Id of the session that this file is a part of: its first part's.
    pub fn session(&self) -> &str {
        crate::files::part_of(&self.id).0
    }

    /// A measurement of real instruments about which nothing else is known yet; fill in the rest by field.
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

/// The trace a map leaves: enough to verify that recomputing it gives the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MapRecord {
    /// [`survey::Map::hash`]; a record that comes back has its first 8 digits, 16 where it has no sum.
    /// [`MapRecord::is_of`] compares.
    pub hash: String,
    /// [`survey::Map::signed_sum`], its seed the first 8 digits of the hash: [`MapRecord::distance`] says how far a map of
    /// another build or processor is from this one. Kept beside a SHA-256 only.
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
    /// The trace of a map.
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

    /// How far the map that left this trace is from another one, relative to the other's length, as far as one sum tells
    /// it ([`survey::Map::distance`]); in single precision, so nothing below 1e-7 is seen. `None` where none was kept.
    pub fn distance(&self, other: &Map) -> Option<f64> {
        let (sum, seed) = (self.sum?, seed(&self.hash)?);
        // as it would have been kept
        let kept = other.signed_sum(seed) as f32 == sum;
        Some(match kept {
            true => 0.0,
            false => other.distance(f64::from(sum), seed),
        })
    }

    /// Whether this is the trace of the map with that hash, as far as it was kept: two maps that differ pass for the same
    /// once in 4e9.
    pub fn is_of(&self, hash: &str) -> bool {
        !self.hash.is_empty() && hash.starts_with(&self.hash)
    }
}

/// What draws the signs of a map's sum.
fn seed(hash: &str) -> Option<u32> {
    u32::from_str_radix(hash.get(..8)?, 16).ok()
}

/// A frame as it comes back from the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The frame, its sequence counted from 1.
    pub frame: Frame,
    /// What its readings say about it.
    pub quality: Quality,
    /// Its map, if one was made.
    pub map: Option<MapRecord>,
}

/// When a frame was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Taken {
    /// Wall time.
    pub wall: DateTime<Utc>,
    /// Monotonic time, of the clock of its own process: after a reboot it begins anew.
    pub monotonic: Duration,
}

/// Something worth finding later.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// When.
    pub at: DateTime<Utc>,
    /// One word for a machine: `started`, `compliance`, `link_lost`.
    pub kind: String,
    /// A sentence for a person.
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

/// A session in one line of a list.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SessionSummary {
    /// Its id.
    pub id: String,
    /// Its file.
    pub path: PathBuf,
    /// What it was for.
    pub kind: SessionKind,
    /// When it began.
    pub started: DateTime<Utc>,
    /// Wall time of the last frame.
    pub last: Option<DateTime<Utc>>,
    /// Frames in it.
    pub frames: u64,
    /// Sequence of its first frame, whether or not it is there yet.
    pub first_sequence: u64,
    /// The part that it goes on from.
    pub continues: Option<String>,
    /// How it ended; `None` while it runs, or when its writer was killed.
    pub closed: Option<Closing>,
    /// Whether the voltages come from a simulated sheet.
    pub simulated: bool,
    /// Electrodes of the ring.
    pub electrodes: usize,
    /// Readings a frame.
    pub readings: usize,
    /// What a person wanted remembered.
    pub note: String,
}

impl SessionSummary {
    /// Id of the session that this file is a part of: its first part's.
    pub fn session(&self) -> &str {
        crate::files::part_of(&self.id).0
    }
}
