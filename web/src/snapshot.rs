//! The latest state of the daemon, as the page and the terminal's dashboard read it.

use std::collections::VecDeque;
use std::sync::Arc;

use dbus::json::Alarm;
use serde::Serialize;
use serde_json::Value;
use tokio::sync::watch;

use crate::answer::bytes;
use crate::running::ProvisionalMap;

/// Maps that are kept for pages that lag behind.
const MAPS: usize = 16;
/// Events that are kept.
const EVENTS: usize = 50;

/// The state that pages follow. Clones share it.
#[derive(Debug, Clone)]
pub struct Live(watch::Sender<Snapshot>);

/// The known state at one moment.
#[derive(Debug, Clone, Default)]
pub struct Snapshot {
    /// Counts changes.
    pub(crate) version: u64,
    /// The state as words and numbers.
    pub state: State,
    /// Maps of the last frames, 4 bytes a triangle, by sequence.
    pub(crate) maps: VecDeque<(u64, Arc<[u8]>)>,
    /// The map of a frame that is shown until the map of the session's own method arrives.
    pub(crate) provisional: Option<(u64, Arc<[u8]>)>,
    /// Readings of the last frame, V, with its sequence; `None` for a missing one.
    pub(crate) readings: Option<(u64, Arc<[Option<f64>]>)>,
    /// Geometry of the maps.
    pub geometry: Option<Arc<dbus::Geometry>>,
}

/// `/api/state`, without its version.
#[derive(Debug, Clone, Default, Serialize)]
pub struct State {
    /// Why there is no daemon, or why the frames of the running session cannot be read; `None` without a problem.
    pub trouble: Option<String>,
    /// `None` while there is no connection to a daemon.
    pub daemon: Option<DaemonState>,
    /// The running session.
    pub session: Option<SessionState>,
    /// Its last frame.
    pub frame: Option<FrameState>,
    /// All alarms as in `alarms --json`, by name.
    pub alarms: Vec<Alarm>,
    /// Whether the page may command the daemon.
    pub control: bool,
    /// Events since the connection was made, the newest first.
    pub events: VecDeque<EventState>,
}

/// State and health of the daemon; texts are empty where there is nothing to report.
#[derive(Debug, Clone, Default, Serialize)]
pub struct DaemonState {
    /// State, a word.
    pub state: String,
    /// Whether voltages are simulated.
    pub simulated: bool,
    /// Source of frames.
    pub source: String,
    /// Whether the source can be used.
    pub source_state: String,
    /// Method of reconstruction.
    pub method: String,
    /// Id of the baseline.
    pub baseline: String,
    /// Its age, s.
    pub baseline_age_s: Option<f64>,
    /// Warnings about it, a sentence each.
    pub baseline_remarks: Vec<String>,
    /// Version of the daemon.
    pub version: String,
    /// Whether no problem is present.
    pub well: Option<bool>,
    /// The present problems, as `kind: sentence`.
    pub troubles: Vec<String>,
    /// Instruments and their states, as `role: state`.
    pub instruments: Vec<String>,
    /// Days until the disk is full.
    pub disk_days: Option<f64>,
    /// The last error.
    pub last_error: Option<String>,
    /// The lost instruments; `None` while all are connected.
    pub lost: Option<String>,
}

/// The running session.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct SessionState {
    /// Its id.
    pub id: String,
    /// `measurement` or `baseline`.
    pub kind: String,
    /// State, a word.
    pub state: String,
    /// Frames acquired.
    pub frames: Option<u64>,
    /// Frames that failed.
    pub failed: Option<u64>,
    /// Frames that missed their time.
    pub dropped: Option<u64>,
    /// The largest relative loss by noise alone.
    pub map_noise: Option<f64>,
    /// Its last error.
    pub last_error: Option<String>,
}

/// The last frame with its map.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct FrameState {
    /// Its number in the session.
    pub sequence: u64,
    /// ms since 1970 UTC.
    pub wall_ms: i64,
    /// Whether its voltages are simulated.
    pub simulated: bool,
    /// Records that were lost before it.
    pub gap: u64,
    /// Missing readings.
    pub missing: usize,
    /// Its readings.
    pub readings: usize,
    /// Whether `/api/map/SEQUENCE` exists; with `provisional`, `/api/provisional/SEQUENCE`.
    pub map: bool,
    /// Why the map is not exact, as a sentence; `None` for the map of the session's own method.
    pub provisional: Option<String>,
    /// Method of the map.
    pub method: Option<String>,
    /// `kPa`, or `lost share`.
    pub unit: Option<&'static str>,
    /// The largest relative loss of the map, also where its unit is kPa.
    pub largest_loss: Option<f64>,
    /// As in `watch --json`.
    pub quality: Option<Value>,
    /// As in `watch --json`.
    pub tracked: Option<Value>,
    /// As in `watch --json`.
    pub quantities: Option<Value>,
}

/// An event of the daemon.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EventState {
    /// ms since 1970 UTC.
    pub wall_ms: i64,
    /// Its kind, a word.
    pub kind: String,
    /// A sentence.
    pub text: String,
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

    /// Sets whether pages may command the daemon. Must be called before a page follows.
    pub(crate) fn set_control(&self, control: bool) {
        self.0
            .send_modify(|snapshot| snapshot.state.control = control);
    }

    /// The state, and a signal at each change.
    pub fn subscribe(&self) -> watch::Receiver<Snapshot> {
        self.0.subscribe()
    }

    /// Shows a map of a frame until the map of the session's own method arrives; does nothing if that map is there
    /// already, or if a later frame or another session is current.
    pub(crate) fn show_provisional(&self, session: &str, sequence: u64, made: ProvisionalMap) {
        self.0.send_if_modified(|snapshot| {
            if snapshot.session() != session {
                return false;
            }
            let frame = snapshot.state.frame.as_mut();
            let Some(frame) = frame.filter(|frame| frame.sequence == sequence && !frame.map) else {
                return false;
            };
            frame.map = true;
            frame.method = Some(made.method);
            frame.unit = Some(made.unit);
            frame.provisional = Some(made.provisional);
            snapshot.provisional = Some((sequence, bytes(&made.values).into()));
            snapshot.version += 1;
            true
        });
    }

    pub(crate) fn provisional(&self, sequence: u64) -> Option<OfSession<Arc<[u8]>>> {
        let snapshot = self.0.borrow();
        let (of, map) = snapshot.provisional.as_ref()?;
        (*of == sequence).then(|| snapshot.of_session(Arc::clone(map)))
    }

    pub(crate) fn map(&self, sequence: u64) -> Option<OfSession<Arc<[u8]>>> {
        let snapshot = self.0.borrow();
        let (_, map) = snapshot.maps.iter().find(|(of, _)| *of == sequence)?;
        Some(snapshot.of_session(Arc::clone(map)))
    }

    pub(crate) fn geometry(&self) -> Option<OfSession<Arc<dbus::Geometry>>> {
        let snapshot = self.0.borrow();
        let geometry = snapshot.geometry.as_ref()?;
        Some(snapshot.of_session(Arc::clone(geometry)))
    }
}

/// Data with the id of the session in the state at the same moment; empty if there is none.
pub(crate) type OfSession<T> = (String, T);

impl Snapshot {
    /// The values of a frame's map, one a triangle, in the frame's unit; `None` if it is not kept any more.
    pub fn map_values(&self, sequence: u64) -> Option<Vec<f32>> {
        let (_, map) = self.maps.iter().find(|(of, _)| *of == sequence)?;
        let (values, _) = map.as_chunks();
        Some(
            values
                .iter()
                .map(|bytes| f32::from_le_bytes(*bytes))
                .collect(),
        )
    }

    /// Keeps the map of a frame, one value a triangle, and drops the oldest.
    pub fn keep_map(&mut self, sequence: u64, values: &[f32]) {
        self.maps.retain(|(of, _)| *of != sequence);
        self.maps.push_back((sequence, bytes(values).into()));
        if self.maps.len() > MAPS {
            self.maps.pop_front();
        }
    }

    /// Sets the session that runs now. If another one begins, frame and maps are dropped; those of an ended session
    /// stay until then.
    pub(crate) fn set_session(&mut self, session: Option<SessionState>) {
        let begins = session.as_ref();
        if begins.is_some_and(|session| session.id != self.session()) {
            self.forget_frames();
        }
        self.state.session = session;
    }

    /// Drops the last frame and all maps.
    pub(crate) fn forget_frames(&mut self) {
        self.maps.clear();
        self.provisional = None;
        self.readings = None;
        self.state.frame = None;
    }

    /// Id of the session in the state; empty if there is none.
    fn session(&self) -> &str {
        let session = self.state.session.as_ref();
        session.map_or("", |session| &session.id)
    }

    fn of_session<T>(&self, found: T) -> OfSession<T> {
        (self.session().to_owned(), found)
    }

    pub(crate) fn add_event(&mut self, event: EventState) {
        self.state.events.push_front(event);
        self.state.events.truncate(EVENTS);
    }

    /// The state with its version as JSON.
    pub(crate) fn json(&self) -> String {
        #[derive(Serialize)]
        struct Numbered<'a> {
            version: u64,
            #[serde(flatten)]
            state: &'a State,
        }
        let numbered = Numbered {
            version: self.version,
            state: &self.state,
        };
        // cannot fail: the state consists of numbers, texts and JSON values
        serde_json::to_string(&numbered).unwrap_or_default()
    }
}
