//! Frames that were measured before, as a source: a session of the logbook, or a table of frames in a case folder, with
//! their baseline (`first:N`, a file, or the session's own), signs and noise. How fast they are played is the daemon's
//! own matter.

mod case_folder;
mod error;
mod fitted;
mod indexed;
mod readings;
mod recording;
mod session;

pub use case_folder::{BASELINE, FRAMES, FrameTable, PROVENANCE, Provenance, TableOptions};
pub use error::RecordedError;
pub use fitted::Fitted;
pub use indexed::IndexedFrames;
pub use readings::{BaselineRule, LabelledReadings, Unloaded, read_frames};
pub use recording::{Origin, RecordedFrame, Recording};
pub use session::SessionParts;
