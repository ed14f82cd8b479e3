//! Writing a session. Each entry is one transaction, on disk when the call returns.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Duration;

use chrono::{DateTime, Utc};
use rusqlite::{Connection, OpenFlags, OptionalExtension, params};
use survey::{Baseline, Frame, Reading, Settings, Volts};

use crate::row::{FrameRow, baseline_checksum, pack_hash};
use crate::schema;
use crate::{LogbookError, MapRecord, SessionHeader, codec};

/// A new self-contained frame at least this often, so that one damaged blob costs no more than so many frames.
const FRAMES_A_KEY: u64 = 256;

/// Bounds of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Storage {
    /// Largest number of 4096-byte pages; beyond it a write is refused as by a full disk. `None` for no limit.
    pub page_limit: Option<u32>,
}

/// The one writer of a session's file.
#[derive(Debug)]
pub struct SessionWriter {
    connection: Connection,
    path: PathBuf,
    protocol_hash: String,
    readings: usize,
    twins: Vec<Option<usize>>,
    sequence: u64,
    baseline: Vec<Reading>,
    key: Option<(u64, Vec<Reading>)>,
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
            twins: header.protocol.reciprocal_twins(),
            path,
            sequence: 0,
            baseline: Vec::new(),
            key: None,
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
        self.check_usable()?;
        self.check_length(frame.readings.len())?;
        let sequence = self.sequence + 1;
        let (reference, blob) = self.pack(sequence, &frame.readings)?;
        let quality = frame.quality(&self.twins);
        let row = FrameRow {
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
            blob,
        };
        let settle = span(frame.settings.settle, "the settling time")?;
        let known_settings = self
            .settings
            .as_ref()
            .filter(|(_, known)| *known == frame.settings);
        let known_settings = known_settings.map(|(id, _)| *id);
        let known_mapper = self.mapper.as_ref().zip(map);
        let known_mapper = known_mapper
            .filter(|((_, known), map)| same_mapper(known, map))
            .map(|((id, _), _)| *id);

        let write = |connection: &mut Connection| -> rusqlite::Result<(i64, Option<i64>)> {
            let transaction = connection.transaction()?;
            let settings = match known_settings {
                Some(id) => id,
                None => settings_id(&transaction, &frame.settings, settle)?,
            };
            let mapper = match (known_mapper, map) {
                (Some(id), _) => Some(id),
                (None, Some(map)) => Some(mapper_id(&transaction, map)?),
                (None, None) => None,
            };
            transaction
                .prepare_cached(
                    "INSERT INTO frame (sequence, wall_ns, monotonic_ns, duration_ns, settings, simulated, overloads,
                        timeouts, not_measured, reciprocity, compliance, mapper, map_hash, reference, readings, checksum)
                     VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16)",
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
                    row.compliance,
                    mapper,
                    row.map_hash,
                    row.reference,
                    row.blob,
                    row.checksum(settings, mapper),
                ])?;
            transaction.commit()?;
            Ok((settings, mapper))
        };
        let (settings, mapper) = write(&mut self.connection)
            .map_err(|source| self.write_failed("writing a frame", source))?;

        if known_settings.is_none() {
            self.settings = Some((settings, frame.settings.clone()));
        }
        if let (None, Some(id), Some(map)) = (known_mapper, mapper, map) {
            self.mapper = Some((id, map.clone()));
        }
        // Only a frame that refers to no other frame may be referred to: two rows give any frame.
        let stands_alone = row.reference.is_none_or(|reference| reference == 0);
        if stands_alone && (row.reference.is_none() || self.key_is_old(sequence)) {
            self.key = Some((sequence, frame.readings.clone()));
        }
        self.sequence = sequence;
        Ok(sequence)
    }

    fn key_is_old(&self, sequence: u64) -> bool {
        self.key
            .as_ref()
            .is_none_or(|(key, _)| sequence - key >= FRAMES_A_KEY)
    }

    /// The smallest blob of those against nothing, the baseline, and the key frame.
    fn pack(
        &self,
        sequence: u64,
        readings: &[Reading],
    ) -> Result<(Option<i64>, Vec<u8>), LogbookError> {
        let encode = |reference: &[Reading]| {
            codec::encode(readings, reference)
                .map_err(|reading| LogbookError::NotFinite { reading })
        };
        let mut best = (None, encode(&[])?);
        let baseline = (!self.baseline.is_empty()).then_some((0, &self.baseline));
        let key = self
            .key
            .as_ref()
            .filter(|_| !self.key_is_old(sequence))
            .map(|(key, readings)| (*key as i64, readings));
        for (reference, other) in baseline.into_iter().chain(key) {
            let blob = encode(other)?;
            if blob.len() < best.1.len() {
                best = (Some(reference), blob);
            }
        }
        Ok(best)
    }

    /// Writes the baseline that the frames to come are measured against, or that this session has recorded.
    ///
    /// # Errors
    /// A second baseline, the wrong number of readings, or a disk that refuses.
    pub fn baseline(&mut self, baseline: &Baseline) -> Result<(), LogbookError> {
        self.check_usable()?;
        self.check_length(baseline.readings.len())?;
        self.check_length(baseline.deviation.len())?;
        let not_finite = |reading| LogbookError::NotFinite { reading };
        let readings = codec::encode(&baseline.readings, &[]).map_err(not_finite)?;
        let deviation: Vec<Reading> = baseline
            .deviation
            .iter()
            .map(|deviation| deviation.map_or(Reading::NotMeasured, |v| Reading::Ok(Volts(v))))
            .collect();
        let deviation = codec::encode(&deviation, &[]).map_err(not_finite)?;
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
        self.baseline = baseline.readings.clone();
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

    fn check_length(&self, has: usize) -> Result<(), LogbookError> {
        let wants = self.readings;
        if has == wants {
            Ok(())
        } else {
            Err(LogbookError::WrongLength { has, wants })
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
    let values = params![
        settings.protocol_hash,
        settings.current.0,
        settings.range.0,
        settings.nplc,
        settle,
        settings.wiring,
    ];
    let known = connection
        .query_row(
            "SELECT id FROM settings WHERE protocol_hash = ?1 AND current_a = ?2 AND range_v = ?3 AND nplc = ?4
                AND settle_ns = ?5 AND wiring = ?6",
            values,
            |row| row.get(0),
        )
        .optional()?;
    if let Some(id) = known {
        return Ok(id);
    }
    connection.execute(
        "INSERT INTO settings (protocol_hash, current_a, range_v, nplc, settle_ns, wiring)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
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

fn same_mapper(a: &MapRecord, b: &MapRecord) -> bool {
    (&a.method, &a.model_hash, &a.build, &a.cpu) == (&b.method, &b.model_hash, &b.build, &b.cpu)
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
