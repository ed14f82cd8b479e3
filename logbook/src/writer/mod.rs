//! Writing a session. Each call is one transaction, on disk when it returns.

mod late;
mod references;

use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Duration;

use chrono::{DateTime, Utc};
use rusqlite::{Connection, OpenFlags, OptionalExtension, params};
use survey::{Baseline, Checks, Frame, Quality, Reading, Settings, Volts};

use crate::codec::{EncodeError, Reference, encode};
use crate::row::{FrameRow, baseline_checksum, pack_hash, reference_checksum};
use crate::schema;
use crate::{LogbookError, MapRecord, SessionHeader};

use references::{Packed, References};

/// Bounds of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Storage {
    /// Largest number of 8192-byte pages; beyond it a write is refused as by a full disk. `None` for no limit.
    pub page_limit: Option<u32>,
}

/// The one writer of a session's file.
#[derive(Debug)]
pub struct SessionWriter {
    connection: Connection,
    path: PathBuf,
    protocol_hash: String,
    readings: usize,
    checks: Checks,
    sequence: u64,
    references: References,
    settings: Option<(i64, Settings)>,
    mapper: Option<(i64, MapRecord)>,
    broken: bool,
}

impl SessionWriter {
    /// Makes `<dir>/<id>.tactus` (and the folder, if need be) and writes the header; it is on disk when this returns.
    ///
    /// # Errors
    /// An id that is no file name, a session that exists already, or a disk that refuses.
    pub fn create(dir: impl AsRef<Path>, header: &SessionHeader) -> Result<Self, LogbookError> {
        Self::create_with(dir, header, Storage::default())
    }

    /// Like [`SessionWriter::create`], within bounds.
    ///
    /// # Errors
    /// As [`SessionWriter::create`].
    pub fn create_with(
        dir: impl AsRef<Path>,
        header: &SessionHeader,
        storage: Storage,
    ) -> Result<Self, LogbookError> {
        let dir = dir.as_ref();
        check_id(&header.id)?;
        let started = nanoseconds(header.started, "the start of the session")?;
        let path = dir.join(format!("{}.{}", header.id, crate::shelf::EXTENSION));
        let refused = |attempt, source: std::io::Error| LogbookError::DiskRefused {
            path: path.clone(),
            attempt,
            source: Box::new(source),
        };
        std::fs::create_dir_all(dir).map_err(|source| refused("making its folder", source))?;
        // Made here, not by SQLite, because only this refuses a file that is already there.
        match File::create_new(&path) {
            Ok(_) => {}
            Err(source) if source.kind() == std::io::ErrorKind::AlreadyExists => {
                return Err(LogbookError::Exists { path });
            }
            Err(source) => return Err(refused("making the file", source)),
        }
        let connection = Self::lay_out(&path, header, started, storage).map_err(|source| {
            // A file without a header is no session; nothing was acknowledged, so nothing is lost.
            let _ = std::fs::remove_file(&path);
            LogbookError::writing(&path, "writing the header", source)
        })?;
        File::open(dir)
            .and_then(|folder| folder.sync_all())
            .map_err(|source| refused("syncing its folder", source))?;
        Ok(Self {
            connection,
            protocol_hash: header.protocol.hash(),
            readings: header.protocol.len(),
            checks: Checks::new(&header.protocol),
            path,
            sequence: 0,
            references: References::default(),
            settings: None,
            mapper: None,
            broken: false,
        })
    }

    fn lay_out(
        path: &Path,
        header: &SessionHeader,
        started: i64,
        storage: Storage,
    ) -> rusqlite::Result<Connection> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let mut connection = Connection::open_with_flags(path, flags)?;
        // Rows of some 600 bytes leave half a row unused at the end of each page.
        connection.pragma_update(None, "page_size", 8192)?;
        connection.pragma_update(None, "journal_mode", "WAL")?;
        connection.pragma_update(None, "synchronous", "FULL")?;
        connection.pragma_update(None, "foreign_keys", true)?;
        if let Some(pages) = storage.page_limit {
            connection.pragma_update_and_check(None, "max_page_count", pages, |_| Ok(()))?;
        }
        let json = |value: Result<String, serde_json::Error>| {
            value.map_err(|cause| rusqlite::Error::ToSqlConversionFailure(cause.into()))
        };
        let transaction = connection.transaction()?;
        schema::lay_out(&transaction)?;
        transaction.execute(
            "INSERT INTO session (only, id, kind, started_ns, simulated, build, seed, config_toml, config_hash,
                model_hash, geometry_hash, protocol, instruments, modules, note)
             VALUES (1, ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14)",
            params![
                header.id,
                header.kind.as_str(),
                started,
                header.simulated,
                header.build,
                header.seed.map(|seed| seed.to_string()),
                header.config_toml,
                header.config_hash,
                header.model_hash,
                header.geometry_hash,
                json(serde_json::to_string(&header.protocol))?,
                json(serde_json::to_string(&header.instruments))?,
                json(serde_json::to_string(&header.modules))?,
                header.note,
            ],
        )?;
        transaction.commit()?;
        Ok(connection)
    }

    /// The session's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Frames acknowledged so far, which is also the last one's sequence.
    pub fn acknowledged(&self) -> u64 {
        self.sequence
    }

    /// Writes a frame and returns its sequence, counted from 1 in this session whatever number the frame carries.
    /// When this returns, the frame is on disk.
    ///
    /// # Errors
    /// The wrong number of readings, a reading that is not finite, or a disk that refuses: then nothing of the frame
    /// is in the file, and all frames before are.
    pub fn append(&mut self, frame: &Frame, map: Option<&MapRecord>) -> Result<u64, LogbookError> {
        self.append_all([(frame, map)])
    }

    /// Writes frames with one sync for all of them and returns the last one's sequence. What may be lost by a power
    /// cut is what the caller gathered and has not handed over, or not seen returned: all of a call, or nothing.
    ///
    /// # Errors
    /// As [`SessionWriter::append`]; then no frame of this call is in the file.
    pub fn append_all<'a>(
        &mut self,
        frames: impl IntoIterator<Item = (&'a Frame, Option<&'a MapRecord>)>,
    ) -> Result<u64, LogbookError> {
        self.check_usable()?;
        let before = (
            self.references.clone(),
            self.settings.clone(),
            self.mapper.clone(),
        );
        let written = self.write_frames(frames);
        if written.is_err() {
            (self.references, self.settings, self.mapper) = before;
        }
        self.sequence = written?;
        Ok(self.sequence)
    }

    fn write_frames<'a>(
        &mut self,
        frames: impl IntoIterator<Item = (&'a Frame, Option<&'a MapRecord>)>,
    ) -> Result<u64, LogbookError> {
        let wants = self.readings;
        let mut sequence = self.sequence;
        let store = || -> Result<(), Unwritten> {
            let transaction = self.connection.transaction()?;
            for (frame, map) in frames {
                sequence += 1;
                check_length(frame.readings.len(), wants)?;
                let packed = self.references.pack(&frame.readings)?;
                let settings = known_settings(&transaction, &mut self.settings, &frame.settings)?;
                let mapper = match map {
                    Some(map) => Some(known_mapper(&transaction, &mut self.mapper, map)?),
                    None => None,
                };
                let row = frame_row(sequence, frame, map, packed.reference, &packed.blob)?;
                write_reference(&transaction, &packed)?;
                write_frame(&transaction, &row, &self.checks.of(frame), settings, mapper)?;
            }
            transaction.commit()?;
            Ok(())
        };
        match store() {
            Ok(()) => Ok(sequence),
            Err(Unwritten::Refused(refusal)) => Err(refusal),
            Err(Unwritten::Store(source)) => Err(self.write_failed("writing a frame", source)),
        }
    }

    /// Writes the baseline that the frames to come are measured against, or that this session has recorded.
    ///
    /// # Errors
    /// A second baseline, the wrong number of readings, or a disk that refuses.
    pub fn baseline(&mut self, baseline: &Baseline) -> Result<(), LogbookError> {
        self.check_usable()?;
        check_length(baseline.readings.len(), self.readings)?;
        check_length(baseline.deviation.len(), self.readings)?;
        let readings = encode(&baseline.readings, &Reference::NONE)?;
        let deviation: Vec<Reading> = baseline
            .deviation
            .iter()
            .map(|deviation| deviation.map_or(Reading::NotMeasured, |v| Reading::Ok(Volts(v))))
            .collect();
        let deviation = encode(&deviation, &Reference::NONE)?;
        let wall = nanoseconds(baseline.wall, "the baseline's wall time")?;
        let settle = span(baseline.settings.settle, "the settling time")?;
        let write = |connection: &mut Connection| -> rusqlite::Result<i64> {
            let transaction = connection.transaction()?;
            let settings = settings_id(&transaction, &baseline.settings, settle)?;
            let checksum = baseline_checksum(
                &baseline.id,
                wall,
                baseline.frames as i64,
                settings,
                baseline.simulated,
                &readings,
                &deviation,
            );
            transaction.execute(
                "INSERT INTO baseline (only, id, wall_ns, frames, settings, simulated, readings, deviation, checksum)
                 VALUES (1, ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)",
                params![
                    baseline.id,
                    wall,
                    baseline.frames as i64,
                    settings,
                    baseline.simulated,
                    readings,
                    deviation,
                    checksum
                ],
            )?;
            transaction.commit()?;
            Ok(settings)
        };
        let settings = write(&mut self.connection)
            .map_err(|source| self.write_failed("writing the baseline", source))?;
        self.settings = Some((settings, baseline.settings.clone()));
        self.references.set_baseline(&baseline.readings);
        self.checks = self.checks.clone().against(&baseline.readings);
        Ok(())
    }

    /// Writes an event; on disk when this returns.
    ///
    /// # Errors
    /// A disk that refuses.
    pub fn event(&mut self, at: DateTime<Utc>, kind: &str, text: &str) -> Result<(), LogbookError> {
        self.check_usable()?;
        let at = nanoseconds(at, "an event's time")?;
        self.connection
            .execute(
                "INSERT INTO event (at_ns, kind, text) VALUES (?1, ?2, ?3)",
                params![at, kind, text],
            )
            .map(|_| ())
            .map_err(|source| self.write_failed("writing an event", source))
    }

    /// Says how the session ended and leaves one file, without companions.
    ///
    /// # Errors
    /// A disk that refuses; the frames are safe all the same, and the session reads as not closed.
    pub fn close(mut self, at: DateTime<Utc>, reason: &str) -> Result<(), LogbookError> {
        self.check_usable()?;
        let at = nanoseconds(at, "the end of the session")?;
        self.connection
            .execute(
                "UPDATE session SET closed_ns = ?1, closed_reason = ?2",
                params![at, reason],
            )
            .map_err(|source| self.write_failed("closing the session", source))?;
        // Refused while somebody reads; then the last reader or the next opening folds the journal in.
        match self
            .connection
            .pragma_update(None, "journal_mode", "DELETE")
        {
            Ok(()) => Ok(()),
            Err(busy)
                if matches!(
                    busy.sqlite_error_code(),
                    Some(rusqlite::ErrorCode::DatabaseBusy | rusqlite::ErrorCode::DatabaseLocked)
                ) =>
            {
                Ok(())
            }
            Err(source) => Err(self.write_failed("folding the journal in", source)),
        }
    }

    fn check_usable(&self) -> Result<(), LogbookError> {
        if !self.broken {
            return Ok(());
        }
        Err(LogbookError::DiskRefused {
            path: self.path.clone(),
            attempt: "anything after a failed write",
            source: "after an I/O error nobody knows what reached the disk".into(),
        })
    }

    /// A full disk may be emptied; after an I/O error the kernel may have dropped what it could not write, and said so
    /// only once, so nothing more is acknowledged on this file.
    fn write_failed(&mut self, attempt: &'static str, source: rusqlite::Error) -> LogbookError {
        self.broken = source.sqlite_error_code() == Some(rusqlite::ErrorCode::SystemIoFailure);
        LogbookError::writing(&self.path, attempt, source)
    }

    /// [`survey::Protocol::hash`] of the questions that frames of this session answer.
    pub fn protocol_hash(&self) -> &str {
        &self.protocol_hash
    }
}

fn settings_id(connection: &Connection, settings: &Settings, settle: i64) -> rusqlite::Result<i64> {
    let precautions = serde_json::to_string(&settings.precautions)
        .map_err(|cause| rusqlite::Error::ToSqlConversionFailure(cause.into()))?;
    let values = params![
        settings.protocol_hash,
        settings.current.0,
        settings.range.0,
        settings.nplc,
        settle,
        settings.wiring,
        precautions,
    ];
    let known = connection
        .query_row(
            "SELECT id FROM settings WHERE protocol_hash = ?1 AND current_a = ?2 AND range_v = ?3 AND nplc = ?4
                AND settle_ns = ?5 AND wiring = ?6 AND precautions = ?7",
            values,
            |row| row.get(0),
        )
        .optional()?;
    if let Some(id) = known {
        return Ok(id);
    }
    connection.execute(
        "INSERT INTO settings (protocol_hash, current_a, range_v, nplc, settle_ns, wiring, precautions)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
        values,
    )?;
    Ok(connection.last_insert_rowid())
}

fn mapper_id(connection: &Connection, map: &MapRecord) -> rusqlite::Result<i64> {
    let values = params![map.method, map.model_hash, map.build, map.cpu];
    let known = connection
        .query_row(
            "SELECT id FROM mapper WHERE method = ?1 AND model_hash IS ?2 AND build = ?3 AND cpu = ?4",
            values,
            |row| row.get(0),
        )
        .optional()?;
    if let Some(id) = known {
        return Ok(id);
    }
    connection.execute(
        "INSERT INTO mapper (method, model_hash, build, cpu) VALUES (?1, ?2, ?3, ?4)",
        values,
    )?;
    Ok(connection.last_insert_rowid())
}

/// Why a transaction was not finished: by the file, or by what was to be written.
enum Unwritten {
    Store(rusqlite::Error),
    Refused(LogbookError),
}

impl From<rusqlite::Error> for Unwritten {
    fn from(source: rusqlite::Error) -> Self {
        Self::Store(source)
    }
}

impl From<LogbookError> for Unwritten {
    fn from(refusal: LogbookError) -> Self {
        Self::Refused(refusal)
    }
}

impl From<EncodeError> for Unwritten {
    fn from(refusal: EncodeError) -> Self {
        Self::Refused(refusal.into())
    }
}

fn known_settings(
    transaction: &Connection,
    known: &mut Option<(i64, Settings)>,
    settings: &Settings,
) -> Result<i64, Unwritten> {
    if let Some((id, same)) = known
        && same == settings
    {
        return Ok(*id);
    }
    let settle = span(settings.settle, "the settling time")?;
    let id = settings_id(transaction, settings, settle)?;
    *known = Some((id, settings.clone()));
    Ok(id)
}

fn known_mapper(
    transaction: &Connection,
    known: &mut Option<(i64, MapRecord)>,
    map: &MapRecord,
) -> rusqlite::Result<i64> {
    let makers = |map: &MapRecord| {
        (
            map.method.clone(),
            map.model_hash.clone(),
            map.build.clone(),
            map.cpu.clone(),
        )
    };
    if let Some((id, same)) = known
        && makers(same) == makers(map)
    {
        return Ok(*id);
    }
    let id = mapper_id(transaction, map)?;
    *known = Some((id, map.clone()));
    Ok(id)
}

fn frame_row(
    sequence: u64,
    frame: &Frame,
    map: Option<&MapRecord>,
    reference: Option<i64>,
    blob: &[u8],
) -> Result<FrameRow, LogbookError> {
    Ok(FrameRow {
        sequence: sequence as i64,
        wall: nanoseconds(frame.wall, "a frame's wall time")?,
        monotonic: span(frame.monotonic, "a frame's monotonic time")?,
        duration: span(frame.duration, "a frame's duration")?,
        simulated: frame.simulated,
        compliance: (!frame.compliance.is_empty()).then(|| {
            format!(
                "{:?}",
                frame.compliance.iter().map(|e| e.0).collect::<Vec<_>>()
            )
        }),
        map_hash: map.map(|map| pack_hash(&map.hash)),
        reference,
        blob: blob.to_vec(),
    })
}

fn write_reference(transaction: &Connection, packed: &Packed) -> rusqlite::Result<()> {
    let Some(new) = &packed.written else {
        return Ok(());
    };
    transaction
        .prepare_cached(
            "INSERT INTO reference (id, against_baseline, readings, checksum) VALUES (?1, ?2, ?3, ?4)",
        )?
        .execute(params![
            new.id,
            new.against_baseline,
            new.blob,
            reference_checksum(new.id, new.against_baseline, &new.blob),
        ])?;
    Ok(())
}

fn write_frame(
    transaction: &Connection,
    row: &FrameRow,
    quality: &Quality,
    settings: i64,
    mapper: Option<i64>,
) -> rusqlite::Result<()> {
    transaction
        .prepare_cached(
            "INSERT INTO frame (sequence, wall_ns, monotonic_ns, duration_ns, settings, simulated, overloads,
                timeouts, not_measured, reciprocity, loop_sum, implausible, flags, compliance, mapper, map_hash,
                reference, readings, checksum)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18, ?19)",
        )?
        .execute(params![
            row.sequence,
            row.wall,
            row.monotonic,
            row.duration,
            settings,
            row.simulated,
            quality.overloads as i64,
            quality.timeouts as i64,
            quality.not_measured as i64,
            quality.reciprocity.filter(|worst| worst.is_finite()),
            quality.loop_sum.filter(|worst| worst.is_finite()),
            quality.implausible as i64,
            quality.words(),
            row.compliance,
            mapper,
            row.map_hash,
            row.reference,
            row.blob,
            row.checksum(settings, mapper),
        ])?;
    Ok(())
}

fn check_length(has: usize, wants: usize) -> Result<(), LogbookError> {
    if has == wants {
        Ok(())
    } else {
        Err(LogbookError::WrongLength { has, wants })
    }
}

fn check_id(id: &str) -> Result<(), LogbookError> {
    let fits = (1..=100).contains(&id.len())
        && id
            .bytes()
            .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'_');
    if fits {
        Ok(())
    } else {
        Err(LogbookError::BadId { id: id.to_owned() })
    }
}

fn nanoseconds(at: DateTime<Utc>, what: &'static str) -> Result<i64, LogbookError> {
    at.timestamp_nanos_opt()
        .ok_or(LogbookError::TimeOutOfRange { what })
}

fn span(duration: Duration, what: &'static str) -> Result<i64, LogbookError> {
    i64::try_from(duration.as_nanos()).map_err(|_| LogbookError::TimeOutOfRange { what })
}
