//! Tables of frames, and the mean of several as a baseline.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use survey::{Reading, Volts};

use super::RecordedError;
use crate::noise::{Noise, rms};

/// A frame's label and its readings.
pub type LabelledReadings = (String, Vec<Reading>);

/// Reads a table of frames with the given number of readings. `negate` inverts every sign, for instruments that give
/// magnitudes. Blank fields, fields that are not finite and overloads are read as not measured.
///
/// # Errors
/// [`RecordedError::Frames`], naming the line.
pub fn read_frames(
    path: &Path,
    readings: usize,
    negate: bool,
) -> Result<Vec<LabelledReadings>, RecordedError> {
    let rows = eit::read_named_frames(path, readings).map_err(RecordedError::Frames)?;
    Ok(rows
        .into_iter()
        .map(|(label, row)| {
            let mut readings: Vec<Reading> = row.into_iter().map(reading).collect();
            if negate {
                change_signs(&mut readings);
            }
            (label, readings)
        })
        .collect())
}

fn reading(volts: Option<f64>) -> Reading {
    match volts {
        Some(volts) if volts.is_finite() => Reading::Ok(Volts(volts)),
        _ => Reading::NotMeasured,
    }
}

/// Inverts the sign of every valid reading.
pub(super) fn change_signs(readings: &mut [Reading]) {
    for reading in readings {
        if let Reading::Ok(Volts(volts)) = reading {
            *volts = -*volts;
        }
    }
}

/// Selects the frames of the baseline.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BaselineRule {
    /// The mean of the recording's first frames.
    First(usize),
    /// The mean of a file's frames.
    File(PathBuf),
}

impl FromStr for BaselineRule {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.strip_prefix("first:") {
            None => Ok(Self::File(PathBuf::from(text))),
            Some(count) => match count.parse() {
                Ok(count) if count > 0 => Ok(Self::First(count)),
                _ => Err(format!(
                    "'{count}' is not a number of frames; write for example first:16"
                )),
            },
        }
    }
}

impl fmt::Display for BaselineRule {
    /// Describes the frames averaged for the baseline.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::First(1) => f.write_str("the first frame"),
            Self::First(count) => write!(f, "mean of the first {count} frames"),
            Self::File(file) => write!(f, "mean of {}", file.display()),
        }
    }
}

/// A baseline from recorded frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Unloaded {
    /// The mean of each reading over the frames where it is valid.
    pub readings: Vec<Reading>,
    /// Standard deviation of one reading over the frames, V (rms over the readings); `None` if it is zero or undefined.
    pub noise: Option<f64>,
}

impl Unloaded {
    /// The mean of these frames. A reading that is valid in no frame has the flag of the last frame.
    pub fn mean(frames: &[&[Reading]]) -> Self {
        let (readings, deviations) = survey::mean_of(frames);
        Self {
            readings,
            noise: rms(deviations.into_iter().flatten()),
        }
    }
}

impl Unloaded {
    /// Standard deviation of one reading, in the unit of the readings: as measured from the frames of the baseline,
    /// otherwise as stated. `None` if it could only be assumed, because an assumed noise gives no significance
    /// threshold.
    pub fn known_noise(&self, stated: Option<f64>) -> Option<f64> {
        Noise::of_baseline(self.noise, &self.readings)
            .and_then(Noise::measured)
            .or(stated)
    }
}

/// The mean of labelled frames.
pub(super) fn mean(frames: &[LabelledReadings]) -> Unloaded {
    let frames: Vec<&[Reading]> = frames.iter().map(|(_, frame)| frame.as_slice()).collect();
    Unloaded::mean(&frames)
}

/// The mean of the first frames.
pub(super) fn first(frames: &[LabelledReadings], count: usize) -> Result<Unloaded, RecordedError> {
    let first = frames.get(..count).ok_or_else(|| RecordedError::First {
        requested: format!("first:{count}"),
        frames: frames.len(),
    })?;
    Ok(mean(first))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_leaves_out_what_is_not_valid() {
        let frames = [
            vec![
                Reading::Ok(Volts(1.0)),
                Reading::Overload,
                Reading::Ok(Volts(2.0)),
            ],
            vec![
                Reading::Ok(Volts(3.0)),
                Reading::Overload,
                Reading::NotMeasured,
            ],
        ];
        let unloaded = Unloaded::mean(&[&frames[0], &frames[1]]);
        assert_eq!(
            unloaded.readings,
            [
                Reading::Ok(Volts(2.0)),
                Reading::Overload,
                Reading::Ok(Volts(2.0))
            ]
        );
        assert_eq!(unloaded.noise, Some(2.0_f64.sqrt()));
        assert_eq!(Unloaded::mean(&[&frames[0]]).noise, None);
    }

    #[test]
    fn blanks_and_overloads_of_a_table_are_not_measured() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames.csv");
        std::fs::write(&path, "0.5,9.9e37,nan,-1\n").unwrap();
        let read = read_frames(&path, 4, true).unwrap();
        assert_eq!(
            read[0].1,
            [
                Reading::Ok(Volts(-0.5)),
                Reading::NotMeasured,
                Reading::NotMeasured,
                Reading::Ok(Volts(1.0))
            ]
        );
    }

    #[test]
    fn more_baseline_frames_than_there_are_is_refused() {
        let frames = [("a".to_owned(), vec![Reading::Overload])];
        let error = first(&frames, 2).unwrap_err().to_string();
        assert!(
            error.contains("first:2") && error.contains("has 1"),
            "{error}"
        );
    }

    #[test]
    fn a_rule_is_a_number_of_frames_or_a_file() {
        assert_eq!("first:3".parse(), Ok(BaselineRule::First(3)));
        assert_eq!("b.csv".parse(), Ok(BaselineRule::File("b.csv".into())));
        for wrong in ["first:0", "first:x", "first:"] {
            assert!(wrong.parse::<BaselineRule>().is_err(), "{wrong}");
        }
    }
}
