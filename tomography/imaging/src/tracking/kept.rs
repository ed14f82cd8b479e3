//! The state of a tracked baseline, stored next to the sessions, and its summary for users.

use chrono::{DateTime, Utc};
use std::path::Path;

use drift::DriftKinds;
use logbook::{LogbookError, StateKind};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use survey::Electrode;

use super::{TrackingState, numbers};

/// Reads the stored state of a baseline ([`KeptTracking`]), or the state with which a session began
/// ([`TrackingState`]); `None` if none is stored.
///
/// # Errors
/// A file that cannot be read or is damaged.
pub fn kept<T: DeserializeOwned>(folder: &Path, id: &str) -> Result<Option<T>, LogbookError> {
    kept_as(folder, id, StateKind::Tracking)
}

/// Stores the state of a baseline or session, in place of an earlier one.
///
/// # Errors
/// A disk error; the earlier state remains.
pub fn keep(folder: &Path, id: &str, what: &impl Serialize) -> Result<(), LogbookError> {
    keep_as(folder, id, StateKind::Tracking, what)
}

/// Reads a state of this kind from JSON; `None` if none is stored.
pub(crate) fn kept_as<T: DeserializeOwned>(
    folder: &Path,
    id: &str,
    kind: StateKind,
) -> Result<Option<T>, LogbookError> {
    let Some(text) = logbook::kept_state(folder, id, kind)? else {
        return Ok(None);
    };
    serde_json::from_str(&text)
        .map(Some)
        .map_err(|fault| LogbookError::Damaged {
            path: folder.to_owned(),
            place: format!("the state of {id}"),
            why: fault.to_string(),
        })
}

/// Stores a state of this kind as JSON.
pub(crate) fn keep_as(
    folder: &Path,
    id: &str,
    kind: StateKind,
    what: &impl Serialize,
) -> Result<(), LogbookError> {
    // a struct of numbers and strings can always be serialised
    let text = serde_json::to_string(what).unwrap_or_default();
    logbook::keep_state(folder, id, kind, &text)
}

/// The state of a tracked baseline after a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeptTracking {
    /// The session.
    pub session: String,
    /// The frame.
    pub sequence: u64,
    /// The state after that frame.
    pub state: TrackingState,
    /// The drift since the baseline by kind, for display; `None` if it could not be computed.
    #[serde(default)]
    pub drift: Option<DriftSummary>,
}

/// The drift since the baseline by kind: the most probable decomposition of the tracked drift.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DriftSummary {
    /// Change of the gain, %.
    pub gain_percent: f64,
    /// Change of the contacts' impedance, rms over the electrodes, %.
    pub contacts_percent: f64,
    /// The electrode whose contact changed most, from 1.
    pub most_changed_electrode: usize,
    /// Change of that electrode's contact impedance, %.
    pub most_changed_percent: f64,
    /// Smooth change of conductance, rms over the sheet, %.
    pub field_percent: f64,
    /// The largest local change of conductance, %.
    pub local_percent: f64,
    /// Position of that change, x and y, mm.
    pub local_at_mm: [f64; 2],
    /// Change of the readings by the gain, rms, uV.
    pub gain_uv: f64,
    /// Change of the readings by the contacts, rms, uV.
    pub contacts_uv: f64,
    /// Change of the readings by the smooth change of conductance, rms, uV.
    pub field_uv: f64,
    /// Change of the readings by the local change, rms, uV.
    pub local_uv: f64,
}

impl DriftSummary {
    pub(super) fn new(kinds: &DriftKinds) -> Self {
        let percent = |ln: f64| 100.0 * ln.exp_m1();
        let contacts = &kinds.contacts;
        let squares: f64 = contacts.iter().map(|change| change * change).sum();
        let by_size = |a: &(usize, f64), b: &(usize, f64)| a.1.abs().total_cmp(&b.1.abs());
        let most = contacts.iter().copied().enumerate().max_by(by_size);
        let (electrode, change) = most.unwrap_or_default();
        let data = &kinds.data_v;
        Self {
            gain_percent: percent(kinds.gain),
            contacts_percent: 100.0 * (squares / contacts.len().max(1) as f64).sqrt(),
            most_changed_electrode: Electrode(electrode).number(),
            most_changed_percent: percent(change),
            field_percent: 100.0 * kinds.field,
            local_percent: percent(kinds.local.change),
            local_at_mm: kinds.local.centre.map(|metres| 1e3 * metres),
            gain_uv: 1e6 * data.gain,
            contacts_uv: 1e6 * data.contact,
            field_uv: 1e6 * data.field,
            local_uv: 1e6 * data.local,
        }
    }
}

/// Summary of a tracked baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrackingSummary {
    /// The last session in which it was tracked.
    pub session: String,
    /// Sequence number of the last tracked frame.
    pub sequence: u64,
    /// Start of tracking.
    pub since: DateTime<Utc>,
    /// Time of that frame.
    pub until: DateTime<Utc>,
    /// When the sheet was last empty.
    pub empty: DateTime<Utc>,
    /// Number of loads on the sheet.
    pub loads: usize,
    /// Faulty electrodes whose readings are not used, counted from 1.
    pub masked: Vec<usize>,
    /// Change of the readings since the baseline, rms, uV.
    pub change_uv: f64,
    /// Standard deviation of the tracked baseline, rms, uV.
    pub baseline_sd_uv: f64,
    /// Rate of the drift relative to the built-in rates.
    pub pace: f64,
    /// The drift by kind; `None` if it could not be computed, or if an older version stored the state.
    #[serde(default)]
    pub drift: Option<DriftSummary>,
}

impl KeptTracking {
    /// The summary; `None` if a time is out of the range of dates.
    pub fn summary(&self) -> Option<TrackingSummary> {
        let tracker = &self.state.tracker;
        let date = |seconds: f64| DateTime::from_timestamp_micros((1e6 * seconds).round() as i64);
        let at_s = tracker.at_s();
        Some(TrackingSummary {
            session: self.session.clone(),
            sequence: self.sequence,
            since: date(self.state.began_s)?,
            until: date(at_s)?,
            empty: date(at_s - tracker.since_empty_s(at_s))?,
            loads: tracker.loads(),
            masked: numbers(&tracker.masked()),
            change_uv: 1e6 * tracker.change(),
            baseline_sd_uv: 1e6 * tracker.deviation(),
            pace: tracker.pace(),
            drift: self.drift.clone(),
        })
    }
}
