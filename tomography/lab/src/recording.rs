//! Frames and their baseline, from files.

use std::path::Path;

use eit::{NamedFrame, read_named_frames};
use survey::{Reading, Volts};

use crate::failure::Failure;

/// Recorded frames with their baseline.
pub(crate) struct Recording {
    /// Name and readings of each frame of the file, baseline frames included.
    pub(crate) frames: Vec<(String, Vec<Reading>)>,
    /// Mean of the baseline's frames.
    pub(crate) baseline: Vec<Reading>,
}

impl Recording {
    /// Reads frames, and the baseline by its rule: `first:N` or a file.
    pub(crate) fn read(
        frames: &Path,
        baseline: &str,
        readings: usize,
        negate: bool,
    ) -> Result<Self, Failure> {
        let sign = if negate { -1.0 } else { 1.0 };
        let read = |path: &Path| -> Result<Vec<(String, Vec<Reading>)>, Failure> {
            let frames = read_named_frames(path, readings)
                .map_err(|fault| Failure::of("cannot read the frames", &fault))?;
            Ok(frames
                .into_iter()
                .map(|(name, values): NamedFrame| (name, flagged(&values, sign)))
                .collect())
        };
        let all = read(frames)?;
        let baseline = match baseline.strip_prefix("first:") {
            Some(count) => {
                let count = count.parse::<usize>().ok().filter(|count| *count > 0);
                let count = count.ok_or_else(|| {
                    Failure::usage(format!(
                        "--baseline {baseline}: first:N needs a number of 1 or more"
                    ))
                })?;
                let first = all.get(..count).ok_or_else(|| {
                    Failure::because(format!(
                        "--baseline {baseline}: {} has {} frames",
                        frames.display(),
                        all.len()
                    ))
                })?;
                mean(first)
            }
            None => mean(&read(Path::new(baseline))?),
        };
        Ok(Self {
            frames: all,
            baseline,
        })
    }
}

/// What is not a number was not measured; 9.9E37 is an instrument's overload.
fn flagged(values: &[Option<f64>], sign: f64) -> Vec<Reading> {
    values
        .iter()
        .map(|value| match value {
            Some(volts) if volts.abs() >= 9.9e37 => Reading::Overload,
            Some(volts) if volts.is_finite() => Reading::Ok(Volts(sign * volts)),
            _ => Reading::NotMeasured,
        })
        .collect()
}

/// The mean of the valid readings; what is valid in no frame keeps its flag.
fn mean(frames: &[(String, Vec<Reading>)]) -> Vec<Reading> {
    let Some((_, last)) = frames.last() else {
        return Vec::new();
    };
    (0..last.len())
        .map(|reading| {
            let valid: Vec<f64> = frames
                .iter()
                .filter_map(|(_, frame)| frame[reading].volts())
                .map(|volts| volts.0)
                .collect();
            if valid.is_empty() {
                last[reading]
            } else {
                Reading::Ok(Volts(valid.iter().sum::<f64>() / valid.len() as f64))
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_overload_is_never_a_number() {
        assert_eq!(
            flagged(&[Some(1.0), Some(9.9e37), None, Some(f64::NAN)], -1.0),
            [
                Reading::Ok(Volts(-1.0)),
                Reading::Overload,
                Reading::NotMeasured,
                Reading::NotMeasured
            ]
        );
    }

    #[test]
    fn a_mean_leaves_out_what_is_missing() {
        let frame = |values: &[Option<f64>]| ("f".to_owned(), flagged(values, 1.0));
        assert_eq!(
            mean(&[
                frame(&[Some(1.0), Some(4.0), None]),
                frame(&[Some(3.0), None, None])
            ]),
            [
                Reading::Ok(Volts(2.0)),
                Reading::Ok(Volts(4.0)),
                Reading::NotMeasured
            ]
        );
    }
}
