//! Reading a session: closed, or left behind by a writer that was killed, or still being written.

mod frames;
mod order;

use std::cell::OnceCell;
use std::path::{Path, PathBuf};
use std::time::Duration;

use chrono::{DateTime, Utc};
use rusqlite::{Connection, OpenFlags, OptionalExtension};
use survey::{Amps, Baseline, Checks, Settings, Volts};

use crate::codec::Reference;
use crate::row::{HeaderFault, baseline_checksum, event_checksum, header_row};
use crate::{Closing, Event, LogbookError, SessionHeader, SessionSummary, Taken, codec, schema};

pub use frames::Frames;
pub(crate) use order::SMALLEST;

/// A session's file, opened for reading; it is never changed.
#[derive(Debug)]
pub struct SessionReader {
    connection: Connection,
    path: PathBuf,
    header: SessionHeader,
    closed: Option<Closing>,
    /// Made when the first frame is read.
    checks: OnceCell<Checks>,
}

impl SessionReader {
    /// Opens a session file. What a killed writer has left in the journal beside it is part of the session.
    ///
    /// # Errors
    /// No such file, not a session, a newer schema, or damage to the header.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, LogbookError> {
        let path = path.as_ref().to_owned();
        // SQLite says "unable to open" for everything; the system says why. Asked about, never opened: to close a file that
        // SQLite has open in this process, too, would drop the locks of its writer.
        std::fs::metadata(&path).map_err(|source| LogbookError::Io {
            path: path.clone(),
            attempt: "open",
            source,
        })?;
        undo_half_a_change(&path);
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(&path, flags)
            .map_err(|source| LogbookError::reading(&path, "read the header of", source))?;
        Self::over(connection, path)
    }

    /// Reads the header through a connection that is there.
    pub(crate) fn over(connection: Connection, path: PathBuf) -> Result<Self, LogbookError> {
        let failed = |source| LogbookError::reading(&path, "read the header of", source);
        let number = |name: &str| -> Result<i64, LogbookError> {
            connection
                .pragma_query_value(None, name, |row| row.get(0))
                .map_err(failed)
        };
        if number("application_id")? != i64::from(schema::APPLICATION_ID) {
            return Err(LogbookError::NotASession {
                path,
                why: "its application id is another (or its writer was killed before the header was written)"
                    .into(),
            });
        }
        let has = number("user_version")?;
        if has != schema::VERSION {
            return Err(LogbookError::OtherSchema {
                path,
                has,
                reads: schema::VERSION,
            });
        }
        let row = connection
            .query_row("SELECT * FROM session", [], |row| Ok(header_row(row)))
            .map_err(failed)?;
        let (header, closed) = match row {
            Ok(read) => read,
            Err(HeaderFault::Store(source)) => return Err(failed(source)),
            Err(HeaderFault::Content(why)) => {
                return Err(LogbookError::Damaged {
                    path,
                    place: "its header".into(),
                    why,
                });
            }
        };
        Ok(Self {
            connection,
            path,
            header,
            closed,
            checks: OnceCell::new(),
        })
    }

    /// With what the session was taken.
    pub fn header(&self) -> &SessionHeader {
        &self.header
    }

    /// The session's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How the session had ended when it was opened here; `None` while it runs, or when its writer was killed.
    pub fn closed(&self) -> Option<&Closing> {
        self.closed.as_ref()
    }

    /// What this reader reads through.
    pub(crate) fn into_connection(self) -> Connection {
        self.connection
    }

    /// Frames in the file now.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn len(&self) -> Result<u64, LogbookError> {
        // Below the first where the file has none, or where damage has left none.
        Ok(self
            .last_sequence()?
            .saturating_add(1)
            .saturating_sub(self.header.first_sequence))
    }

    /// Sequence of the first frame that is there.
    pub(crate) fn first_present(&self) -> Result<Option<u64>, LogbookError> {
        self.connection
            .query_row("SELECT min(sequence) FROM frame", [], |row| {
                row.get::<_, Option<i64>>(0)
            })
            .map(|first| first.map(|first| first as u64))
            .map_err(|source| LogbookError::reading(&self.path, "count the frames of", source))
    }

    /// The largest id in a table; 0 where there is none.
    pub(crate) fn last_number(&self, table: &'static str) -> Result<i64, LogbookError> {
        self.connection
            .query_row(
                &format!("SELECT coalesce(max(id), 0) FROM {table}"),
                [],
                |row| row.get(0),
            )
            .map_err(|source| LogbookError::reading(&self.path, "count the rows of", source))
    }

    /// When the last frame was taken, whether or not its readings are whole.
    pub(crate) fn last_taken(&self) -> Result<Option<Taken>, LogbookError> {
        self.connection
            .query_row(
                "SELECT wall_us, monotonic_us FROM taken WHERE sequence = ?1",
                [self.last_sequence()? as i64],
                |row| {
                    Ok(Taken {
                        wall: wall(row.get(0)?),
                        monotonic: microseconds(row.get(1)?),
                    })
                },
            )
            .optional()
            .map_err(|source| LogbookError::reading(&self.path, "read the last frame of", source))
    }

    /// Whether there is no frame.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn is_empty(&self) -> Result<bool, LogbookError> {
        Ok(self.len()? == 0)
    }

    /// The session in one line.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn summary(&self) -> Result<SessionSummary, LogbookError> {
        let last = self.last_taken()?;
        Ok(SessionSummary {
            id: self.header.id.clone(),
            path: self.path.clone(),
            kind: self.header.kind,
            started: self.header.started,
            last: last.map(|last| last.wall),
            frames: self.len()?,
            first_sequence: self.header.first_sequence,
            continues: self.header.continues.clone(),
            closed: self.closed.clone(),
            simulated: self.header.simulated,
            electrodes: self.header.protocol.electrodes(),
            readings: self.header.protocol.len(),
            note: self.header.note.clone(),
        })
    }

    /// The baseline that the session recorded or was measured against.
    ///
    /// # Errors
    /// The file cannot be read, or its baseline is damaged.
    pub fn baseline(&self) -> Result<Option<Baseline>, LogbookError> {
        let row = self
            .connection
            .query_row(
                "SELECT id, wall_ns, frames, settings, simulated, readings, deviation, checksum FROM baseline",
                [],
                |row| {
                    let baseline = Baseline {
                        id: row.get(0)?,
                        readings: Vec::new(),
                        deviation: Vec::new(),
                        frames: row.get::<_, i64>(2)? as usize,
                        wall: DateTime::from_timestamp_nanos(row.get(1)?),
                        settings: self.settings_row(row.get(3)?)?,
                        simulated: row.get(4)?,
                    };
                    let blobs = [row.get(5)?, row.get(6)?, row.get::<_, Vec<u8>>(7)?];
                    Ok((baseline, row.get::<_, i64>(1)?, blobs))
                },
            )
            .optional()
            .map_err(|source| LogbookError::reading(&self.path, "read the baseline of", source))?;
        let Some((mut baseline, wall, [readings, deviation, checksum])) = row else {
            return Ok(None);
        };
        let place = || "its baseline".to_owned();
        if checksum != baseline_checksum(&baseline, wall, &readings, &deviation) {
            return Err(self.damaged(place(), "its checksum does not agree"));
        }
        let unpack = |blob: &[u8]| {
            codec::decode(blob, &Reference::NONE, self.header.protocol.len())
                .map_err(|cause| self.damaged(place(), cause.to_string()))
        };
        baseline.readings = unpack(&readings)?;
        baseline.deviation = unpack(&deviation)?
            .into_iter()
            .map(|deviation| deviation.volts().map(|volts| volts.0))
            .collect();
        Ok(Some(baseline))
    }

    /// What happened, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn events(&self) -> Result<Vec<Event>, LogbookError> {
        let (whole, damaged) = self.events_and_damaged()?;
        match damaged.first() {
            None => Ok(whole),
            Some(number) => {
                Err(self.damaged(format!("event {number}"), "its checksum does not agree"))
            }
        }
    }

    /// Events that agree with their checksums, and the numbers of those that do not.
    pub(crate) fn events_and_damaged(&self) -> Result<(Vec<Event>, Vec<i64>), LogbookError> {
        let mut damaged = Vec::new();
        let mut read = || -> rusqlite::Result<Vec<Event>> {
            let mut events = Vec::new();
            let mut statement = self
                .connection
                .prepare_cached("SELECT id, at_ns, kind, text, checksum FROM event ORDER BY id")?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                let (at, kind, text) = (row.get(1)?, row.get(2)?, row.get::<_, String>(3)?);
                let event = Event {
                    at: DateTime::from_timestamp_nanos(at),
                    kind,
                    text,
                };
                if row.get::<_, Vec<u8>>(4)? == event_checksum(at, &event.kind, &event.text) {
                    events.push(event);
                } else {
                    damaged.push(row.get(0)?);
                }
            }
            Ok(events)
        };
        let events = read()
            .map_err(|source| LogbookError::reading(&self.path, "read the events of", source))?;
        Ok((events, damaged))
    }

    /// One event by its number, if it is there and agrees with its checksum.
    pub(crate) fn event(&self, number: i64) -> Result<Option<Event>, LogbookError> {
        let read = || -> rusqlite::Result<Option<(Event, i64, Vec<u8>)>> {
            self.connection
                .prepare_cached("SELECT at_ns, kind, text, checksum FROM event WHERE id = ?1")?
                .query_row([number], |row| {
                    let at = row.get(0)?;
                    let event = Event {
                        at: DateTime::from_timestamp_nanos(at),
                        kind: row.get(1)?,
                        text: row.get(2)?,
                    };
                    Ok((event, at, row.get(3)?))
                })
                .optional()
        };
        let row = read()
            .map_err(|source| LogbookError::reading(&self.path, "read an event of", source))?;
        let Some((event, at, checksum)) = row else {
            return Ok(None);
        };
        if checksum == event_checksum(at, &event.kind, &event.text) {
            Ok(Some(event))
        } else {
            Err(self.damaged(format!("event {number}"), "its checksum does not agree"))
        }
    }

    fn settings_row(&self, id: i64) -> rusqlite::Result<Settings> {
        self.connection
            .prepare_cached(
                "SELECT protocol_hash, current_a, range_v, nplc, settle_ns, wiring, precautions FROM settings
                 WHERE id = ?1",
            )?
            .query_row([id], |row| {
                let precautions: String = row.get(6)?;
                Ok(Settings {
                    protocol_hash: row.get(0)?,
                    current: Amps(row.get(1)?),
                    range: Volts(row.get(2)?),
                    nplc: row.get(3)?,
                    settle: Duration::from_nanos(row.get::<_, i64>(4)?.max(0) as u64),
                    wiring: row.get(5)?,
                    // Damage shows in the checksum of whatever names these settings.
                    precautions: serde_json::from_str(&precautions).unwrap_or_default(),
                })
            })
    }

    pub(crate) fn damaged(&self, place: String, why: impl Into<String>) -> LogbookError {
        LogbookError::Damaged {
            path: self.path.clone(),
            place,
            why: why.into(),
        }
    }
}

/// A power cut while a file was begun or closed leaves a rollback journal beside it, which only somebody who may write
/// can play back; who may not is told by the opening that follows.
fn undo_half_a_change(path: &Path) {
    let mut journal = path.as_os_str().to_owned();
    journal.push("-journal");
    if !Path::new(&journal).exists() {
        return;
    }
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    if let Ok(connection) = Connection::open_with_flags(path, flags) {
        let _ = connection.pragma_query_value(None, "schema_version", |row| row.get::<_, i64>(0));
    }
}

fn microseconds(count: i64) -> Duration {
    Duration::from_micros(count.max(0) as u64)
}

fn wall(microseconds: i64) -> DateTime<Utc> {
    DateTime::from_timestamp_micros(microseconds).unwrap_or_default()
}
