//! Session files: sessions, baselines, frames, events.
//!
//! One SQLite file for each session, `<id>.tactus`, in one folder. When [`SessionWriter::append`] returns, the frame
//! is on disk: it survives `kill -9` and, if the disk honours syncs, a power cut. Voltages are recorded to the last
//! bit. Maps are recorded without their values: only a hash, a checksum and the origin ([`MapRecord`]). The crate
//! reads no clock (time is passed in), depends on no instrument or mathematics, and refuses numbers that are not
//! finite.
//!
//! - **session**: one run of measurement, or the recording of a **baseline**; its **header** holds its settings and
//!   origin
//! - **frame record**: a frame as read from the file, with its quality and the hash of its map
//! - **event**: an occurrence to be found later, with its time
//! - **part**: one file of a session that was rolled over; it names the part that it continues
//! - **daemon log**: events that belong to no session, as lines of JSON, bounded in size
//! - **index**: cached summaries of the sessions of a folder
//! - **closed**: how a session ended; a session whose writer was killed has no such entry, but is readable
//!
//! [`SessionWriter::resume`] continues after a crash, [`SessionWriter::roll`] in the next part,
//! [`SessionWriter::successor`] after an I/O error; [`verify`](fn@verify), [`repair`](fn@repair) and
//! [`prune`](fn@prune) maintain a folder of sessions.
//!
//! The layout of the file is in [`schema`], that of a frame's readings in [`codec`].
//!
//! ```
//! # use std::time::Duration;
//! # use chrono::DateTime;
//! # use survey::{Amps, Frame, Protocol, Reading, Settings, Volts};
//! use logbook::{SessionHeader, SessionReader, SessionWriter};
//!
//! # let folder = tempfile::tempdir()?;
//! # let at = DateTime::UNIX_EPOCH;
//! let protocol = Protocol::sheffield(4)?;
//! # let settings = Settings { protocol_hash: protocol.hash(), current: Amps(1e-3), range: Volts(1.0), nplc: 1.0,
//! #     settle: Duration::ZERO, wiring: "w".into(), precautions: Default::default() };
//! let frame = Frame {
//!     readings: vec![Reading::Ok(Volts(0.1234567)), Reading::Ok(Volts(-0.2)), Reading::Overload, Reading::NotMeasured],
//! #   sequence: 0, monotonic: Duration::ZERO, wall: at, duration: Duration::ZERO, settings, compliance: vec![], extra: vec![],
//! #   simulated: true,
//!     // when, how long, with which settings
//! };
//! let mut writer = SessionWriter::create(folder.path(), &SessionHeader::new("monday", at, protocol))?;
//! assert_eq!(writer.append(&frame, None)?, 1);
//! writer.close(at, "asked to stop")?;
//!
//! let session = SessionReader::open(logbook::find(folder.path(), "mon")?)?;
//! assert_eq!(session.frame(1)?.frame.readings, frame.readings);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod codec;
mod daemon_log;
mod directory;
mod error;
mod files;
mod header;
mod maintenance;
mod quantities;
mod reader;
mod row;
mod run_time;
pub mod schema;
mod states;
mod writer;

pub use crate::daemon_log::{DaemonLog, read_daemon_log};
pub use crate::directory::index::Index;
pub use crate::directory::lock::{StateLock, lock};
pub use crate::directory::{Listing, Unreadable, find, interrupted, list};
pub use crate::error::{DiskFault, LogbookError};
pub use crate::files::{part_of, parts};
pub use crate::maintenance::leftovers::{TidyReport, merge_closed};
pub use crate::maintenance::prune::{
    ExportMarker, KeptSession, Pruned, Removed, Retention, exported, folder_bytes, mark_exported,
    prune, prune_each,
};
pub use crate::maintenance::receipts::{
    ArchiveReceipt, archived, mark_archived, receipt, sha256_of,
};
pub use crate::maintenance::repair::{CUT, LostFrames, Repaired, repair};
pub use crate::maintenance::verify::{Finding, Gap, Verified, verify};
pub use crate::writer::size::{Volume, volume};
pub use header::{
    About, Closing, Event, FrameRecord, InstrumentRecord, MapRecord, SessionHeader, SessionKind,
    SessionSummary, Taken,
};
pub use outfile::folder_of;
pub use quantities::{
    QuantityLine, QuantityLines, append_quantities, quantities_file, quantity_lines,
};
pub use reader::{Frames, SessionReader};
pub use run_time::time_run;
pub use states::{StateKind, keep_state, kept_state};
pub use writer::{CONTINUED, RESUMED, Resumed, SessionWriter, Storage};
