//! The layout of a session file, for readers in other tools.
//!
//! An SQLite database, `application_id` 0x54616374 ("Tact"), `user_version` [`VERSION`]. While it is written it is in
//! WAL mode with `synchronous = EXTRA`; closing it leaves a single file in rollback mode, readable from a read-only
//! disk. Columns have their unit in their name: `_ns` and `_us` are nanoseconds and microseconds (wall times since
//! 1970 UTC), `_a` and `_v` amperes and volts. Electrodes are counted from 0. Pages have 512 bytes, so that the
//! commit of one row writes few bytes.
//!
//! | table | holds |
//! |---|---|
//! | `session` | one row: id, kind, start, build, seed (decimal text), configuration and its hash, model and geometry hash, protocol, instruments and modules (JSON), notes about the experiment (JSON), the options it was started with (JSON), the part that it continues and the sequence of its first frame; and, once closed, when, why, and the number of rows of each table (JSON), with a checksum of its own |
//! | `settings` | one row for each set of measuring settings of frames; measures against noise, offset and drift as JSON |
//! | `mapper` | one row for each method, model, build and CPU that made maps |
//! | `baseline` | the baseline in use: readings and deviations as [`crate::codec`] blobs |
//! | `reference` | means of sixteen frames, as [`crate::codec`] blobs, to which later frames are stored as differences |
//! | `stretch` | one row for frames taken in the same way: settings, mapper, whether simulated; and a first frame with its times and the period of the frames |
//! | `frame` | one row a frame: its times relative to its stretch, the location of its readings, readings of one or more frames as a blob of [`crate::codec`], quality flags (bits in the order of [`survey::QualityFlag`]), largest sum round the ring, rare data as JSON (readings that no load explains, driving electrodes in compliance), the trace of its map, big-endian in a number: the first 4 bytes of its hash, the 4 bytes (little-endian, single precision) of its [`survey::Map::signed_sum`]; 8 bytes of a hash if there is no sum; a text if the hash is not a SHA-256 |
//! | `taken` | a view: monotonic and wall time of each frame |
//! | `late_map` | the trace of a map that was computed after its frame had been written; numbered in the order of writing |
//! | `event` | time, kind (one word), text (one sentence) |
//!
//! Frames that were written with one sync share blobs, up to 32 each: the row of the first one holds the blob, and
//! the `place` of each row counts from there. In a row with a `place` above 0, `readings` and `reference` are NULL,
//! and the readings are frame `place` (from 0) of the blob in row `sequence - place`.
//!
//! `frame.reference` is the reference of the blob's differences: NULL none, 0 the baseline, n row n of `reference`,
//! which itself refers to nothing or to the baseline. Times of a frame are stored to the microsecond:
//!
//! - monotonic = stretch.monotonic + (sequence - stretch.sequence) x period + tick
//! - wall = stretch.wall + (sequence - stretch.sequence) x period + tick + skew
//!
//! Values that follow from the readings (the number of invalid readings, the largest difference of reciprocal
//! readings) are not stored.
//!
//! `checksum` is the beginning of the SHA-256 of the table's name, the header's checksum, the row's number and its
//! content: 4 bytes for frames and late maps, 8 for all others. A row that does not match its checksum is an error;
//! no value of it is returned. Rows of `event`, `reference`, `stretch`, `settings`, `mapper` and (column `number`)
//! `late_map` are numbered from 1 without a gap, frames from the header's first sequence: a row missing between two
//! others is therefore detected, and a row missing at the end is detected by the counts of the closing entry. In a
//! session that was not closed, rows missing at the end of a table are detected only if a later row refers to them.
//!
//! A file with any other table, view, trigger or index, or with other columns, is refused before any of its rows is
//! read.

use std::sync::OnceLock;

use rusqlite::{Connection, Row};

/// "Tact" in ASCII.
pub const APPLICATION_ID: i32 = 0x5461_6374;

/// Version of the layout; a file with another one is refused.
pub const VERSION: i64 = 1;

const TABLES: &str = "
CREATE TABLE session (
    only INTEGER PRIMARY KEY CHECK (only = 1),
    id TEXT NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('baseline', 'measurement')),
    started_ns INTEGER NOT NULL,
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)),
    build TEXT NOT NULL,
    seed TEXT,
    config_toml TEXT NOT NULL,
    config_hash TEXT NOT NULL,
    model_hash TEXT,
    geometry_hash TEXT,
    protocol TEXT NOT NULL,
    instruments TEXT NOT NULL,
    modules TEXT NOT NULL,
    note TEXT NOT NULL,
    about TEXT NOT NULL,
    asked TEXT NOT NULL,
    continues TEXT,
    first_sequence INTEGER NOT NULL CHECK (first_sequence > 0),
    checksum BLOB NOT NULL,
    closed_ns INTEGER,
    closed_reason TEXT,
    closed_tally TEXT,
    closed_checksum BLOB
) STRICT;
CREATE TABLE settings (
    id INTEGER PRIMARY KEY,
    protocol_hash TEXT NOT NULL,
    current_a REAL NOT NULL,
    range_v REAL NOT NULL,
    nplc REAL NOT NULL,
    settle_ns INTEGER NOT NULL,
    wiring TEXT NOT NULL,
    precautions TEXT NOT NULL,
    checksum BLOB NOT NULL
) STRICT;
CREATE TABLE mapper (
    id INTEGER PRIMARY KEY,
    method TEXT NOT NULL,
    model_hash TEXT,
    build TEXT NOT NULL,
    cpu TEXT NOT NULL,
    checksum BLOB NOT NULL
) STRICT;
CREATE TABLE baseline (
    only INTEGER PRIMARY KEY CHECK (only = 1),
    id TEXT NOT NULL,
    wall_ns INTEGER NOT NULL,
    frames INTEGER NOT NULL,
    settings INTEGER NOT NULL REFERENCES settings (id),
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)),
    readings BLOB NOT NULL,
    deviation BLOB NOT NULL,
    checksum BLOB NOT NULL
) STRICT;
CREATE TABLE reference (
    id INTEGER PRIMARY KEY,
    against_baseline INTEGER NOT NULL CHECK (against_baseline IN (0, 1)),
    readings BLOB NOT NULL,
    checksum BLOB NOT NULL
) STRICT;
CREATE TABLE stretch (
    id INTEGER PRIMARY KEY,
    settings INTEGER NOT NULL REFERENCES settings (id),
    mapper INTEGER REFERENCES mapper (id),
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)),
    sequence INTEGER NOT NULL,
    monotonic_us INTEGER NOT NULL,
    wall_us INTEGER NOT NULL,
    period_us INTEGER NOT NULL,
    checksum BLOB NOT NULL
) STRICT;
CREATE TABLE frame (
    sequence INTEGER PRIMARY KEY,
    stretch INTEGER NOT NULL REFERENCES stretch (id),
    tick_us INTEGER NOT NULL,
    skew_us INTEGER NOT NULL,
    duration_us INTEGER NOT NULL,
    reference INTEGER,
    flags INTEGER NOT NULL,
    loop_sum REAL,
    remarks TEXT,
    map_hash ANY,
    place INTEGER NOT NULL,
    readings BLOB,
    checksum INTEGER NOT NULL
) STRICT;
CREATE VIEW taken AS SELECT
    frame.sequence AS sequence,
    stretch.monotonic_us + (frame.sequence - stretch.sequence) * stretch.period_us + frame.tick_us AS monotonic_us,
    stretch.wall_us + (frame.sequence - stretch.sequence) * stretch.period_us + frame.tick_us + frame.skew_us AS wall_us,
    frame.duration_us AS duration_us
FROM frame JOIN stretch ON stretch.id = frame.stretch;
CREATE TABLE late_map (
    sequence INTEGER PRIMARY KEY REFERENCES frame (sequence),
    number INTEGER NOT NULL,
    mapper INTEGER NOT NULL REFERENCES mapper (id),
    map_hash ANY NOT NULL,
    checksum INTEGER NOT NULL
) STRICT;
CREATE TABLE event (
    id INTEGER PRIMARY KEY,
    at_ns INTEGER NOT NULL,
    kind TEXT NOT NULL,
    text TEXT NOT NULL,
    checksum BLOB NOT NULL
) STRICT;
";

/// Bytes of a page. A commit writes each page that it changes as a whole, so small pages reduce the bytes written;
/// most of a row is on pages that it fills alone.
pub(crate) const PAGE: u32 = 512;
/// Pages in the journal beyond which it is merged into the file: 2 MB, about 20 minutes at a frame a second.
pub(crate) const JOURNAL: u32 = 4000;

pub(crate) fn create_tables(connection: &Connection) -> rusqlite::Result<()> {
    connection.execute_batch(TABLES)?;
    connection.pragma_update(None, "application_id", APPLICATION_ID)?;
    connection.pragma_update(None, "user_version", VERSION)
}

/// An entry of `sqlite_schema`.
type Entry = [String; 4];

/// Describes how a file's tables differ from those of [`create_tables`]; `None` if they are equal.
pub(crate) fn difference(connection: &Connection) -> rusqlite::Result<Option<String>> {
    static LAYOUT: OnceLock<Vec<Entry>> = OnceLock::new();
    let layout = match LAYOUT.get() {
        Some(layout) => layout,
        None => {
            let model = Connection::open_in_memory()?;
            create_tables(&model)?;
            let made = entries(&model, usize::MAX)?;
            LAYOUT.get_or_init(|| made)
        }
    };
    let found = entries(connection, layout.len() + 1)?;
    let strange = found.iter().find(|entry| !layout.contains(entry));
    let missing = layout.iter().find(|entry| !found.contains(entry));
    Ok(match (strange, missing) {
        (Some([kind, name, ..]), _) => {
            let name: String = name.chars().take(64).collect();
            Some(format!(
                "its {kind} {name:?} is not one of layout {VERSION}"
            ))
        }
        (None, Some([kind, name, ..])) => Some(format!("it has no {kind} {name:?}")),
        (None, None) if found.len() != layout.len() => Some("it has a table twice".into()),
        (None, None) => None,
    })
}

fn entries(connection: &Connection, most: usize) -> rusqlite::Result<Vec<Entry>> {
    let most = i64::try_from(most).unwrap_or(i64::MAX);
    let entry = |row: &Row<'_>| -> rusqlite::Result<Entry> {
        // SQLite's automatic indexes have no SQL text
        let text = |column| {
            row.get::<_, Option<String>>(column)
                .map(Option::unwrap_or_default)
        };
        Ok([text(0)?, text(1)?, text(2)?, text(3)?])
    };
    connection
        .prepare("SELECT type, name, tbl_name, sql FROM sqlite_schema LIMIT ?1")?
        .query_map([most], entry)?
        .collect()
}
