//! A recorded session with all its parts as one sequence, read frame by frame.

use std::path::Path;

use chrono::{DateTime, Utc};
use logbook::{Event, FrameRecord, LogbookError, SessionHeader, SessionReader};
use survey::Baseline;

/// The parts of a session in order, at least one.
#[derive(Debug)]
pub struct SessionParts(Vec<SessionReader>);

impl SessionParts {
    /// Opens a session: from its first part with all later parts, or a later part alone.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn open(path: &Path) -> Result<Self, LogbookError> {
        let mut parts = vec![SessionReader::open(path)?];
        if parts[0].header().continues.is_none() {
            let all = logbook::parts(path)?;
            let named = path.file_name();
            for other in all.iter().filter(|other| other.file_name() != named) {
                match SessionReader::open(other) {
                    // the creation of this part was interrupted; it never contained frames
                    Err(LogbookError::NotASession { .. }) => {}
                    part => parts.push(part?),
                }
            }
        }
        Ok(Self(parts))
    }

    /// The header of the part that was opened.
    pub fn header(&self) -> &SessionHeader {
        self.0[0].header()
    }

    /// The reader of each part.
    pub fn each(&self) -> &[SessionReader] {
        &self.0
    }

    /// The baseline, which is the same in every part.
    ///
    /// # Errors
    /// The baseline cannot be read.
    pub fn baseline(&self) -> Result<Option<Baseline>, LogbookError> {
        self.0[0].baseline()
    }

    /// The events of all parts, in their order.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn events(&self) -> Result<Vec<Event>, LogbookError> {
        let mut events = Vec::new();
        for part in &self.0 {
            events.extend(part.events()?);
        }
        Ok(events)
    }

    /// Number of frames.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn len(&self) -> Result<u64, LogbookError> {
        let mut frames = 0;
        for (part, next) in self.with_next() {
            let last = part.last_sequence()?;
            let begun_again = next.map_or(0, |next| (last + 1).saturating_sub(next));
            frames += part.len()?.saturating_sub(begun_again);
        }
        Ok(frames)
    }

    /// Whether there is no frame.
    ///
    /// # Errors
    /// As [`SessionParts::len`].
    pub fn is_empty(&self) -> Result<bool, LogbookError> {
        Ok(self.len()? == 0)
    }

    /// Sequence number of the last frame in [`SessionParts::frames`], also if the last part has no frames or a part
    /// before it is missing. One less than the first sequence number if there are no frames.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn last_sequence(&self) -> Result<u64, LogbookError> {
        let parts: Vec<_> = self.with_next().collect();
        for (part, next) in parts.into_iter().rev() {
            let own = part.last_sequence()?;
            let last = next.map_or(own, |next| own.min(next.saturating_sub(1)));
            if last >= part.header().first_sequence {
                return Ok(last);
            }
        }
        Ok(self.header().first_sequence.saturating_sub(1))
    }

    /// The last frame; `None` if there are none.
    ///
    /// # Errors
    /// A part cannot be read, or the frame is damaged.
    pub fn last(&self) -> Result<Option<FrameRecord>, LogbookError> {
        let last = self.last_sequence()?;
        match last < self.header().first_sequence {
            true => Ok(None),
            false => self.frame(last).map(Some),
        }
    }

    /// The frame with this sequence number.
    ///
    /// # Errors
    /// It does not exist or is damaged.
    pub fn frame(&self, sequence: u64) -> Result<FrameRecord, LogbookError> {
        let mut before = self.0.iter().rev();
        let part = before.find(|part| part.header().first_sequence <= sequence);
        part.unwrap_or(&self.0[0]).frame(sequence)
    }

    /// All frames in order, each read on demand.
    pub fn frames(&self) -> impl Iterator<Item = Result<FrameRecord, LogbookError>> {
        self.frames_from(1)
    }

    /// The frames from a sequence number on, as [`SessionParts::frames`].
    pub fn frames_from(
        &self,
        sequence: u64,
    ) -> impl Iterator<Item = Result<FrameRecord, LogbookError>> {
        self.frames_between(sequence, u64::MAX)
    }

    /// The frames from one sequence number to another, which is included, as [`SessionParts::frames`].
    pub fn frames_between(
        &self,
        first: u64,
        last: u64,
    ) -> impl Iterator<Item = Result<FrameRecord, LogbookError>> {
        self.with_next()
            .filter(move |(_, next)| next.is_none_or(|next| next > first))
            .take_while(move |(part, _)| part.header().first_sequence <= last)
            .flat_map(move |(part, next)| {
                // frames from the first sequence number of the next part on were written again to that part
                let own = next.map_or(u64::MAX, |next| next.saturating_sub(1));
                part.frames_between(first, last.min(own))
            })
    }

    /// Number and wall time of each frame from the last one back, without its readings; the checksums are not verified.
    pub fn wall_times_back(
        &self,
    ) -> impl Iterator<Item = Result<(u64, DateTime<Utc>), LogbookError>> {
        let parts: Vec<_> = self.with_next().collect();
        parts.into_iter().rev().flat_map(|(part, next)| {
            let own = next.map_or(u64::MAX, |next| next.saturating_sub(1));
            part.wall_times_back(1, own)
        })
    }

    /// Each part, and the first sequence number of the next.
    fn with_next(&self) -> impl Iterator<Item = (&SessionReader, Option<u64>)> {
        let next = self.0.iter().skip(1);
        let begins = next.map(|part| Some(part.header().first_sequence));
        self.0.iter().zip(begins.chain([None]))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use logbook::SessionWriter;
    use survey::{Amps, Frame, Precautions, Protocol, Reading, Settings, Volts};

    use super::*;

    /// The session `m1` in parts with the frames 1 and 2, 3 and 4, and none.
    fn in_parts(folder: &Path) {
        let protocol = Protocol::sheffield(4).unwrap();
        let at = DateTime::UNIX_EPOCH;
        let header = SessionHeader::new("m1", at, protocol.clone());
        let mut writer = SessionWriter::create(folder, &header).unwrap();
        for number in 1..=4 {
            let frame = Frame {
                sequence: number,
                readings: vec![Reading::Ok(Volts(1.0)); 4],
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
            if number % 2 == 0 {
                writer.roll(at).unwrap();
            }
        }
        writer.close(at, "end").unwrap();
    }

    #[test]
    fn the_last_frame_is_the_last_that_is_there() {
        let folder = tempfile::tempdir().unwrap();
        in_parts(folder.path());
        let file = |name: &str| folder.path().join(name);
        let last = |name: &str| {
            let parts = SessionParts::open(&file(name)).unwrap();
            let last = parts.last().unwrap().map(|record| record.frame.sequence);
            (parts.last_sequence().unwrap(), last)
        };
        assert_eq!(last("m1.tactus"), (4, Some(4)));
        assert_eq!(last("m1_p3.tactus"), (4, None), "this part alone");
        let back = |name: &str| {
            let parts = SessionParts::open(&file(name)).unwrap();
            let times = parts.wall_times_back().map(Result::unwrap);
            times
                .map(|(number, wall)| (number, wall.timestamp()))
                .collect::<Vec<_>>()
        };
        assert_eq!(back("m1.tactus"), [(4, 4), (3, 3), (2, 2), (1, 1)]);
        std::fs::remove_file(file("m1_p2.tactus")).unwrap();
        assert_eq!(last("m1.tactus"), (2, Some(2)));
        assert_eq!(back("m1.tactus"), [(2, 2), (1, 1)]);
    }
}
