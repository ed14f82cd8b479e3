//! Recorded sessions on the page: the interface that the program serving the page must supply, the routes, and the
//! history over all sessions.

pub(crate) mod history;
pub(crate) mod routes;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use imaging::Tracked;
use imaging::quantities::{FrameQuantities, LoadUnit, QuantityRow, RegionShape};
use render::Sheet;
use serde::Serialize;

use crate::EventState;
use crate::running::RunningModel;
use crate::sheets::Sheets;

/// The recorded sessions.
pub trait Recordings: Send + Sync {
    /// All sessions.
    ///
    /// # Errors
    /// A sentence: the folder cannot be read.
    fn list(&self) -> Result<SessionList, String>;

    /// Opens a session of the list by its id; `None` if the list has no such id. An id is never used as a path.
    ///
    /// # Errors
    /// A sentence: it cannot be read, or has no maps.
    fn open(&self, id: &str) -> Result<Option<Arc<dyn Playback>>, String>;

    /// All sheets of an archive; `None` if the page has no archive.
    fn sheets(&self) -> Option<Arc<dyn Sheets>> {
        None
    }

    /// The running session with this id, for maps in addition to those of the daemon; `None` if it is not recorded
    /// here. The call may take seconds.
    ///
    /// # Errors
    /// A sentence: it cannot be read, or has no maps.
    fn running(&self, id: &str) -> Result<Option<Arc<dyn RunningModel>>, String> {
        let _ = id;
        Ok(None)
    }

    /// The stored quantities of a region over all sessions from `from_s` to `to_s` (s since 1970 UTC), in at most
    /// `spans` rows, all in the unit of the newest row. Empty if nothing is stored.
    ///
    /// # Errors
    /// A sentence: the folder cannot be read.
    fn history(&self, from_s: i64, to_s: i64, region: &str, spans: u32) -> Result<History, String> {
        let _ = (from_s, to_s, region, spans);
        Ok(History::default())
    }
}

/// An open session. Its methods may be called at the same time; the time for a map depends on its method.
pub trait Playback: Send + Sync {
    /// The properties that do not change while it is open.
    fn overview(&self) -> &Overview;

    /// The geometry of its maps.
    fn sheet(&self) -> &Sheet;

    /// Its quantities over time, as far as they are known by now, in at most `spans` rows.
    ///
    /// # Errors
    /// A sentence: they cannot be read.
    fn course(&self, spans: u32) -> Result<Course, String>;

    /// The map of the frame at a place.
    ///
    /// # Errors
    /// A sentence: the frame cannot be read or has no map, or the baseline has not been tracked that far yet.
    fn map(&self, place: Place, kind: MapKind) -> Result<PlayedMap, String>;
}

/// `/api/sessions`.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct SessionList {
    /// The newest first.
    pub sessions: Vec<SessionEntry>,
    /// Files and folders that cannot be read, a sentence each: their sessions are not in the list.
    pub left_out: Vec<String>,
}

/// A line of the list of sessions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SessionEntry {
    /// Its id.
    pub id: String,
    /// When it began, ms since 1970 UTC.
    pub started_ms: i64,
    /// Time of the last frame.
    pub last_ms: Option<i64>,
    /// Frames in it.
    pub frames: u64,
    /// Whether its voltages are simulated.
    pub simulated: bool,
    /// Whether it is closed.
    pub closed: bool,
    /// A note of the operator.
    pub note: String,
}

/// `/api/sessions/ID`, without the geometry.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Overview {
    /// Its id.
    pub id: String,
    /// A note of the operator.
    pub note: String,
    /// Whether its voltages are simulated.
    pub simulated: bool,
    /// Number of the first frame.
    pub first_frame: u64,
    /// Number of the last frame.
    pub last_frame: u64,
    /// Time of the first frame, ms since 1970 UTC.
    pub first_ms: i64,
    /// Time of the last frame.
    pub last_ms: i64,
    /// Its events, the oldest first.
    pub events: Vec<EventState>,
    /// Its named regions.
    pub regions: Vec<RegionShape>,
}

/// Quantities over time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Course {
    /// Share of the frames whose quantities are known: 0 to 1.
    pub progress: f64,
    /// Why the quantities of further frames are not computed.
    pub failed: Option<String>,
    /// The source of the rows, as a sentence.
    pub source: String,
    /// Rows of one length, the oldest first.
    pub rows: Vec<QuantityRow>,
    /// Their length, s.
    pub span_s: u32,
}

/// Stored quantities over all sessions.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct History {
    /// Rows of one length, the oldest first.
    pub rows: Vec<QuantityRow>,
    /// Their length, s.
    pub span_s: u32,
    /// Regions that have rows in this time.
    pub regions: Vec<String>,
    /// Stored rows that are damaged and left out.
    pub damaged: usize,
    /// Rows of the region that are in another unit than the newest and left out.
    pub other_unit: usize,
}

/// A place in a session.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    /// A frame, by its number.
    Frame(u64),
    /// The last frame up to this time, ms since 1970 UTC.
    Time(i64),
}

/// Kind of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapKind {
    /// A map of a fast method, compared with the nearest stored baseline; available at once.
    Quick,
    /// The map of the session's own method and baseline.
    Exact,
    /// Unrelieved time of each triangle, s.
    Unrelieved,
    /// Standard deviation of each triangle of the exact map; NaN if the frame gives no information about it.
    Deviation,
}

/// A map of a recorded frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlayedMap {
    /// Number of the frame.
    pub sequence: u64,
    /// Its time, ms since 1970 UTC.
    pub wall_ms: i64,
    /// The method.
    pub method: String,
    /// `kPa`, `lost share`, `s`, or [`crate::DEVIATION`].
    pub unit: &'static str,
    /// Why the map is not exact, as a sentence; `None` for the exact map.
    pub provisional: Option<String>,
    /// The largest value by noise alone; `None` if unknown.
    pub noise: Option<f64>,
    /// Result of the tracked baseline for the frame.
    pub tracked: Option<Tracked>,
    /// Quantities of the frame, without those that need the frames before it.
    pub quantities: Option<FrameQuantities>,
    /// One value a triangle.
    #[serde(skip)]
    pub values: Vec<f32>,
}

impl PlayedMap {
    /// The unit of a map as this page names it.
    pub fn unit_of(unit: LoadUnit) -> &'static str {
        match unit {
            LoadUnit::Pressure => "kPa",
            LoadUnit::RelativeLoss => "lost share",
        }
    }
}
