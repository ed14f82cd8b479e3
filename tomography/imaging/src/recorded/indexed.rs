//! Recorded frames by index, in the form of newly acquired frames, for a rig that plays a recording.

use std::path::Path;
use std::time::Duration;

use chrono::{DateTime, Utc};
use survey::{Amps, Baseline, Frame, Precautions, Protocol, Settings, Volts};

use super::readings::change_signs;
use super::{BaselineRule, FRAMES, Provenance, RecordedError, SessionParts, read_frames};

/// Source of the voltages.
#[derive(Debug)]
enum Source {
    Table {
        frames: Vec<Vec<survey::Reading>>,
        settings: Settings,
    },
    Session {
        parts: SessionParts,
        frames: u64,
    },
}

/// Recorded frames with random access: a table, or a session with all its parts.
#[derive(Debug)]
pub struct IndexedFrames {
    source: Source,
    negate: bool,
    simulated: bool,
}

impl IndexedFrames {
    /// Opens a table of frames measured with this protocol and current. `negate` inverts every sign.
    ///
    /// # Errors
    /// [`RecordedError::Frames`].
    pub fn table(
        frames: &Path,
        protocol: &Protocol,
        current: Amps,
        negate: bool,
    ) -> Result<Self, RecordedError> {
        let name = frames.file_name().unwrap_or(frames.as_os_str());
        let folder = frames.parent().filter(|_| name == FRAMES);
        let provenance = folder.map(Provenance::of).transpose()?.flatten();
        Ok(Self {
            source: Source::Table {
                frames: read_frames(frames, protocol.len(), negate)?
                    .into_iter()
                    .map(|(_, readings)| readings)
                    .collect(),
                settings: Settings {
                    protocol_hash: protocol.hash(),
                    current,
                    // a table does not contain the range of its voltages
                    range: Volts(0.0),
                    nplc: 0.0,
                    settle: Duration::ZERO,
                    wiring: format!("recording {}", name.to_string_lossy()),
                    precautions: Precautions::default(),
                },
            },
            negate,
            simulated: provenance.is_some_and(|from| from.simulated),
        })
    }

    /// Opens a session: from its first part with all later parts, or a later part alone. Also returns the protocol.
    /// `negate` inverts every sign.
    ///
    /// # Errors
    /// [`RecordedError::Session`].
    pub fn session(path: &Path, negate: bool) -> Result<(Self, Protocol), RecordedError> {
        let parts = SessionParts::open(path)?;
        let protocol = parts.header().protocol.clone();
        let first_sequence = parts.header().first_sequence;
        // counted by sequence numbers, so that a frame lost between two parts is reported as unreadable, like one lost
        // within a part
        let frames = (parts.last_sequence()? + 1).saturating_sub(first_sequence);
        if frames > 0 {
            parts.frame(first_sequence)?;
        }
        let opened = Self {
            simulated: parts.header().simulated,
            negate,
            source: Source::Session { parts, frames },
        };
        Ok((opened, protocol))
    }

    /// Whether the voltages are simulated.
    pub fn is_simulated(&self) -> bool {
        self.simulated
    }

    /// The configuration of the session; `None` for files without one.
    pub fn kept_config(&self) -> Option<&str> {
        match &self.source {
            Source::Table { .. } => None,
            Source::Session { parts, .. } => {
                Some(parts.header().config_toml.as_str()).filter(|text| !text.is_empty())
            }
        }
    }

    /// Number of frames.
    pub fn len(&self) -> u64 {
        match &self.source {
            Source::Table { frames, .. } => frames.len() as u64,
            Source::Session { frames, .. } => *frames,
        }
    }

    /// Whether there is no frame.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The settings of the frames; `None` if unknown.
    pub fn settings(&self) -> Option<Settings> {
        match &self.source {
            Source::Table { settings, .. } => Some(settings.clone()),
            Source::Session { parts, .. } => {
                let first = parts.header().first_sequence;
                Some(parts.frame(first).ok()?.frame.settings)
            }
        }
    }

    /// Times of the original frame: by the monotonic clock of the daemon that took it, which restarts when the next
    /// daemon resumes the session, and by the wall clock. `None` for a table, which has no times.
    ///
    /// # Errors
    /// The frame cannot be read.
    pub fn taken(&self, index: u64) -> Result<Option<(Duration, DateTime<Utc>)>, RecordedError> {
        match &self.source {
            Source::Table { .. } => Ok(None),
            Source::Session { parts, .. } => {
                let sequence = parts.header().first_sequence + index;
                let frame = parts.frame(sequence)?.frame;
                Ok(Some((frame.monotonic, frame.wall)))
            }
        }
    }

    /// The frame at this index, from 0 to below [`IndexedFrames::len`]. A frame of a table gets the time `wall`.
    ///
    /// # Errors
    /// The frame cannot be read.
    pub fn frame(&self, index: u64, wall: DateTime<Utc>) -> Result<Frame, RecordedError> {
        match &self.source {
            Source::Table { frames, settings } => Ok(Frame {
                sequence: 0,
                readings: frames[index as usize].clone(),
                monotonic: Duration::ZERO,
                wall,
                duration: Duration::ZERO,
                settings: settings.clone(),
                extra: Vec::new(),
                compliance: Vec::new(),
                simulated: self.simulated,
            }),
            Source::Session { parts, .. } => {
                // a later part of a session continues the sequence numbers
                let sequence = parts.header().first_sequence + index;
                let mut frame = parts.frame(sequence)?.frame;
                if self.negate {
                    change_signs(&mut frame.readings);
                }
                Ok(frame)
            }
        }
    }

    /// The baseline: the mean of the first N frames (`first:N`), or of the frames in a file. Default: a session's own
    /// baseline, or a table's first frame.
    ///
    /// # Errors
    /// A rule or a file without frames, or frames that contradict each other.
    pub fn baseline(
        &self,
        rule: Option<&str>,
        protocol: &Protocol,
        wall: DateTime<Utc>,
    ) -> Result<Baseline, RecordedError> {
        let requested = match (rule, &self.source) {
            (Some(requested), _) => requested,
            (None, Source::Table { .. }) => "first:1",
            (None, Source::Session { parts, .. }) => {
                let path = parts.each()[0].path();
                let missing = || RecordedError::NoBaseline(path.display().to_string());
                let mut own = parts.baseline()?.ok_or_else(missing)?;
                if self.negate {
                    change_signs(&mut own.readings);
                }
                return Ok(own);
            }
        };
        let refused = || RecordedError::First {
            requested: requested.to_owned(),
            frames: self.len() as usize,
        };
        let frames: Vec<Frame> = match requested.parse().map_err(|_| refused())? {
            BaselineRule::First(count) if count as u64 > self.len() => return Err(refused()),
            BaselineRule::First(count) => (0..count as u64)
                .map(|index| self.frame(index, wall))
                .collect::<Result<_, _>>()?,
            BaselineRule::File(file) => {
                let settings = self.settings();
                let current = settings
                    .as_ref()
                    .map_or(Amps(1.0), |settings| settings.current);
                let file = Self::table(&file, protocol, current, self.negate)?;
                (0..file.len())
                    .map(|index| {
                        let mut frame = file.frame(index, wall)?;
                        if let Some(settings) = &settings {
                            frame.settings = settings.clone();
                        }
                        Ok(frame)
                    })
                    .collect::<Result<_, RecordedError>>()?
            }
        };
        let mut baseline = Baseline::from_frames("recording", &frames).map_err(|cause| {
            RecordedError::Baseline {
                requested: requested.to_owned(),
                cause,
            }
        })?;
        baseline.simulated = self.simulated;
        Ok(baseline)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use logbook::{SessionHeader, SessionWriter};
    use survey::Reading;

    const NOW: DateTime<Utc> = DateTime::UNIX_EPOCH;

    fn table(negate: bool) -> (tempfile::TempDir, Protocol, IndexedFrames) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames.csv");
        std::fs::write(&path, "1,1,1,1\n3,3,nan,3\n5,5,5,5\n").unwrap();
        let protocol = Protocol::sheffield(4).unwrap();
        let frames = IndexedFrames::table(&path, &protocol, Amps(1.0), negate).unwrap();
        (folder, protocol, frames)
    }

    #[test]
    fn signs_change_in_frames_and_baseline_alike() {
        let (_folder, protocol, frames) = table(true);
        let baseline = frames.baseline(Some("first:2"), &protocol, NOW).unwrap();
        assert_eq!(baseline.readings[0], Reading::Ok(Volts(-2.0)));
        assert_eq!(baseline.readings[2], Reading::Ok(Volts(-1.0)));
        let frame = frames.frame(1, NOW).unwrap();
        assert_eq!(frame.readings[2], Reading::NotMeasured);
        assert!(baseline.check(&frame.settings, 4, false).is_ok());
    }

    #[test]
    fn a_baseline_of_more_frames_than_there_are_is_refused() {
        let (_folder, protocol, frames) = table(false);
        for requested in ["first:0", "first:4", "first:x"] {
            let error = frames
                .baseline(Some(requested), &protocol, NOW)
                .unwrap_err()
                .to_string();
            assert!(
                error.contains(requested) && error.contains("has 3"),
                "{error}"
            );
        }
    }

    #[test]
    fn session_in_parts_is_played_to_its_end() {
        let (folder, protocol, table) = table(false);
        let header = SessionHeader::new("monday", NOW, protocol);
        let mut writer = SessionWriter::create(folder.path(), &header).unwrap();
        let first = writer.path().to_owned();
        for index in 0..3 {
            let frame = Frame {
                monotonic: Duration::from_secs(10 + 2 * index),
                ..table.frame(index, NOW).unwrap()
            };
            writer.append(&frame, None).unwrap();
            writer.roll(NOW).unwrap();
        }
        writer.close(NOW, "end").unwrap();
        let (session, _) = IndexedFrames::session(&first, true).unwrap();
        assert_eq!(session.len(), 3);
        let last = session.frame(2, NOW).unwrap();
        assert_eq!(last.readings, [Reading::Ok(Volts(-5.0)); 4]);
        let first = session.taken(0).unwrap();
        assert_eq!(first, Some((Duration::from_secs(10), NOW)));
        let last = session.taken(2).unwrap();
        assert_eq!(last, Some((Duration::from_secs(14), NOW)));
    }
}
