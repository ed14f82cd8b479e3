//! Reading frames.

use std::collections::{BTreeMap, VecDeque};

use rusqlite::params;
use rusqlite::types::Value;
use survey::{Checks, Frame, Quality, QualityFlag, Settings};

use super::readings::ReadingsCache;
use super::{SessionReader, microseconds, wall};
use crate::row::{
    FrameExtras, StoredFrame, Stretch, late_map_checksum, mapper_checksum, unpack_trace,
};
use crate::{FrameRecord, LogbookError, MapRecord};

/// Number of frames fetched at a time while iterating.
const PAGE: u32 = 64;

impl SessionReader {
    /// One frame by its sequence, counted from [`crate::SessionHeader::first_sequence`].
    ///
    /// # Errors
    /// No such frame, or a damaged one.
    pub fn frame(&self, sequence: u64) -> Result<FrameRecord, LogbookError> {
        let row = self.row(sequence)?;
        let Some(row) = row else {
            return Err(LogbookError::NoSuchFrame {
                path: self.path.clone(),
                sequence,
                frames: self.len()?,
                first: self.header.first_sequence,
            });
        };
        self.unpack(row, &mut RowCache::default())
    }

    /// A frame without its map record if that cannot be read; for a repair.
    pub(crate) fn kept(&self, sequence: u64) -> Result<Option<FrameRecord>, LogbookError> {
        let row = self.row(sequence)?;
        let mut known = RowCache {
            without_maps: true,
            ..RowCache::default()
        };
        row.map(|row| self.unpack(row, &mut known)).transpose()
    }

    /// The sequence of the next frame after a given one.
    pub(crate) fn sequence_behind(&self, sequence: u64) -> Result<Option<u64>, LogbookError> {
        let sql = "SELECT min(sequence) FROM frame WHERE sequence > ?1";
        let behind = self.one_number(sql, [sequence as i64], "read the frames of")?;
        Ok(behind.map(|behind| behind as u64))
    }

    pub(super) fn row(&self, sequence: u64) -> Result<Option<StoredFrame>, LogbookError> {
        let sql = "SELECT * FROM frame WHERE sequence = ?1";
        self.one_row(sql, [sequence as i64], "read a frame of", StoredFrame::read)
    }

    /// All frames in order. A damaged frame yields an error; the frames after it follow.
    pub fn frames(&self) -> Frames<'_> {
        self.frames_from(1)
    }

    /// The frames from this sequence on.
    pub fn frames_from(&self, sequence: u64) -> Frames<'_> {
        self.frames_between(sequence, u64::MAX)
    }

    /// The frames from one sequence to another, which is included.
    pub fn frames_between(&self, first: u64, last: u64) -> Frames<'_> {
        Frames {
            session: self,
            next: first.max(1) as i64,
            last: i64::try_from(last).unwrap_or(i64::MAX),
            page: VecDeque::new(),
            known: RowCache::default(),
            ended: false,
        }
    }

    /// The last frame, if there is one.
    ///
    /// # Errors
    /// The file cannot be read, or that frame is damaged.
    pub fn last(&self) -> Result<Option<FrameRecord>, LogbookError> {
        match self.is_empty()? {
            true => Ok(None),
            false => self.frame(self.last_sequence()?).map(Some),
        }
    }

    fn page(&self, from: i64, last: i64) -> Result<VecDeque<StoredFrame>, LogbookError> {
        let available = self.bytes()?;
        let read = || -> rusqlite::Result<VecDeque<StoredFrame>> {
            let mut statement = self.ask().prepare_cached(
                "SELECT * FROM frame WHERE sequence BETWEEN ?1 AND ?2 ORDER BY sequence LIMIT ?3",
            )?;
            let mut rows = statement.query(params![from, last, PAGE])?;
            let (mut page, mut bytes) = (VecDeque::new(), 0);
            while let Some(row) = rows.next()? {
                let stored = StoredFrame::read(row)?;
                let size = stored.row.blob.as_ref().map_or(0, Vec::len) as i64;
                bytes += size as u64;
                if bytes > available {
                    // several rows claim the same pages: the size read into memory is limited
                    return Err(rusqlite::Error::IntegralValueOutOfRange(10, size));
                }
                page.push_back(stored);
            }
            Ok(page)
        };
        read().map_err(|source| LogbookError::reading(&self.path, "read the frames of", source))
    }

    pub(super) fn map_record(&self, id: i64, hash: &Value) -> Result<MapRecord, LogbookError> {
        let (hash, sum) = unpack_trace(hash)
            .ok_or_else(|| self.damaged("the hash of a map".into(), "it is no hash"))?;
        let sql = "SELECT method, model_hash, build, cpu, checksum FROM mapper WHERE id = ?1";
        let row = self.one_row(sql, [id], "read the map methods of", |row| {
            let record = MapRecord {
                hash,
                sum,
                method: row.get(0)?,
                model_hash: row.get(1)?,
                build: row.get(2)?,
                cpu: row.get(3)?,
            };
            Ok((record, row.get::<_, Vec<u8>>(4)?))
        })?;
        let place = || format!("map method {id}");
        let Some((record, checksum)) = row else {
            return Err(self.damaged(place(), "it is not there"));
        };
        if checksum != mapper_checksum(self.header_checksum, id, &record) {
            return Err(self.damaged(place(), "its checksum does not agree"));
        }
        Ok(record)
    }

    /// The record of a map that was computed after its frame was written.
    pub(super) fn late_map(&self, sequence: i64) -> Result<Option<MapRecord>, LogbookError> {
        let sql = "SELECT number, mapper, map_hash, checksum FROM late_map WHERE sequence = ?1";
        let late = self.one_row(sql, [sequence], "read the late maps of", |row| {
            let numbers: [i64; 3] = [row.get(0)?, row.get(1)?, row.get(3)?];
            Ok((numbers, row.get::<_, Value>(2)?))
        })?;
        let Some(([number, mapper, checksum], trace)) = late else {
            return Ok(None);
        };
        if checksum != late_map_checksum(self.header_checksum, sequence, number, mapper, &trace) {
            let place = format!("the late map of frame {sequence}");
            return Err(self.damaged(place, "its checksum does not agree"));
        }
        self.map_record(mapper, &trace).map(Some)
    }

    fn unpack(
        &self,
        stored: StoredFrame,
        known: &mut RowCache,
    ) -> Result<FrameRecord, LogbookError> {
        let StoredFrame { row, checksum } = stored;
        let place = || format!("frame {}", row.sequence);
        if checksum != row.checksum(self.header_checksum) {
            return Err(self.damaged(place(), "its checksum does not agree"));
        }
        let readings = self.readings(&row, &mut known.readings)?;
        let remarks: FrameExtras = match &row.remarks {
            Some(json) => serde_json::from_str(json)
                .map_err(|cause| self.damaged(place(), cause.to_string()))?,
            None => FrameExtras::default(),
        };
        let (stretch, settings) = match known.stretches.entry(row.stretch) {
            std::collections::btree_map::Entry::Occupied(there) => there.into_mut(),
            std::collections::btree_map::Entry::Vacant(empty) => {
                empty.insert(self.stretch(row.sequence, row.stretch)?)
            }
        };
        let (monotonic_us, wall_us) = stretch.times(&row);
        let frame = Frame {
            sequence: row.sequence as u64,
            readings,
            extra: Vec::new(),
            monotonic: microseconds(monotonic_us),
            wall: wall(wall_us),
            duration: microseconds(row.duration),
            settings: settings.clone(),
            compliance: remarks.compliance,
            simulated: stretch.simulated,
        };
        let map = match (stretch.mapper, &row.map_hash) {
            (Some(id), Some(hash)) => self.map_record(id, hash).map(Some),
            _ => self.late_map(row.sequence),
        };
        let map = match map {
            Err(_) if known.without_maps => None,
            found => found?,
        };
        let checks = self
            .checks
            .get_or_init(|| Checks::new(&self.header.protocol));
        Ok(FrameRecord {
            quality: Quality {
                reciprocity: checks.reciprocal(&frame),
                loop_sum: row.loop_sum,
                implausible: remarks.implausible,
                flags: QualityFlag::ALL
                    .into_iter()
                    .enumerate()
                    .filter_map(|(place, flag)| (row.flags >> place & 1 == 1).then_some(flag))
                    .collect(),
                ..Quality::counted(&frame)
            },
            frame,
            map,
        })
    }

    /// A stretch and its settings.
    pub(super) fn stretch(&self, of: i64, id: i64) -> Result<(Stretch, Settings), LogbookError> {
        let place = format!("stretch {id}, which frame {of} belongs to");
        let sql = "SELECT * FROM stretch WHERE id = ?1";
        let row = self.one_row(sql, [id], "read a stretch of", |row| {
            let stretch = Stretch {
                id,
                settings: row.get("settings")?,
                mapper: row.get("mapper")?,
                simulated: row.get("simulated")?,
                sequence: row.get("sequence")?,
                monotonic: row.get("monotonic_us")?,
                wall: row.get("wall_us")?,
                period: row.get("period_us")?,
            };
            Ok((stretch, row.get::<_, Vec<u8>>("checksum")?))
        })?;
        let Some((stretch, checksum)) = row else {
            return Err(self.damaged(place, "it is not there"));
        };
        if checksum != stretch.checksum(self.header_checksum) {
            return Err(self.damaged(place, "its checksum does not agree"));
        }
        let settings = self.settings(stretch.settings)?;
        Ok((stretch, settings))
    }
}

/// Frames of a session in order; made by [`SessionReader::frames`].
#[derive(Debug)]
pub struct Frames<'a> {
    session: &'a SessionReader,
    next: i64,
    last: i64,
    page: VecDeque<StoredFrame>,
    known: RowCache,
    ended: bool,
}

impl Iterator for Frames<'_> {
    type Item = Result<FrameRecord, LogbookError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.page.is_empty() && !self.ended {
            match self.session.page(self.next, self.last) {
                Ok(page) => {
                    // In a damaged file, rows out of order could be repeated for ever.
                    self.ended = page.iter().all(|stored| stored.row.sequence < self.next);
                    self.page = page;
                }
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
        match stored.row.sequence.checked_add(1) {
            Some(behind) => self.next = self.next.max(behind),
            None => self.ended = true,
        }
        Some(self.session.unpack(stored, &mut self.known))
    }
}

/// Cached lookups: consecutive frames mostly need the same rows.
#[derive(Debug, Default)]
struct RowCache {
    readings: ReadingsCache,
    stretches: BTreeMap<i64, (Stretch, Settings)>,
    /// Whether an unreadable map record counts as missing.
    without_maps: bool,
}
