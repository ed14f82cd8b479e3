use serde::Serialize;

use super::{Health, nonempty};

/// The line of `tactus status --json`.
#[derive(Debug, Serialize)]
pub struct Status {
    /// `idle`, `baseline`, `acquiring`, `testing`, `suspended`, `faulted`.
    pub state: String,
    /// Whether voltages come from a simulated sheet.
    pub simulated: bool,
    /// `rig` or `recording`.
    pub source: String,
    /// Description of the configured method.
    pub method: String,
    /// Id of the current baseline.
    pub baseline: Option<String>,
    /// Warnings about it; empty until they are known.
    pub baseline_remarks: Vec<String>,
    /// The running session.
    pub session: Option<Running>,
    /// `off` (verified), `in use`, `unknown`.
    pub source_state: String,
    /// Reconnection of a lost rig.
    pub recovery: Option<Recovery>,
    /// Directory of the session files.
    pub record_directory: String,
    /// Why the daemon is faulted.
    pub last_error: Option<String>,
    /// Version of the daemon.
    pub version: String,
    /// Address of the daemon.
    pub bus: String,
    /// The daemon's health.
    pub health: Health,
}

/// A lost rig that the daemon tries to reconnect.
#[derive(Debug, Serialize)]
pub struct Recovery {
    /// The lost instruments.
    pub what: String,
    /// Attempts so far.
    pub tries: u64,
    /// Time until the next attempt, s; `None` while one is running.
    pub next_s: Option<f64>,
    /// Whether a user must accept the instruments first.
    pub person: bool,
}

impl Recovery {
    /// `None` if nothing is lost.
    pub fn from(reported: crate::Recovery) -> Option<Self> {
        Some(Self {
            what: reported.what?,
            tries: reported.tries.unwrap_or(0),
            next_s: reported.next_s,
            person: reported.person.unwrap_or(false),
        })
    }
}

/// A running session.
#[derive(Debug, Serialize)]
pub struct Running {
    /// Its id.
    pub id: String,
    /// `baseline` or `measurement`.
    pub kind: String,
    /// `running`, `suspended`, `ended`, `faulted`.
    pub state: String,
    /// Frames from the rig or recording.
    pub frames_acquired: u64,
    /// Frames on disk.
    pub frames_durable: u64,
    /// Frames that missed their scheduled time, or that the disk refused.
    pub frames_dropped: u64,
    /// Frames that failed.
    pub frames_failed: u64,
    /// Why the session is faulted, or why the last frame has no map.
    pub last_error: Option<String>,
    /// The last map.
    pub map: Option<MapSummary>,
}

/// The last map and its computing times.
#[derive(Debug, Serialize)]
pub struct MapSummary {
    /// Number of its frame.
    pub sequence: u64,
    /// `kPa` with a calibration, otherwise relative.
    pub unit: &'static str,
    /// Largest relative loss of conductance.
    pub largest_loss: Option<f64>,
    /// Whether that is larger than `noise`.
    pub significant: Option<bool>,
    /// The largest loss caused by noise alone.
    pub noise: Option<f64>,
    /// Total load, N.
    pub newtons: Option<f64>,
    /// Largest pressure, kPa.
    pub largest_kpa: Option<f64>,
    /// `sound`, `doubtful` or `unreliable`.
    pub quality: Option<String>,
    /// Why it is not sound.
    pub doubts: Option<String>,
    /// Whether the map can be relied on according to the tracked baseline.
    pub known: Option<bool>,
    /// Computing time, s.
    pub reconstruction_s: Option<f64>,
    /// Time from the last reading until the frame was on disk, s.
    pub durable_s: Option<f64>,
}

/// Unit of the maps of a calibrated method.
const CALIBRATED: &str = "kPa";
/// Unit of the maps of a method without calibration.
const RELATIVE: &str = "relative loss of conductance";

impl MapSummary {
    /// `None` before the first map, and for a baseline session.
    fn from(status: &crate::SessionStatus) -> Option<Self> {
        let map = status.map.as_ref()?;
        Some(Self {
            sequence: status.map_sequence?,
            unit: match map.newtons {
                Some(_) => CALIBRATED,
                None => RELATIVE,
            },
            largest_loss: map.largest_loss,
            significant: map.significant,
            noise: map.noise,
            newtons: map.newtons,
            largest_kpa: map.largest_kpa,
            quality: map.quality.clone(),
            doubts: map.doubts.clone(),
            known: map.known,
            reconstruction_s: map.reconstruction_s,
            durable_s: map.durable_s,
        })
    }
}

impl From<crate::SessionStatus> for Running {
    fn from(status: crate::SessionStatus) -> Self {
        Self {
            map: MapSummary::from(&status),
            id: status.id.unwrap_or_default(),
            kind: status.kind.unwrap_or_default(),
            state: status.state.unwrap_or_default(),
            frames_acquired: status.frames_acquired.unwrap_or(0),
            frames_durable: status.frames_durable.unwrap_or(0),
            frames_dropped: status.frames_dropped.unwrap_or(0),
            frames_failed: status.frames_failed.unwrap_or(0),
            last_error: status.last_error.and_then(nonempty),
        }
    }
}

impl Status {
    /// The status that the daemon at the address `bus` reported.
    pub fn from(status: crate::Status, bus: String) -> Self {
        Self {
            state: status.state.unwrap_or_default(),
            simulated: status.simulated.unwrap_or(false),
            source: status.source.unwrap_or_default(),
            method: status.method.unwrap_or_default(),
            baseline: status.baseline_id.and_then(nonempty),
            baseline_remarks: status.baseline_remarks.unwrap_or_default(),
            session: status.session.map(Running::from),
            source_state: status.source_state.unwrap_or_default(),
            recovery: status.recovery.and_then(Recovery::from),
            record_directory: status.record_directory.unwrap_or_default(),
            last_error: status.last_error.and_then(nonempty),
            version: status.version.unwrap_or_default(),
            bus,
            health: status.health.unwrap_or_default().into(),
        }
    }
}
