//! A recording for offline reconstruction: a case folder with measured frames, or a session of the logbook.

use std::path::{Path, PathBuf};

use chrono::{DateTime, Utc};
use logbook::{Event, FrameRecord, LogbookError, MapRecord, SessionHeader};
use survey::{Amps, Protocol, Reading};

use super::readings::{change_signs, first, mean};
use super::{
    BaselineRule, FrameTable, LabelledReadings, RecordedError, SessionParts, TableOptions,
    Unloaded, read_frames,
};
use crate::noise::{against, rms_deviation};
use crate::tracking::{Orders, TrackingState, kept, seconds};

/// One frame of a recording.
#[derive(Debug, Clone)]
pub struct RecordedFrame {
    /// Its number in the session or table ([`FrameTable::numbers`]).
    pub sequence: u64,
    /// Its label in the table; otherwise its number.
    pub label: String,
    /// Time, if recorded.
    pub wall: Option<DateTime<Utc>>,
    /// Its readings, with inverted signs if requested.
    pub readings: Vec<Reading>,
    /// The stored record of the map made during the session.
    pub map: Option<MapRecord>,
}

impl RecordedFrame {
    /// Time of the frame, s since the Unix epoch. Without a recorded time: its number times `period_s`; `None` if that
    /// is unknown too.
    pub fn time_s(&self, period_s: Option<f64>) -> Option<f64> {
        let counted = || period_s.map(|period_s| period_s * self.sequence as f64);
        self.wall.map(seconds).or_else(counted)
    }
}

/// Origin of a recording; it also determines the mesh.
#[derive(Debug, Clone)]
pub enum Origin {
    /// A case folder, possibly with a mesh.
    Folder(PathBuf),
    /// A session, whose configuration names the geometry.
    Session(Box<SessionHeader>),
}

/// Source of the frames.
#[derive(Debug)]
enum Source {
    /// A table, in memory.
    Table(Vec<RecordedFrame>),
    /// A session of any length, read frame by frame.
    Session { parts: SessionParts, negate: bool },
}

/// Frames with their baseline.
#[derive(Debug)]
pub struct Recording {
    /// Its name: a session's id, or the folder.
    pub name: String,
    /// The readings of a frame.
    pub protocol: Protocol,
    source: Source,
    /// The baseline.
    pub unloaded: Unloaded,
    /// Description of the frames averaged for the baseline, or the id of the session's own.
    pub baseline_name: String,
    /// Time of the session's own baseline; `None` if another baseline is used, and for a folder.
    pub baseline_at: Option<DateTime<Utc>>,
    /// Noise of one reading from the session's own baseline, V, which the daemon used if the configuration states none.
    /// `None` if another baseline is used, and for a folder.
    pub baseline_noise_v: Option<f64>,
    /// Current of the frames.
    pub current: Amps,
    /// Whether the voltages are simulated; `None` if unknown.
    pub simulated: Option<bool>,
    /// Its origin.
    pub origin: Origin,
}

impl Recording {
    /// Reads the frames of a case folder. `electrodes`: number of electrodes, used if the protocol does not state it.
    ///
    /// # Errors
    /// A protocol, table or baseline that cannot be read.
    pub fn from_folder(
        folder: &Path,
        options: &TableOptions<'_>,
        electrodes: Option<usize>,
    ) -> Result<Self, RecordedError> {
        let protocol_file = folder.join("protocol.csv");
        let (protocol, currents) =
            eit::read_protocol(&protocol_file, electrodes).map_err(RecordedError::Protocol)?;
        let current = one_current(&protocol_file, &currents)?;
        let table = FrameTable::read(folder, options, protocol.len())?;
        let frames = table
            .frames
            .into_iter()
            .zip(table.numbers)
            .map(|((label, readings), sequence)| RecordedFrame {
                sequence,
                label,
                wall: None,
                readings,
                map: None,
            })
            .collect();
        Ok(Self {
            name: folder.display().to_string(),
            protocol,
            source: Source::Table(frames),
            unloaded: table.unloaded,
            baseline_name: table.baseline_name,
            baseline_at: None,
            baseline_noise_v: None,
            current,
            simulated: table.provenance.map(|from| from.simulated),
            origin: Origin::Folder(folder.to_owned()),
        })
    }

    /// Opens a session with all its parts. `baseline` replaces the session's own.
    ///
    /// # Errors
    /// A part that cannot be read, or no baseline.
    pub fn from_session(
        path: &Path,
        baseline: Option<&BaselineRule>,
        negate: bool,
    ) -> Result<Self, RecordedError> {
        let parts = SessionParts::open(path)?;
        let header = parts.header().clone();
        let own = parts.baseline()?;
        let protocol = header.protocol.clone();
        let first_readable = parts.frames().find_map(Result::ok);
        let current = first_readable
            .map(|record| record.frame.settings.current)
            .or(own.as_ref().map(|baseline| baseline.settings.current))
            .unwrap_or(Amps(1.0));
        let used = own.as_ref().filter(|_| baseline.is_none());
        let (baseline_at, baseline_noise_v) = (used.map(|own| own.wall), used.map(against));
        let (unloaded, baseline_name) = match baseline {
            None => {
                let mut own = own.ok_or_else(|| RecordedError::NoBaseline(header.id.clone()))?;
                if negate {
                    change_signs(&mut own.readings);
                }
                let noise = rms_deviation(&own);
                let unloaded = Unloaded {
                    readings: own.readings,
                    noise,
                };
                (unloaded, own.id)
            }
            Some(rule @ BaselineRule::First(count)) => {
                let frames = recorded(&parts, 0, u64::MAX, negate).take(*count);
                let frames: Vec<LabelledReadings> = frames
                    .map(|frame| frame.map(|frame| (frame.label, frame.readings)))
                    .collect::<Result<_, _>>()?;
                (first(&frames, *count)?, rule.to_string())
            }
            Some(rule @ BaselineRule::File(file)) => {
                let frames = read_frames(file, protocol.len(), negate)?;
                (mean(&frames), rule.to_string())
            }
        };
        Ok(Self {
            name: header.id.clone(),
            protocol,
            source: Source::Session { parts, negate },
            unloaded,
            baseline_name,
            baseline_at,
            baseline_noise_v,
            current,
            simulated: Some(header.simulated),
            origin: Origin::Session(Box::new(header)),
        })
    }

    /// The frame with this number.
    ///
    /// # Errors
    /// It does not exist or cannot be read.
    pub fn frame(&self, sequence: u64) -> Result<RecordedFrame, LogbookError> {
        match &self.source {
            Source::Table(rows) => {
                let found = rows.iter().find(|frame| frame.sequence == sequence);
                found.cloned().ok_or_else(|| LogbookError::NoSuchFrame {
                    path: PathBuf::from(&self.name),
                    sequence,
                    frames: rows.len() as u64,
                    first: 1,
                })
            }
            Source::Session { parts, negate } => Ok(of_record(parts.frame(sequence)?, *negate)),
        }
    }

    /// Number of frames in [`Recording::frames`], including unreadable ones.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn len(&self) -> Result<usize, LogbookError> {
        Ok(match &self.source {
            Source::Table(rows) => rows.len(),
            Source::Session { parts, .. } => usize::try_from(parts.len()?).unwrap_or(usize::MAX),
        })
    }

    /// Whether there is no frame.
    ///
    /// # Errors
    /// As [`Recording::len`].
    pub fn is_empty(&self) -> Result<bool, LogbookError> {
        Ok(self.len()? == 0)
    }

    /// The state of the tracked baseline at the start of a session; `None` if the session began with the baseline
    /// itself, or another baseline is used.
    ///
    /// # Errors
    /// A state that cannot be read or is damaged.
    pub fn tracking(&self) -> Result<Option<TrackingState>, RecordedError> {
        let (Origin::Session(header), Some(_)) = (&self.origin, self.baseline_at) else {
            return Ok(None);
        };
        let Source::Session { parts, .. } = &self.source else {
            return Ok(None);
        };
        let path = parts.each()[0].path();
        let folder = logbook::folder_of(path);
        Ok(kept(folder, header.session())?)
    }

    /// The events of a session, in their order; a table has none.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn events(&self) -> Result<Vec<Event>, LogbookError> {
        match &self.source {
            Source::Table(_) => Ok(Vec::new()),
            Source::Session { parts, .. } => parts.events(),
        }
    }

    /// The orders that users gave to the tracked baseline of a session; a table has none.
    ///
    /// # Errors
    /// A part that cannot be read, or an order that this version does not support.
    pub fn orders(&self) -> Result<Orders, LogbookError> {
        Orders::recorded(&self.events()?, Path::new(&self.name), 0)
    }

    /// Whether its frames have times.
    pub fn has_times(&self) -> bool {
        self.first_time().is_some()
    }

    /// When the baseline was recorded, s, for [`Tracking`](crate::Tracking): its own time, or that of the first frame;
    /// 0 without times.
    pub fn baseline_s(&self) -> f64 {
        let time = self.baseline_at.or_else(|| self.first_time());
        time.map_or(0.0, seconds)
    }

    fn first_time(&self) -> Option<DateTime<Utc>> {
        self.frames().find_map(Result::ok)?.wall
    }

    /// The frames in order, with an error for each unreadable one.
    pub fn frames(&self) -> Box<dyn Iterator<Item = Result<RecordedFrame, LogbookError>> + '_> {
        self.frames_from(0)
    }

    /// The frames from a sequence number on, as [`Recording::frames`].
    pub fn frames_from(
        &self,
        sequence: u64,
    ) -> Box<dyn Iterator<Item = Result<RecordedFrame, LogbookError>> + '_> {
        self.frames_between(sequence, u64::MAX)
    }

    /// The frames from one sequence number to another, which is included, as [`Recording::frames`].
    pub fn frames_between(
        &self,
        first: u64,
        last: u64,
    ) -> Box<dyn Iterator<Item = Result<RecordedFrame, LogbookError>> + '_> {
        match &self.source {
            Source::Table(rows) => {
                let within = move |row: &&RecordedFrame| (first..=last).contains(&row.sequence);
                Box::new(rows.iter().filter(within).cloned().map(Ok))
            }
            Source::Session { parts, negate } => Box::new(recorded(parts, first, last, *negate)),
        }
    }

    /// Number and wall time of each frame from the last one back, without its readings; the checksums are not verified.
    /// A table has no times.
    pub fn wall_times_back(
        &self,
    ) -> impl Iterator<Item = Result<(u64, DateTime<Utc>), LogbookError>> {
        let parts = match &self.source {
            Source::Table(_) => None,
            Source::Session { parts, .. } => Some(parts),
        };
        parts.into_iter().flat_map(SessionParts::wall_times_back)
    }

    /// The last readable frame that was taken at or before a time, or the first frame if all are later. `None` without
    /// frames or times.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn frame_at(&self, time: DateTime<Utc>) -> Result<Option<RecordedFrame>, LogbookError> {
        let Some((first, last)) = self.ends()? else {
            return Ok(None);
        };
        // the frame is in first..end
        let (mut from, mut end) = (first, last + 1);
        let readable = |from: u64, end: u64| {
            let frame = self.frames_from(from).find_map(Result::ok);
            frame.filter(|frame| frame.sequence < end)
        };
        let mut found = readable(from, end).filter(|frame| frame.wall.is_some());
        while end - from > 1 {
            let middle = from + (end - from) / 2;
            match readable(middle, end) {
                Some(frame) if frame.wall.is_some_and(|wall| wall <= time) => {
                    from = frame.sequence;
                    found = Some(frame);
                }
                Some(_) | None => end = middle,
            }
        }
        Ok(found)
    }

    /// Sequence numbers of the first and the last frame; `None` without frames.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn ends(&self) -> Result<Option<(u64, u64)>, LogbookError> {
        let first = self.frames().find_map(Result::ok);
        let last = match &self.source {
            Source::Table(rows) => rows.last().map_or(0, |row| row.sequence),
            Source::Session { parts, .. } => parts.last_sequence()?,
        };
        Ok(first.map(|first| (first.sequence, last.max(first.sequence))))
    }
}

fn recorded(
    parts: &SessionParts,
    first: u64,
    last: u64,
    negate: bool,
) -> impl Iterator<Item = Result<RecordedFrame, LogbookError>> {
    let frame = move |record: Result<FrameRecord, _>| Ok(of_record(record?, negate));
    parts.frames_between(first, last).map(frame)
}

fn of_record(record: FrameRecord, negate: bool) -> RecordedFrame {
    let mut readings = record.frame.readings;
    if negate {
        change_signs(&mut readings);
    }
    RecordedFrame {
        sequence: record.frame.sequence,
        label: record.frame.sequence.to_string(),
        wall: Some(record.frame.wall),
        readings,
        map: record.map,
    }
}

/// The current of all readings, A.
///
/// # Errors
/// [`RecordedError::Currents`], with the `file` of the currents, if readings have different currents.
pub fn one_current(file: &Path, currents: &[f64]) -> Result<Amps, RecordedError> {
    let current = currents.first().copied().unwrap_or(1.0);
    if currents.iter().any(|other| *other != current) {
        return Err(RecordedError::Currents(file.to_owned()));
    }
    Ok(Amps(current))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use logbook::SessionWriter;
    use survey::{Frame, Precautions, Settings, Volts};

    use super::*;

    #[test]
    fn time_of_a_frame_is_recorded_or_counted_or_unknown() {
        let frame = |wall| RecordedFrame {
            sequence: 3,
            label: "f3".to_owned(),
            wall,
            readings: Vec::new(),
            map: None,
        };
        assert_eq!(frame(None).time_s(None), None);
        assert_eq!(frame(None).time_s(Some(10.0)), Some(30.0));
        let at = DateTime::UNIX_EPOCH + Duration::from_secs(7);
        assert_eq!(frame(Some(at)).time_s(None), Some(7.0));
    }

    #[test]
    fn baseline_of_first_frames_refuses_an_unreadable_one() {
        let folder = tempfile::tempdir().unwrap();
        let protocol = Protocol::sheffield(4).unwrap();
        let at = DateTime::UNIX_EPOCH;
        let header = SessionHeader::new("monday", at, protocol.clone());
        let mut writer = SessionWriter::create(folder.path(), &header).unwrap();
        let path = writer.path().to_owned();
        for number in 1..=3 {
            let frame = Frame {
                sequence: number,
                readings: vec![Reading::Ok(Volts(number as f64)); 4],
                monotonic: Duration::from_secs(number),
                wall: at + Duration::from_secs(number),
                duration: Duration::from_millis(500),
                settings: Settings {
                    protocol_hash: protocol.hash(),
                    current: Amps(1.0),
                    range: Volts(10.0),
                    nplc: 1.0,
                    settle: Duration::ZERO,
                    wiring: "wiring".to_owned(),
                    precautions: Precautions::default(),
                },
                extra: Vec::new(),
                compliance: Vec::new(),
                simulated: false,
            };
            writer.append(&frame, None).unwrap();
        }
        writer.close(at, "end").unwrap();
        let opened = |count| {
            let rule = BaselineRule::First(count);
            Recording::from_session(&path, Some(&rule), false)
        };
        let baseline = opened(2).unwrap().unloaded;
        assert_eq!(baseline.readings[0], Reading::Ok(Volts(1.5)));
        let file = rusqlite::Connection::open(&path).unwrap();
        file.execute(
            "UPDATE frame SET checksum = checksum + 1 WHERE sequence = 2",
            [],
        )
        .unwrap();
        drop(file);
        assert!(opened(1).is_ok());
        let refused = opened(2).unwrap_err();
        let damaged = matches!(
            &refused,
            RecordedError::Session(LogbookError::Damaged { .. })
        );
        assert!(damaged, "{refused:?}");
    }
}
