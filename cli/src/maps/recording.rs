//! A recording to be reconstructed offline: a case folder with measured frames, or a session of the logbook.

use std::path::{Path, PathBuf};

use chrono::{DateTime, Utc};
use survey::{Amps, Protocol, Reading, Volts};

use crate::args::{Global, Replay};
use crate::failure::Failure;
use crate::options::choices::BaselineChoice;
use crate::records::directory;
use crate::records::parts::{Parts, left_out};

/// One frame of a recording.
#[derive(Clone)]
pub(crate) struct Recorded {
    /// Its number in the session, or its row in the file counted from 1.
    pub(crate) sequence: u64,
    /// What the file calls it; else its number.
    pub(crate) label: String,
    /// When, where the record says so.
    pub(crate) wall: Option<DateTime<Utc>>,
    pub(crate) readings: Vec<Reading>,
    /// Trace of the map that was made of it when it was recorded.
    pub(crate) map: Option<logbook::MapRecord>,
}

/// Where a recording's mesh can be found without being told.
pub(crate) enum Origin {
    /// A case folder: it may hold a mesh.
    Folder(PathBuf),
    /// A session: its configuration names the geometry.
    Session(Box<logbook::SessionHeader>),
}

/// Where its frames come from.
enum Source {
    /// All of a file.
    Rows(Vec<Recorded>),
    /// A session, which may be of months: frame by frame.
    Session { parts: Parts, negate: bool },
}

/// Frames, and what they are to be compared with.
pub(crate) struct Recording {
    /// As it is called: a session's id, or the folder.
    pub(crate) name: String,
    pub(crate) protocol: Protocol,
    source: Source,
    /// At most so many frames.
    most: usize,
    pub(crate) baseline: Vec<Reading>,
    /// In words.
    pub(crate) baseline_name: String,
    /// Standard deviation of one reading over the baseline's frames, V (rms over the readings); `None` for one frame.
    pub(crate) noise: Option<f64>,
    pub(crate) current: Amps,
    /// `None` where the record does not say.
    pub(crate) simulated: Option<bool>,
    pub(crate) origin: Origin,
}

/// Opens what `replay` names: a folder, a session file, or a session's id in the state directory.
pub(crate) fn open(global: &Global, replay: &Replay) -> Result<Recording, Failure> {
    let path = Path::new(&replay.source);
    if path.is_dir() {
        from_folder(path, replay)
    } else {
        from_session(&directory::session_file(global, &replay.source)?, replay)
    }
}

impl Recording {
    /// How many frames [`Recording::frames`] gives, unless some cannot be read.
    pub(crate) fn len(&self) -> Result<usize, Failure> {
        let there = match &self.source {
            Source::Rows(rows) => rows.len(),
            Source::Session { parts, .. } => usize::try_from(parts.len()?).unwrap_or(usize::MAX),
        };
        Ok(there.min(self.most))
    }

    /// Its frames in order; those that cannot be read are named on the error stream.
    pub(crate) fn frames(&self) -> Box<dyn Iterator<Item = Recorded> + '_> {
        match &self.source {
            Source::Rows(rows) => Box::new(rows.iter().take(self.most).cloned()),
            Source::Session { parts, negate } => Box::new(recorded(parts, *negate).take(self.most)),
        }
    }
}

fn recorded(parts: &Parts, negate: bool) -> impl Iterator<Item = Recorded> {
    parts.frames().filter_map(move |record| match record {
        Ok(record) => Some(Recorded {
            sequence: record.frame.sequence,
            label: record.frame.sequence.to_string(),
            wall: Some(record.frame.wall),
            readings: signed(&record.frame.readings, negate),
            map: record.map,
        }),
        Err(error) => {
            left_out(&error);
            None
        }
    })
}

fn signed(readings: &[Reading], negate: bool) -> Vec<Reading> {
    readings
        .iter()
        .map(|&reading| negated(reading, negate))
        .collect()
}

fn most(replay: &Replay) -> usize {
    let count = replay.count.and_then(|count| usize::try_from(count).ok());
    count.unwrap_or(usize::MAX)
}

fn from_folder(folder: &Path, replay: &Replay) -> Result<Recording, Failure> {
    let protocol_file = folder.join("protocol.csv");
    let (protocol, currents) = eit::read_protocol(&protocol_file, replay.geometry.electrodes)
        .map_err(|error| Failure::failed("the protocol of the recording", &error))?;
    let current = one_current(&protocol_file, &currents)?;
    let Some(frames_file) = &replay.frames else {
        return Err(Failure::Usage(format!(
            "which frames of {}? Name the file with --frames FILE",
            folder.display()
        )));
    };
    let Some(baseline) = &replay.baseline else {
        return Err(Failure::Usage(
            "what is the unloaded state? Say --baseline FILE, or --baseline first:N for the first N frames".to_owned(),
        ));
    };
    let read = |file: &Path| rows(&within(folder, file)?, protocol.len(), replay.negate);
    let (labels, frames): (Vec<String>, Vec<Vec<Reading>>) = read(frames_file)?.into_iter().unzip();
    let (unloaded, baseline_name) = match baseline {
        BaselineChoice::First(count) => (first(&frames, *count)?.to_vec(), first_frames(*count)),
        BaselineChoice::File(file) => (
            read(file)?.into_iter().map(|(_, frame)| frame).collect(),
            format!("mean of {}", file.display()),
        ),
    };
    let (baseline, noise) = average(&unloaded);
    let frames = frames
        .into_iter()
        .zip(labels)
        .zip(1..)
        .map(|((readings, label), sequence)| Recorded {
            sequence,
            label,
            wall: None,
            readings,
            map: None,
        })
        .collect();
    Ok(Recording {
        name: replay.source.clone(),
        protocol,
        source: Source::Rows(frames),
        most: most(replay),
        baseline,
        baseline_name,
        noise,
        current,
        simulated: None,
        origin: Origin::Folder(folder.to_owned()),
    })
}

fn from_session(path: &Path, replay: &Replay) -> Result<Recording, Failure> {
    if let Some(file) = &replay.frames {
        return Err(Failure::Usage(format!(
            "--frames {} belongs to a case folder; a session has its own frames",
            file.display()
        )));
    }
    let parts = Parts::open(path)?;
    let header = parts.header().clone();
    let kept = parts.baseline()?;
    let protocol = header.protocol.clone();
    let first_readable = parts.frames().find_map(Result::ok);
    let current = first_readable
        .map(|record| record.frame.settings.current)
        .or(kept.as_ref().map(|baseline| baseline.settings.current))
        .unwrap_or(Amps(1.0));
    let (baseline, noise, baseline_name) = match &replay.baseline {
        None => {
            let kept = kept.ok_or_else(|| {
                Failure::Failed(format!(
                    "session {} holds no baseline; say --baseline first:N for its first N frames",
                    header.id
                ))
            })?;
            let deviation = rms(kept.deviation.iter().filter_map(|deviation| *deviation));
            let readings = signed(&kept.readings, replay.negate);
            (readings, deviation, kept.id.clone())
        }
        Some(BaselineChoice::First(count)) => {
            let frames = recorded(&parts, replay.negate).take(*count);
            let readings: Vec<_> = frames.map(|frame| frame.readings).collect();
            let (mean, noise) = average(first(&readings, *count)?);
            (mean, noise, first_frames(*count))
        }
        Some(BaselineChoice::File(file)) => {
            let frames: Vec<Vec<Reading>> = rows(file, protocol.len(), replay.negate)?
                .into_iter()
                .map(|(_, frame)| frame)
                .collect();
            let (mean, noise) = average(&frames);
            (mean, noise, format!("mean of {}", file.display()))
        }
    };
    Ok(Recording {
        name: header.id.clone(),
        protocol,
        source: Source::Session {
            parts,
            negate: replay.negate,
        },
        most: most(replay),
        baseline,
        baseline_name,
        noise,
        current,
        simulated: Some(header.simulated),
        origin: Origin::Session(Box::new(header)),
    })
}

/// Frames of a file with their labels.
fn rows(
    file: &Path,
    readings: usize,
    negate: bool,
) -> Result<Vec<(String, Vec<Reading>)>, Failure> {
    let rows = eit::read_named_frames(file, readings)
        .map_err(|error| Failure::failed("the frames", &error))?;
    Ok(rows
        .into_iter()
        .map(|(label, row)| {
            (
                label,
                row.into_iter()
                    .map(|value| reading(value, negate))
                    .collect(),
            )
        })
        .collect())
}

fn one_current(file: &Path, currents: &[f64]) -> Result<Amps, Failure> {
    let current = currents.first().copied().unwrap_or(1.0);
    if currents.iter().any(|other| *other != current) {
        return Err(Failure::Failed(format!(
            "{} injects different currents; divide the readings by their current and leave the column current_A out",
            file.display()
        )));
    }
    Ok(Amps(current))
}

/// A bare name in the folder, then in the current directory; a path as it is, then from the folder.
///
/// # Errors
/// It is in neither.
fn within(folder: &Path, file: &Path) -> Result<PathBuf, Failure> {
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
        .ok_or_else(|| {
            Failure::Failed(format!(
                "there is no {} in {} nor in the current directory",
                file.display(),
                folder.display()
            ))
        })
}

fn reading(value: Option<f64>, negate: bool) -> Reading {
    match value {
        Some(volts) if volts.is_finite() => negated(Reading::Ok(Volts(volts)), negate),
        _ => Reading::NotMeasured,
    }
}

fn negated(reading: Reading, negate: bool) -> Reading {
    match reading {
        Reading::Ok(volts) if negate => Reading::Ok(-volts),
        other => other,
    }
}

fn first(frames: &[Vec<Reading>], count: usize) -> Result<&[Vec<Reading>], Failure> {
    frames.get(..count).ok_or_else(|| {
        Failure::Usage(format!(
            "--baseline first:{count} asks for more than the {} frames there are",
            frames.len()
        ))
    })
}

fn first_frames(count: usize) -> String {
    match count {
        1 => "the first frame".to_owned(),
        count => format!("mean of the first {count} frames"),
    }
}

/// The mean of each reading over the frames where it is valid, and the rms of their standard deviations.
fn average(frames: &[Vec<Reading>]) -> (Vec<Reading>, Option<f64>) {
    let readings = frames.first().map_or(0, Vec::len);
    let mut mean = Vec::with_capacity(readings);
    let mut deviations = Vec::new();
    for index in 0..readings {
        let valid: Vec<f64> = frames
            .iter()
            .filter_map(|frame| frame[index].volts())
            .map(|volts| volts.0)
            .collect();
        if valid.is_empty() {
            mean.push(frames[0][index]);
            continue;
        }
        let centre = valid.iter().sum::<f64>() / valid.len() as f64;
        mean.push(Reading::Ok(Volts(centre)));
        if valid.len() > 1 {
            let squares: f64 = valid.iter().map(|volts| (volts - centre).powi(2)).sum();
            deviations.push((squares / (valid.len() - 1) as f64).sqrt());
        }
    }
    (mean, rms(deviations.into_iter()))
}

fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, squares) = values.fold((0_usize, 0.0), |(count, squares), value| {
        (count + 1, squares + value * value)
    });
    (count > 0 && squares > 0.0).then(|| (squares / count as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use crate::maps::recording::*;

    #[test]
    fn a_mean_leaves_out_what_is_not_valid() {
        let frames = [
            vec![
                Reading::Ok(Volts(1.0)),
                Reading::Overload,
                Reading::Ok(Volts(2.0)),
            ],
            vec![Reading::Ok(Volts(3.0)), Reading::Overload, Reading::Timeout],
        ];
        let (mean, noise) = average(&frames);
        assert_eq!(
            mean,
            [
                Reading::Ok(Volts(2.0)),
                Reading::Overload,
                Reading::Ok(Volts(2.0))
            ]
        );
        assert_eq!(noise, Some(2.0_f64.sqrt()));
        assert_eq!(average(&frames[..1]).1, None);
    }

    #[test]
    fn a_blank_is_not_a_number_and_a_magnitude_gets_its_sign() {
        assert_eq!(reading(None, true), Reading::NotMeasured);
        assert_eq!(reading(Some(f64::NAN), false), Reading::NotMeasured);
        assert_eq!(reading(Some(0.5), true), Reading::Ok(Volts(-0.5)));
    }

    #[test]
    fn a_bare_name_is_looked_for_in_the_folder_first() {
        let folder = tempfile::tempdir().unwrap();
        let named = Path::new("Cargo.toml");
        // The tests run beside a file of that name.
        assert_eq!(within(folder.path(), named).unwrap(), named);
        let inside = folder.path().join(named);
        std::fs::write(&inside, "").unwrap();
        assert_eq!(within(folder.path(), named).unwrap(), inside);
        let refusal = within(folder.path(), Path::new("no.csv")).unwrap_err();
        assert_eq!(refusal.code(), 1);
    }

    #[test]
    fn more_baseline_frames_than_frames_is_said() {
        let frames = [vec![Reading::Overload]];
        let refusal = first(&frames, 2).unwrap_err();
        assert_eq!(refusal.code(), 2);
        assert!(refusal.to_string().contains("1 frames"), "{refusal}");
    }
}
