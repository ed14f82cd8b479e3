//! Playback of recorded frames at a given speed.

use std::time::Duration;

use chrono::{DateTime, Utc};
use imaging::recorded::{IndexedFrames, RecordedError};
use survey::Frame;

/// How a recording is played.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Playing {
    /// Recorded frame rate; `None` if unknown.
    pub frames_per_s: Option<f64>,
    /// 1 for the recorded rate, 10 for ten times faster, 0 for as fast as possible.
    pub speed: f64,
}

/// A recording with the current position.
#[derive(Debug)]
pub(crate) struct Recording {
    frames: IndexedFrames,
    playing: Playing,
    position: u64,
    /// When the last frame was due, at the recorded rate, and its recorded times.
    last: Option<(Duration, Taken)>,
}

/// Time by the clock of the daemon that took a frame, and by the wall clock.
type Taken = (Duration, DateTime<Utc>);

impl Recording {
    /// Plays these frames from the first one on.
    pub(crate) fn new(frames: IndexedFrames, playing: Playing) -> Self {
        Self {
            frames,
            playing,
            position: 0,
            last: None,
        }
    }

    /// The frames of the recording.
    pub(crate) fn frames(&self) -> &IndexedFrames {
        &self.frames
    }

    /// Returns to the first frame, and sets the speed.
    pub(crate) fn rewind(&mut self, speed: Option<f64>) {
        self.position = 0;
        self.last = None;
        if let Some(speed) = speed {
            self.playing.speed = speed;
        }
    }

    /// Leaves out the next frame, which cannot be read. Returns its number, from 1.
    pub(crate) fn skip(&mut self) -> u64 {
        self.position += 1;
        self.position
    }

    /// When the next frame is due, counted from the first; `None` at the end. Always zero if played as fast as
    /// possible.
    ///
    /// # Errors
    /// The frame cannot be read.
    pub(crate) fn due(&self) -> Result<Option<Duration>, RecordedError> {
        if self.position >= self.frames.len() {
            return Ok(None);
        }
        let offset = match self.frames.taken(self.position)? {
            Some(taken) => self.offset(taken),
            None => self.playing.frames_per_s.map_or(Duration::ZERO, |rate| {
                survey::duration(self.position as f64 / rate)
            }),
        };
        let due = if self.playing.speed > 0.0 {
            survey::duration(offset.as_secs_f64() / self.playing.speed)
        } else {
            Duration::ZERO
        };
        Ok(Some(due))
    }

    /// When a frame with these times is due at the recorded rate. If the monotonic clock went back, because the session
    /// was resumed by the next daemon, the wall clock is used.
    fn offset(&self, (at, wall): Taken) -> Duration {
        let Some((due, (before, wall_before))) = self.last else {
            return Duration::ZERO;
        };
        let step = at.checked_sub(before).unwrap_or_else(|| {
            let step = wall.signed_duration_since(wall_before);
            step.to_std().unwrap_or_default()
        });
        due.saturating_add(step)
    }

    /// The next frame with the current time; `None` at the end.
    ///
    /// # Errors
    /// The frame cannot be read.
    pub(crate) fn next(
        &mut self,
        monotonic: Duration,
        wall: DateTime<Utc>,
    ) -> Result<Option<Frame>, RecordedError> {
        if self.position >= self.frames.len() {
            return Ok(None);
        }
        let frame = self.frames.frame(self.position, wall)?;
        let taken = (frame.monotonic, frame.wall);
        self.last = Some((self.offset(taken), taken));
        self.position += 1;
        Ok(Some(Frame { monotonic, ..frame }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use survey::{Amps, Protocol};

    fn recording(playing: Playing) -> (tempfile::TempDir, Recording) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames.csv");
        std::fs::write(&path, "1,1,1,1\n3,3,nan,3\n5,5,5,5\n").unwrap();
        let protocol = Protocol::sheffield(4).unwrap();
        let frames = IndexedFrames::table(&path, &protocol, Amps(1.0), false).unwrap();
        (folder, Recording::new(frames, playing))
    }

    const PLAIN: Playing = Playing {
        frames_per_s: Some(4.0),
        speed: 2.0,
    };
    const NOW: DateTime<Utc> = DateTime::UNIX_EPOCH;

    #[test]
    fn a_recording_keeps_its_rate_and_ends() {
        let (_folder, mut recording) = recording(PLAIN);
        let mut dues = Vec::new();
        while let Some(due) = recording.due().unwrap() {
            dues.push(due.as_millis());
            recording.next(Duration::ZERO, NOW).unwrap().unwrap();
        }
        assert_eq!(dues, [0, 125, 250]);
        assert!(recording.next(Duration::ZERO, NOW).unwrap().is_none());
        recording.rewind(Some(0.0));
        recording.next(Duration::ZERO, NOW).unwrap();
        assert_eq!(recording.due().unwrap(), Some(Duration::ZERO));
    }

    #[test]
    fn a_resumed_session_keeps_its_rate() {
        let (folder, table) = recording(PLAIN);
        let protocol = Protocol::sheffield(4).unwrap();
        let header = logbook::SessionHeader::new("monday", NOW, protocol);
        let mut writer = logbook::SessionWriter::create(folder.path(), &header).unwrap();
        let path = writer.path().to_owned();
        // the next daemon takes the third frame, 30 s after the second
        for (monotonic, wall) in [(5000, 0), (5010, 10), (3, 40), (13, 50)] {
            let wall = NOW + Duration::from_secs(wall);
            let frame = Frame {
                monotonic: Duration::from_secs(monotonic),
                wall,
                ..table.frames.frame(0, wall).unwrap()
            };
            writer.append(&frame, None).unwrap();
        }
        writer.close(NOW, "end").unwrap();
        let (frames, _) = IndexedFrames::session(&path, false).unwrap();
        let mut recording = Recording::new(frames, PLAIN);
        for _ in 0..2 {
            let mut dues = Vec::new();
            while let Some(due) = recording.due().unwrap() {
                dues.push(due.as_secs());
                recording.next(Duration::ZERO, NOW).unwrap().unwrap();
            }
            assert_eq!(dues, [0, 5, 20, 25]);
            recording.rewind(None);
        }
    }
}
