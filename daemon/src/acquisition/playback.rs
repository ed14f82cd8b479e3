//! Frames measured before: a session of the logbook, or a case folder with frames as CSV.

use std::path::{Path, PathBuf};
use std::time::Duration;

use chrono::{DateTime, Utc};
use logbook::{LogbookError, SessionReader};
use survey::{
    Amps, Baseline, BaselineError, Frame, Precautions, Protocol, Reading, Settings, Volts,
};

/// Why a recording cannot be played.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RecordingError {
    /// The session file.
    #[error("the recorded session cannot be read")]
    Session(#[from] LogbookError),
    /// The CSV files.
    #[error(transparent)]
    Case(#[from] eit::CaseError),
    /// `first:N` that is no number, or more frames than there are.
    #[error(
        "baseline '{asked}' asks for the first frames of a recording that has {frames}; write first:1 to first:{frames}"
    )]
    First { asked: String, frames: usize },
    /// The frames do not make a baseline.
    #[error("the frames of '{asked}' do not make a baseline")]
    Baseline {
        asked: String,
        #[source]
        cause: BaselineError,
    },
    /// A session without one.
    #[error("session {0} has no baseline; say which frames are it: baseline = \"first:N\"")]
    NoBaseline(PathBuf),
}

/// How a recording is played.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Playing {
    /// Change every sign: an instrument that gives magnitudes.
    pub negate: bool,
    /// Frames a second as they were measured; `None` where nobody knows.
    pub frames_per_s: Option<f64>,
    /// 1 its own rate, 10 ten times faster, 0 as fast as possible.
    pub speed: f64,
}

/// Where the voltages are.
#[derive(Debug)]
enum Tape {
    Csv {
        frames: Vec<Vec<Option<f64>>>,
        settings: Settings,
    },
    Session {
        reader: Box<SessionReader>,
        frames: u64,
        first: Duration,
    },
}

/// A recording in the machine, with the place it has come to.
#[derive(Debug)]
pub(crate) struct Recording {
    tape: Tape,
    playing: Playing,
    position: u64,
    simulated: bool,
}

impl Recording {
    /// Opens a CSV of frames measured with this protocol and current.
    pub(crate) fn csv(
        frames: &Path,
        protocol: &Protocol,
        current: Amps,
        playing: Playing,
    ) -> Result<Self, RecordingError> {
        let name = name_of(frames);
        Ok(Self {
            tape: Tape::Csv {
                frames: eit::read_frames(frames, protocol.len())?,
                settings: Settings {
                    protocol_hash: protocol.hash(),
                    current,
                    // a CSV does not say how its voltages were taken
                    range: Volts(0.0),
                    nplc: 0.0,
                    settle: Duration::ZERO,
                    wiring: format!("recording {name}"),
                    precautions: Precautions::default(),
                },
            },
            playing,
            position: 0,
            simulated: false,
        })
    }

    /// Opens a session file.
    pub(crate) fn session(
        path: &Path,
        playing: Playing,
    ) -> Result<(Self, Protocol), RecordingError> {
        let reader = SessionReader::open(path)?;
        let protocol = reader.header().protocol.clone();
        let frames = reader.len()?;
        let first = match frames {
            0 => Duration::ZERO,
            _ => {
                reader
                    .frame(reader.header().first_sequence)?
                    .frame
                    .monotonic
            }
        };
        Ok((
            Self {
                simulated: reader.header().simulated,
                tape: Tape::Session {
                    reader: Box::new(reader),
                    frames,
                    first,
                },
                playing,
                position: 0,
            },
            protocol,
        ))
    }

    /// Whether its voltages are simulated.
    pub(crate) fn is_simulated(&self) -> bool {
        self.simulated
    }

    /// The configuration under which a session was recorded; `None` for files without one.
    pub(crate) fn kept_config(&self) -> Option<&str> {
        match &self.tape {
            Tape::Csv { .. } => None,
            Tape::Session { reader, .. } => {
                Some(reader.header().config_toml.as_str()).filter(|text| !text.is_empty())
            }
        }
    }

    /// How many frames it has.
    pub(crate) fn len(&self) -> u64 {
        match &self.tape {
            Tape::Csv { frames, .. } => frames.len() as u64,
            Tape::Session { frames, .. } => *frames,
        }
    }

    /// The settings of its frames; `None` for a session without any.
    pub(crate) fn settings(&self) -> Option<Settings> {
        match &self.tape {
            Tape::Csv { settings, .. } => Some(settings.clone()),
            Tape::Session { reader, .. } => {
                let first = reader.header().first_sequence;
                Some(reader.frame(first).ok()?.frame.settings)
            }
        }
    }

    /// Goes back to the first frame, to be played at this speed.
    pub(crate) fn rewind(&mut self, speed: Option<f64>) {
        self.position = 0;
        if let Some(speed) = speed {
            self.playing.speed = speed;
        }
    }

    /// When the next frame is due, counted from the first; `None` at the end. Zero throughout where it is to be played
    /// as fast as possible.
    pub(crate) fn due(&self) -> Result<Option<Duration>, RecordingError> {
        if self.position >= self.len() {
            return Ok(None);
        }
        let offset = match &self.tape {
            Tape::Csv { .. } => self.playing.frames_per_s.map_or(Duration::ZERO, |rate| {
                survey::duration(self.position as f64 / rate)
            }),
            Tape::Session { reader, first, .. } => reader
                .frame(reader.header().first_sequence + self.position)?
                .frame
                .monotonic
                .saturating_sub(*first),
        };
        let due = if self.playing.speed > 0.0 {
            survey::duration(offset.as_secs_f64() / self.playing.speed)
        } else {
            Duration::ZERO
        };
        Ok(Some(due))
    }

    /// The next frame as if it had been acquired now; `None` at the end.
    pub(crate) fn next(
        &mut self,
        monotonic: Duration,
        wall: DateTime<Utc>,
    ) -> Result<Option<Frame>, RecordingError> {
        if self.position >= self.len() {
            return Ok(None);
        }
        let frame = self.frame(self.position, wall)?;
        self.position += 1;
        Ok(Some(Frame { monotonic, ..frame }))
    }

    fn frame(&self, index: u64, wall: DateTime<Utc>) -> Result<Frame, RecordingError> {
        let mut frame = match &self.tape {
            Tape::Csv { frames, settings } => Frame {
                sequence: 0,
                readings: frames[index as usize]
                    .iter()
                    .map(|volts| reading(*volts))
                    .collect(),
                monotonic: Duration::ZERO,
                wall,
                duration: Duration::ZERO,
                settings: settings.clone(),
                extra: Vec::new(),
                compliance: Vec::new(),
                simulated: false,
            },
            Tape::Session { reader, .. } => {
                // a later part of a session goes on with its numbers
                reader.frame(reader.header().first_sequence + index)?.frame
            }
        };
        if self.playing.negate {
            negate(&mut frame.readings);
        }
        Ok(frame)
    }

    /// The baseline: `first:N` frames of the recording, a CSV file (the mean of its frames), or for a session its own.
    pub(crate) fn baseline(
        &self,
        asked: Option<&str>,
        protocol: &Protocol,
        wall: DateTime<Utc>,
    ) -> Result<Baseline, RecordingError> {
        let asked = match (asked, &self.tape) {
            (Some(asked), _) => asked,
            (None, Tape::Csv { .. }) => "first:1",
            (None, Tape::Session { reader, .. }) => {
                let mut own = reader
                    .baseline()?
                    .ok_or_else(|| RecordingError::NoBaseline(reader.path().to_owned()))?;
                if self.playing.negate {
                    negate(&mut own.readings);
                }
                return Ok(own);
            }
        };
        let frames: Vec<Frame> = match asked.strip_prefix("first:") {
            Some(count) => {
                let has = self.len() as usize;
                let refused = || RecordingError::First {
                    asked: asked.to_owned(),
                    frames: has,
                };
                let count: usize = count.parse().map_err(|_| refused())?;
                if !(1..=has).contains(&count) {
                    return Err(refused());
                }
                (0..count as u64)
                    .map(|index| self.frame(index, wall))
                    .collect::<Result<_, _>>()?
            }
            None => {
                let current = self
                    .settings()
                    .map_or(Amps(1.0), |settings| settings.current);
                let file = Self::csv(Path::new(asked), protocol, current, self.playing)?;
                (0..file.len())
                    .map(|index| {
                        let mut frame = file.frame(index, wall)?;
                        if let Some(settings) = self.settings() {
                            frame.settings = settings;
                        }
                        Ok(frame)
                    })
                    .collect::<Result<_, RecordingError>>()?
            }
        };
        let mut baseline = Baseline::from_frames("recording", &frames).map_err(|cause| {
            RecordingError::Baseline {
                asked: asked.to_owned(),
                cause,
            }
        })?;
        baseline.simulated = self.simulated;
        Ok(baseline)
    }
}

fn name_of(path: &Path) -> String {
    path.file_name()
        .unwrap_or(path.as_os_str())
        .to_string_lossy()
        .into_owned()
}

fn reading(volts: Option<f64>) -> Reading {
    match volts {
        Some(volts) if volts.is_finite() => Reading::Ok(Volts(volts)),
        _ => Reading::NotMeasured,
    }
}

fn negate(readings: &mut [Reading]) {
    for reading in readings {
        if let Reading::Ok(Volts(volts)) = reading {
            *volts = -*volts;
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::acquisition::playback::*;

    fn recording(playing: Playing) -> (tempfile::TempDir, Protocol, Recording) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames.csv");
        std::fs::write(&path, "1,1,1,1\n3,3,nan,3\n5,5,5,5\n").unwrap();
        let protocol = Protocol::sheffield(4).unwrap();
        let recording = Recording::csv(&path, &protocol, Amps(1.0), playing).unwrap();
        (folder, protocol, recording)
    }

    const PLAIN: Playing = Playing {
        negate: false,
        frames_per_s: Some(4.0),
        speed: 2.0,
    };
    const NOW: DateTime<Utc> = DateTime::UNIX_EPOCH;

    #[test]
    fn a_recording_keeps_its_rate_and_ends() {
        let (_folder, _, mut recording) = recording(PLAIN);
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
    fn signs_are_changed_in_frames_and_baseline_alike_and_a_hole_stays_a_hole() {
        let (_folder, protocol, mut recording) = recording(Playing {
            negate: true,
            ..PLAIN
        });
        let baseline = recording.baseline(Some("first:2"), &protocol, NOW).unwrap();
        assert_eq!(baseline.readings[0], Reading::Ok(Volts(-2.0)));
        assert_eq!(baseline.readings[2], Reading::Ok(Volts(-1.0)));
        recording.next(Duration::ZERO, NOW).unwrap();
        let frame = recording.next(Duration::ZERO, NOW).unwrap().unwrap();
        assert_eq!(frame.readings[2], Reading::NotMeasured);
        assert!(baseline.check(&frame.settings, 4, false).is_ok());
    }

    #[test]
    fn a_baseline_of_more_frames_than_there_are_is_refused() {
        let (_folder, protocol, recording) = recording(PLAIN);
        for asked in ["first:0", "first:4", "first:x"] {
            let refusal = recording
                .baseline(Some(asked), &protocol, NOW)
                .unwrap_err()
                .to_string();
            assert!(
                refusal.contains(asked) && refusal.contains("has 3"),
                "{refusal}"
            );
        }
    }
}
