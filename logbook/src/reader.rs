//! Reading a session: closed, or left behind by a writer that was killed, or still being written.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::Duration;

use chrono::{DateTime, Utc};
use rusqlite::types::Value;
use rusqlite::{Connection, OpenFlags, OptionalExtension, params};
use survey::{
    Amps, Baseline, Electrode, Frame, Precautions, Quality, QualityFlag, Settings, Volts,
};

use crate::codec::Reference;
use crate::row::{
    HeaderFault, StoredFrame, baseline_checksum, header_row, reference_checksum, unpack_hash,
};
use crate::{
    Closing, Event, LogbookError, MapRecord, Record, SessionHeader, SessionSummary, Taken, codec,
    schema,
};

/// How many frames are fetched at a time while iterating.
const PAGE: u32 = 64;

/// A session's file, opened for reading; it is never changed.
#[derive(Debug)]
pub struct SessionReader {
    connection: Connection,
    path: PathBuf,
    header: SessionHeader,
    closed: Option<Closing>,
}

impl SessionReader {
    /// Opens a session file. What a killed writer has left in the journal beside it is part of the session.
    ///
    /// # Errors
    /// No such file, not a session, a newer schema, or damage to the header.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, LogbookError> {
        let path = path.as_ref().to_owned();
        // SQLite says "unable to open" for everything; the system says why.
        std::fs::File::open(&path).map_err(|source| LogbookError::Io {
            path: path.clone(),
            attempt: "open",
            source,
        })?;
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
        Ok((self.last_sequence()? + 1).saturating_sub(self.header.first_sequence))
    }

    /// Sequence of the last frame; of a session without frames one less than its first will have.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn last_sequence(&self) -> Result<u64, LogbookError> {
        self.connection
            .query_row("SELECT max(sequence) FROM frame", [], |row| {
                row.get::<_, Option<i64>>(0)
            })
            .map(|last| last.map_or(self.header.first_sequence - 1, |last| last as u64))
            .map_err(|source| LogbookError::reading(&self.path, "count the frames of", source))
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

    /// Number of the last reference; 0 where there is none.
    pub(crate) fn last_reference(&self) -> Result<i64, LogbookError> {
        self.connection
            .query_row("SELECT coalesce(max(id), 0) FROM reference", [], |row| {
                row.get(0)
            })
            .map_err(|source| LogbookError::reading(&self.path, "count the references of", source))
    }

    /// When the last frame was taken, whether or not its readings are whole.
    pub(crate) fn last_taken(&self) -> Result<Option<Taken>, LogbookError> {
        self.connection
            .query_row(
                "SELECT wall_ns, monotonic_ns FROM frame ORDER BY sequence DESC LIMIT 1",
                [],
                |row| {
                    Ok(Taken {
                        wall: DateTime::from_timestamp_nanos(row.get(0)?),
                        monotonic: nanoseconds(row.get(1)?),
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
                    Ok((
                        row.get::<_, String>(0)?,
                        row.get::<_, i64>(1)?,
                        row.get::<_, i64>(2)?,
                        row.get::<_, i64>(3)?,
                        row.get::<_, bool>(4)?,
                        row.get::<_, Vec<u8>>(5)?,
                        row.get::<_, Vec<u8>>(6)?,
                        row.get::<_, Vec<u8>>(7)?,
                    ))
                },
            )
            .optional()
            .map_err(|source| LogbookError::reading(&self.path, "read the baseline of", source))?;
        let Some((id, wall, frames, settings, simulated, readings, deviation, checksum)) = row
        else {
            return Ok(None);
        };
        let place = || "its baseline".to_owned();
        if checksum
            != baseline_checksum(
                &id, wall, frames, settings, simulated, &readings, &deviation,
            )
        {
            return Err(self.damaged(place(), "its checksum does not agree"));
        }
        let unpack = |blob: &[u8]| {
            codec::decode(blob, &Reference::NONE)
                .map_err(|cause| self.damaged(place(), cause.to_string()))
        };
        Ok(Some(Baseline {
            id,
            readings: unpack(&readings)?,
            deviation: unpack(&deviation)?
                .into_iter()
                .map(|deviation| deviation.volts().map(|volts| volts.0))
                .collect(),
            frames: frames as usize,
            wall: DateTime::from_timestamp_nanos(wall),
            settings: self.settings(settings)?,
            simulated,
        }))
    }

    /// One frame by its sequence, counted from [`SessionHeader::first_sequence`].
    ///
    /// # Errors
    /// No such frame, or a damaged one.
    pub fn frame(&self, sequence: u64) -> Result<Record, LogbookError> {
        let row = self
            .connection
            .prepare_cached("SELECT * FROM frame WHERE sequence = ?1")
            .and_then(|mut statement| {
                statement
                    .query_row([sequence as i64], StoredFrame::read)
                    .optional()
            })
            .map_err(|source| LogbookError::reading(&self.path, "read a frame of", source))?;
        let Some(row) = row else {
            return Err(LogbookError::NoSuchFrame {
                path: self.path.clone(),
                sequence,
                frames: self.len()?,
                first: self.header.first_sequence,
            });
        };
        self.unpack(row, &mut Known::default())
    }

    /// All frames in order. A damaged frame is an error in its place, and the ones after it still come.
    pub fn frames(&self) -> Frames<'_> {
        self.frames_from(1)
    }

    /// The frames from a sequence on.
    pub fn frames_from(&self, sequence: u64) -> Frames<'_> {
        Frames {
            session: self,
            next: sequence.max(1) as i64,
            page: VecDeque::new(),
            known: Known::default(),
            ended: false,
        }
    }

    /// The last frame, if there is one.
    ///
    /// # Errors
    /// The file cannot be read, or that frame is damaged.
    pub fn last(&self) -> Result<Option<Record>, LogbookError> {
        match self.is_empty()? {
            true => Ok(None),
            false => self.frame(self.last_sequence()?).map(Some),
        }
    }

    /// What happened, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn events(&self) -> Result<Vec<Event>, LogbookError> {
        let read = || -> rusqlite::Result<Vec<Event>> {
            self.connection
                .prepare_cached("SELECT at_ns, kind, text FROM event ORDER BY id")?
                .query_map([], |row| {
                    Ok(Event {
                        at: DateTime::from_timestamp_nanos(row.get(0)?),
                        kind: row.get(1)?,
                        text: row.get(2)?,
                    })
                })?
                .collect()
        };
        read().map_err(|source| LogbookError::reading(&self.path, "read the events of", source))
    }

    fn page(&self, from: i64) -> Result<VecDeque<StoredFrame>, LogbookError> {
        let read = || -> rusqlite::Result<VecDeque<StoredFrame>> {
            self.connection
                .prepare_cached(
                    "SELECT * FROM frame WHERE sequence >= ?1 ORDER BY sequence LIMIT ?2",
                )?
                .query_map(params![from, PAGE], StoredFrame::read)?
                .collect()
        };
        read().map_err(|source| LogbookError::reading(&self.path, "read the frames of", source))
    }

    fn settings(&self, id: i64) -> Result<Settings, LogbookError> {
        let (mut settings, precautions) = self
            .connection
            .prepare_cached(
                "SELECT protocol_hash, current_a, range_v, nplc, settle_ns, wiring, precautions FROM settings
                 WHERE id = ?1",
            )
            .and_then(|mut statement| {
                statement.query_row([id], |row| {
                    let settings = Settings {
                        protocol_hash: row.get(0)?,
                        current: Amps(row.get(1)?),
                        range: Volts(row.get(2)?),
                        nplc: row.get(3)?,
                        settle: nanoseconds(row.get(4)?),
                        wiring: row.get(5)?,
                        precautions: Precautions::default(),
                    };
                    Ok((settings, row.get::<_, String>(6)?))
                })
            })
            .map_err(|source| LogbookError::reading(&self.path, "read the settings of", source))?;
        settings.precautions = serde_json::from_str(&precautions)
            .map_err(|cause| self.damaged("its settings".to_owned(), cause.to_string()))?;
        Ok(settings)
    }

    fn map_record(&self, id: i64, hash: &Value) -> Result<MapRecord, LogbookError> {
        let hash = unpack_hash(hash)
            .ok_or_else(|| self.damaged("the hash of a map".into(), "it is no hash"))?;
        self.connection
            .prepare_cached("SELECT method, model_hash, build, cpu FROM mapper WHERE id = ?1")
            .and_then(|mut statement| {
                statement.query_row([id], |row| {
                    Ok(MapRecord {
                        hash,
                        method: row.get(0)?,
                        model_hash: row.get(1)?,
                        build: row.get(2)?,
                        cpu: row.get(3)?,
                    })
                })
            })
            .map_err(|source| LogbookError::reading(&self.path, "read the map methods of", source))
    }

    /// Of a map that was made after its frame had been written.
    fn late_map(&self, sequence: i64) -> Result<Option<MapRecord>, LogbookError> {
        let late = self
            .connection
            .prepare_cached("SELECT mapper, map_hash FROM late_map WHERE sequence = ?1")
            .and_then(|mut statement| {
                let row = |row: &rusqlite::Row<'_>| Ok((row.get::<_, i64>(0)?, row.get(1)?));
                statement.query_row([sequence], row).optional()
            })
            .map_err(|source| LogbookError::reading(&self.path, "read the late maps of", source))?;
        late.map(|(mapper, hash): (i64, Value)| self.map_record(mapper, &hash))
            .transpose()
    }

    fn unpack(&self, stored: StoredFrame, known: &mut Known) -> Result<Record, LogbookError> {
        let StoredFrame {
            row,
            settings,
            mapper,
            reciprocity,
            loop_sum,
            implausible,
            flags,
            checksum,
        } = stored;
        let place = || format!("frame {}", row.sequence);
        if checksum != row.checksum(settings, mapper) {
            return Err(self.damaged(place(), "its checksum does not agree"));
        }
        if let Some(reference) = row.reference
            && known
                .reference
                .as_ref()
                .is_none_or(|(id, _)| *id != reference)
        {
            known.reference = Some((reference, self.reference(row.sequence, reference)?));
        }
        let reference = match (row.reference, &known.reference) {
            (Some(_), Some((_, reference))) => reference,
            _ => &Reference::NONE,
        };
        let readings = codec::decode(&row.blob, reference)
            .map_err(|cause| self.damaged(place(), cause.to_string()))?;
        if readings.len() != self.header.protocol.len() {
            return Err(self.damaged(place(), "its length is not the protocol's"));
        }
        let compliance: Vec<Electrode> = match &row.compliance {
            Some(json) => serde_json::from_str(json)
                .map_err(|cause| self.damaged(place(), cause.to_string()))?,
            None => Vec::new(),
        };
        if known
            .settings
            .as_ref()
            .is_none_or(|(id, _)| *id != settings)
        {
            known.settings = Some((settings, self.settings(settings)?));
        }
        let taken = known
            .settings
            .as_ref()
            .map(|(_, settings)| settings.clone());
        let frame = Frame {
            sequence: row.sequence as u64,
            readings,
            extra: Vec::new(),
            monotonic: nanoseconds(row.monotonic),
            wall: DateTime::<Utc>::from_timestamp_nanos(row.wall),
            duration: nanoseconds(row.duration),
            settings: taken.expect("looked up just above"),
            compliance,
            simulated: row.simulated,
        };
        let map = match (mapper, &row.map_hash) {
            (Some(id), Some(hash)) => Some(self.map_record(id, hash)?),
            _ => self.late_map(row.sequence)?,
        };
        Ok(Record {
            quality: Quality {
                reciprocity,
                loop_sum,
                implausible: implausible as usize,
                flags: flags
                    .split(',')
                    .filter_map(QualityFlag::from_word)
                    .collect(),
                ..Quality::counted(&frame)
            },
            frame,
            map,
        })
    }

    /// What a frame's differences refer to.
    fn reference(&self, of: i64, reference: i64) -> Result<Reference, LogbookError> {
        if reference == 0 {
            return self.baseline_reference(&format!("frame {of}"));
        }
        let place = format!("reference {reference}, which frame {of} refers to");
        let row = self
            .connection
            .prepare_cached(
                "SELECT against_baseline, readings, checksum FROM reference WHERE id = ?1",
            )
            .and_then(|mut statement| {
                let row = |row: &rusqlite::Row<'_>| {
                    Ok((
                        row.get::<_, bool>(0)?,
                        row.get::<_, Vec<u8>>(1)?,
                        row.get::<_, Vec<u8>>(2)?,
                    ))
                };
                statement.query_row([reference], row).optional()
            })
            .map_err(|source| LogbookError::reading(&self.path, "read a reference of", source))?;
        let Some((against_baseline, blob, checksum)) = row else {
            return Err(self.damaged(place, "it is not there"));
        };
        if checksum != reference_checksum(reference, against_baseline, &blob) {
            return Err(self.damaged(place, "its checksum does not agree"));
        }
        let against = if against_baseline {
            self.baseline_reference(&place)?
        } else {
            Reference::NONE
        };
        let readings = codec::decode(&blob, &against)
            .map_err(|cause| self.damaged(place, cause.to_string()))?;
        Ok(Reference::new(&readings))
    }

    fn baseline_reference(&self, of: &str) -> Result<Reference, LogbookError> {
        let baseline = self.baseline()?.ok_or_else(|| {
            self.damaged(of.to_owned(), "it refers to a baseline, and there is none")
        })?;
        Ok(Reference::new(&baseline.readings))
    }

    pub(crate) fn damaged(&self, place: String, why: impl Into<String>) -> LogbookError {
        LogbookError::Damaged {
            path: self.path.clone(),
            place,
            why: why.into(),
        }
    }
}

/// Frames of a session in order; made by [`SessionReader::frames`].
#[derive(Debug)]
pub struct Frames<'a> {
    session: &'a SessionReader,
    next: i64,
    page: VecDeque<StoredFrame>,
    known: Known,
    ended: bool,
}

impl Iterator for Frames<'_> {
    type Item = Result<Record, LogbookError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.page.is_empty() && !self.ended {
            match self.session.page(self.next) {
                Ok(page) => self.page = page,
                Err(failure) => {
                    self.ended = true;
                    return Some(Err(failure));
                }
            }
        }
        let Some(stored) = self.page.pop_front() else {
            self.ended = true;
            return None;
        };
        self.next = stored.row.sequence + 1;
        Some(self.session.unpack(stored, &mut self.known))
    }
}

/// What was looked up last, for the next frame mostly wants the same.
#[derive(Debug, Default)]
struct Known {
    reference: Option<(i64, Reference)>,
    settings: Option<(i64, Settings)>,
}

fn nanoseconds(count: i64) -> Duration {
    Duration::from_nanos(count.max(0) as u64)
}
