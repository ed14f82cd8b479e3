//! Recorded frames as a source: a session of the logbook, or a table of frames in a case folder, with their baseline
//! (`first:N`, a file, or the session's own), signs and noise; and the tables of their maps. The daemon controls the
//! speed of playback.

mod case_folder;
mod error;
mod fitted;
mod indexed;
mod map_table;
mod readings;
mod recording;
mod session;

pub use case_folder::{BASELINE, FRAMES, FrameTable, PROVENANCE, Provenance, TableOptions};
pub use error::RecordedError;
pub use fitted::Fitted;
pub use indexed::IndexedFrames;
pub use map_table::{
    DeviationSummary, FRAMES_HEADING, MapCompanions, MapLine, MapOfRow, MapRow, WithoutMap,
    maps_heading, table_time, triangles_text,
};
pub use readings::{BaselineRule, LabelledReadings, Unloaded, read_frames};
pub use recording::{Origin, RecordedFrame, Recording, one_current};
pub use session::SessionParts;
