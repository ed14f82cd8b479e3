//! Recorded sessions on the page: what the program that serves it must supply, the routes, and the history over all sessions.

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

    /// Opens a session of the list by its id; `None` if the list has none of this id, which is never taken for a path.
    ///
    /// # Errors
    /// A sentence: it cannot be read, or has no maps.
    fn open(&self, id: &str) -> Result<Option<Arc<dyn Playback>>, String>;

    /// All sheets of an archive, where the page has one.
    fn sheets(&self) -> Option<Arc<dyn Sheets>> {
        None
    }

    /// The running session with this id, for maps beside those of the daemon; `None` if it is not recorded here. It may take
    /// seconds.
    ///
    /// # Errors
    /// A sentence: it cannot be read, or has no maps.
    fn running(&self, id: &str) -> Result<Option<Arc<dyn RunningModel>>, String> {
        let _ = id;
        Ok(None)
    }

    /// The stored quantities of a region over all sessions, in at most so many spans, all of the newest unit. A place that
    /// stores none has none.
    ///
    /// # Errors
    /// A sentence: the folder cannot be read.
    fn history(&self, from_s: i64, to_s: i64, region: &str, spans: u32) -> Result<History, String> {
        let _ = (from_s, to_s, region, spans);
        Ok(History::default())
    }
}

/// An open session. Its methods may be called at the same time; a map takes as long as its method.
pub trait Playback: Send + Sync {
    /// What does not change while it is open.
    fn overview(&self) -> &Overview;

    /// The geometry of its maps.
    fn sheet(&self) -> &Sheet;

    /// Its quantities over time, as far as they are known by now, in spans such that there are at most so many.
    ///
    /// # Errors
    /// A sentence: they cannot be read.
    fn course(&self, spans: u32) -> Result<Course, String>;

    /// The map at a place.
    ///
    /// # Errors
    /// A sentence: the frame cannot be read or has no map, or the baseline was not followed so far yet.
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
    /// What happened, the oldest first.
    pub events: Vec<EventState>,
    /// Its named regions.
    pub regions: Vec<RegionShape>,
}

/// Quantities over time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Course {
    /// Share of the frames that were followed: 0 to 1.
    pub progress: f64,
    /// Why no more frames are followed.
    pub failed: Option<String>,
    /// Where the rows are from, as a sentence.
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

/// Which map is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapKind {
    /// At once: a fast method, compared with the nearest baseline that is kept.
    Quick,
    /// As the session's own method and baseline make it.
    Exact,
    /// Time without relief of each triangle, s.
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
    /// What is not exact about it, as a sentence; `None` for the exact map.
    pub provisional: Option<String>,
    /// The largest value by noise alone; `None` if unknown.
    pub noise: Option<f64>,
    /// What the tracked baseline says of the frame.
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
