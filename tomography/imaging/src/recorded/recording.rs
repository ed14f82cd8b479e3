//! A recording to be reconstructed offline: a case folder with measured frames, or a session of the logbook.

use std::path::{Path, PathBuf};

use chrono::{DateTime, Utc};
use logbook::{LogbookError, MapRecord, SessionHeader};
use survey::{Amps, Protocol, Reading};

use super::readings::{change_signs, first, mean, sample};
use super::{BaselineRule, LabelledReadings, RecordedError, SessionParts, Unloaded, read_frames};
use crate::conditions::Sample;
use crate::methods::FRAMES_LOOKED_AT;
use crate::noise::rms;
use crate::settings::ReconstructionSettings;

/// One frame of a recording.
#[derive(Debug, Clone)]
pub struct RecordedFrame {
    /// Its number in the session, or its row in the table counted from 1.
    pub sequence: u64,
    /// What the table calls it; else its number.
    pub label: String,
    /// When, where the record says so.
    pub wall: Option<DateTime<Utc>>,
    /// Its readings, with the signs that were asked for.
    pub readings: Vec<Reading>,
    /// Trace of the map that was made of it when it was recorded.
    pub map: Option<MapRecord>,
}

/// Where a recording comes from, and with it its mesh.
#[derive(Debug, Clone)]
pub enum Origin {
    /// A case folder: it may hold a mesh.
    Folder(PathBuf),
    /// A session: its configuration names the geometry.
    Session(Box<SessionHeader>),
}

/// What is read of a case folder.
#[derive(Debug, Clone, Copy)]
pub struct FolderOptions<'a> {
    /// The table of frames: a bare name is looked for in the folder first.
    pub frames: &'a Path,
    /// The unloaded state.
    pub baseline: &'a BaselineRule,
    /// Number of electrodes, where the protocol does not say it.
    pub electrodes: Option<usize>,
    /// Changes every sign: the instrument gave magnitudes.
    pub negate: bool,
}

/// Where the frames are.
#[derive(Debug)]
enum Source {
    /// All of a table.
    Table(Vec<RecordedFrame>),
    /// A session, which may be of months: frame by frame.
    Session { parts: SessionParts, negate: bool },
}

/// Frames, and what they are to be compared with.
#[derive(Debug)]
pub struct Recording {
    /// What it is called: a session's id, or the folder.
    pub name: String,
    /// The readings of a frame.
    pub protocol: Protocol,
    source: Source,
    /// The unloaded state.
    pub unloaded: Unloaded,
    /// In words: what the baseline is the mean of, or the id of the session's own.
    pub baseline_name: String,
    /// Current of the frames.
    pub current: Amps,
    /// `None` where the record does not say.
    pub simulated: Option<bool>,
    /// Where it comes from.
    pub origin: Origin,
}

impl Recording {
    /// Reads the frames of a case folder.
    ///
    /// # Errors
    /// A protocol, table or baseline that cannot be read.
    pub fn from_folder(folder: &Path, options: &FolderOptions<'_>) -> Result<Self, RecordedError> {
        let protocol_file = folder.join("protocol.csv");
        let (protocol, currents) = eit::read_protocol(&protocol_file, options.electrodes)
            .map_err(RecordedError::Protocol)?;
        let current = one_current(&protocol_file, &currents)?;
        let read =
            |file: &Path| read_frames(&within(folder, file)?, protocol.len(), options.negate);
        let frames = read(options.frames)?;
        let unloaded = match options.baseline {
            BaselineRule::First(count) => first(&frames, *count)?,
            BaselineRule::File(file) => mean(&read(file)?),
        };
        let frames = frames
            .into_iter()
            .zip(1..)
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
            unloaded,
            baseline_name: options.baseline.to_string(),
            current,
            simulated: None,
            origin: Origin::Folder(folder.to_owned()),
        })
    }

    /// Opens a session with all its parts. `baseline` is used in place of the session's own.
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
        let (unloaded, baseline_name) = match baseline {
            None => {
                let mut own = own.ok_or_else(|| RecordedError::NoBaseline(header.id.clone()))?;
                if negate {
                    change_signs(&mut own.readings);
                }
                let noise = rms(own.deviation.iter().filter_map(|deviation| *deviation));
                let unloaded = Unloaded {
                    readings: own.readings,
                    noise,
                };
                (unloaded, own.id)
            }
            Some(rule @ BaselineRule::First(count)) => {
                let frames: Vec<LabelledReadings> = recorded(&parts, negate)
                    .filter_map(Result::ok)
                    .take(*count)
                    .map(|frame| (frame.label, frame.readings))
                    .collect();
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
            current,
            simulated: Some(header.simulated),
            origin: Origin::Session(Box::new(header)),
        })
    }

    /// How many frames [`Recording::frames`] gives, those that cannot be read included.
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

    /// Frames for a method's rules, evenly from all that can be read.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn sample(&self) -> Result<Sample, LogbookError> {
        let frames = self
            .frames()
            .filter_map(Result::ok)
            .map(|frame| frame.readings);
        Ok(sample(&self.unloaded.readings, self.len()?, frames))
    }

    /// The frames by which a running session settled its method: the first that were to have a map.
    pub fn first_sample(&self, settings: &ReconstructionSettings) -> Sample {
        let frames = self.frames().filter_map(Result::ok);
        Sample {
            baseline: self.unloaded.readings.clone(),
            frames: frames
                .filter(|frame| settings.has_map(frame.sequence))
                .take(FRAMES_LOOKED_AT)
                .map(|frame| frame.readings)
                .collect(),
        }
    }

    /// Its frames in order, with an error in place of each that cannot be read.
    pub fn frames(&self) -> Box<dyn Iterator<Item = Result<RecordedFrame, LogbookError>> + '_> {
        match &self.source {
            Source::Table(rows) => Box::new(rows.iter().cloned().map(Ok)),
            Source::Session { parts, negate } => Box::new(recorded(parts, *negate)),
        }
    }
}

fn recorded(
    parts: &SessionParts,
    negate: bool,
) -> impl Iterator<Item = Result<RecordedFrame, LogbookError>> {
    parts.frames().map(move |record| {
        let record = record?;
        let mut readings = record.frame.readings;
        if negate {
            change_signs(&mut readings);
        }
        Ok(RecordedFrame {
            sequence: record.frame.sequence,
            label: record.frame.sequence.to_string(),
            wall: Some(record.frame.wall),
            readings,
            map: record.map,
        })
    })
}

fn one_current(file: &Path, currents: &[f64]) -> Result<Amps, RecordedError> {
    let current = currents.first().copied().unwrap_or(1.0);
    if currents.iter().any(|other| *other != current) {
        return Err(RecordedError::Currents(file.to_owned()));
    }
    Ok(Amps(current))
}

/// A bare name in the folder, then in the current directory; a path as it is, then from the folder.
fn within(folder: &Path, file: &Path) -> Result<PathBuf, RecordedError> {
    let inside = folder.join(file);
    let bare = file.parent() == Some(Path::new(""));
    let places = if bare {
        [inside, file.to_owned()]
    } else {
        [file.to_owned(), inside]
    };
    places
        .into_iter()
        .find(|place| place.exists())
        .ok_or_else(|| RecordedError::Missing {
            file: file.to_owned(),
            folder: folder.to_owned(),
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bare_name_is_looked_for_in_the_folder_first() {
        let folder = tempfile::tempdir().unwrap();
        let named = Path::new("Cargo.toml");
        // the tests run in a directory with a file of that name
        assert_eq!(within(folder.path(), named).unwrap(), named);
        let inside = folder.path().join(named);
        std::fs::write(&inside, "").unwrap();
        assert_eq!(within(folder.path(), named).unwrap(), inside);
        let error = within(folder.path(), Path::new("no.csv")).unwrap_err();
        assert!(matches!(error, RecordedError::Missing { .. }));
    }
}
