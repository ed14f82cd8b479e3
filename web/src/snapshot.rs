//! The latest state of the daemon, as the page reads it.

use std::collections::VecDeque;
use std::sync::Arc;

use serde::Serialize;
use serde_json::Value;
use tokio::sync::watch;

/// Maps that are kept for pages that are behind.
const MAPS: usize = 16;
/// Events that are kept.
const EVENTS: usize = 50;

/// The state that pages follow. Clones share it.
#[derive(Debug, Clone)]
pub struct Live(watch::Sender<Snapshot>);

/// What is known at one moment.
#[derive(Debug, Clone, Default)]
pub(crate) struct Snapshot {
    /// Counts changes.
    pub(crate) version: u64,
    pub(crate) state: State,
    /// Maps of the last frames, 4 bytes a triangle, by sequence.
    pub(crate) maps: VecDeque<(u64, Arc<[u8]>)>,
    /// Geometry of the maps; see `/api/geometry`.
    pub(crate) geometry: Option<Arc<str>>,
}

/// `/api/state`, and the data of each event of `/api/events`.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct State {
    /// Why there is no daemon, or no frames of the running session; `None` while all is well.
    pub(crate) trouble: Option<String>,
    pub(crate) daemon: Option<DaemonState>,
    pub(crate) session: Option<SessionState>,
    pub(crate) frame: Option<FrameState>,
    pub(crate) events: VecDeque<EventState>,
}

#[derive(Debug, Clone, Serialize)]
pub(crate) struct DaemonState {
    pub(crate) state: String,
    pub(crate) simulated: bool,
    pub(crate) source: String,
    pub(crate) source_state: String,
    pub(crate) method: String,
    pub(crate) baseline: String,
    pub(crate) baseline_age_s: Option<f64>,
    pub(crate) version: String,
    pub(crate) well: Option<bool>,
    pub(crate) troubles: Vec<String>,
    pub(crate) instruments: Vec<String>,
    pub(crate) disk_days: Option<f64>,
    pub(crate) last_error: Option<String>,
    /// The rig is lost: what, and since when.
    pub(crate) lost: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct SessionState {
    pub(crate) id: String,
    pub(crate) kind: String,
    pub(crate) state: String,
    pub(crate) frames: Option<u64>,
    pub(crate) failed: Option<u64>,
    pub(crate) dropped: Option<u64>,
    pub(crate) map_noise: Option<f64>,
    pub(crate) last_error: Option<String>,
}

/// The last frame with its map.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct FrameState {
    pub(crate) sequence: u64,
    /// ms since 1970 UTC.
    pub(crate) wall_ms: i64,
    pub(crate) simulated: bool,
    /// Records that were lost before it.
    pub(crate) gap: u64,
    /// Readings that are no voltages.
    pub(crate) missing: usize,
    pub(crate) readings: usize,
    /// Whether `/api/map/SEQUENCE` exists.
    pub(crate) map: bool,
    pub(crate) method: Option<String>,
    /// `kPa`, or `lost share`.
    pub(crate) unit: Option<&'static str>,
    /// As in `watch --json`.
    pub(crate) quality: Option<Value>,
    /// As in `watch --json`.
    pub(crate) tracked: Option<Value>,
    /// As in `watch --json`.
    pub(crate) quantities: Option<Value>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct EventState {
    /// ms since 1970 UTC.
    pub(crate) wall_ms: i64,
    pub(crate) kind: String,
    pub(crate) text: String,
}

impl Default for Live {
    fn default() -> Self {
        Self(watch::Sender::new(Snapshot::default()))
    }
}

impl Live {
    /// Changes the state and wakes every page.
    pub(crate) fn change(&self, change: impl FnOnce(&mut Snapshot)) {
        self.0.send_modify(|snapshot| {
            change(snapshot);
            snapshot.version += 1;
        });
    }

    pub(crate) fn subscribe(&self) -> watch::Receiver<Snapshot> {
        self.0.subscribe()
    }

    pub(crate) fn map(&self, sequence: u64) -> Option<Arc<[u8]>> {
        let snapshot = self.0.borrow();
        let (_, map) = snapshot.maps.iter().find(|(of, _)| *of == sequence)?;
        Some(Arc::clone(map))
    }

    pub(crate) fn geometry(&self) -> Option<Arc<str>> {
        self.0.borrow().geometry.clone()
    }
}

impl Snapshot {
    pub(crate) fn keep_map(&mut self, sequence: u64, values: &[f32]) {
        let bytes: Vec<u8> = values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        self.maps.retain(|(of, _)| *of != sequence);
        self.maps.push_back((sequence, bytes.into()));
        if self.maps.len() > MAPS {
            self.maps.pop_front();
        }
    }

    pub(crate) fn add_event(&mut self, event: EventState) {
        self.state.events.push_front(event);
        self.state.events.truncate(EVENTS);
    }

    /// The state as JSON.
    pub(crate) fn json(&self) -> String {
        // numbers, words and JSON: they have a text
        serde_json::to_string(&self.state).unwrap_or_default()
    }
}
