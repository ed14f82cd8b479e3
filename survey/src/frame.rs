//! What the sheet answered: readings, frames, baselines.

use std::time::Duration;

use chrono::{DateTime, Utc};
use serde::{Deserialize, Serialize};

use crate::{Amps, Electrode, Volts};

/// One answer: a voltage, or the reason why there is none. An overload never becomes a number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reading {
    /// A valid voltage.
    Ok(Volts),
    /// The voltmeter was over its range, or answered something that is not a number.
    Overload,
    /// No answer in time.
    Timeout,
    /// The plan did not get here, or the source was in compliance.
    NotMeasured,
}

impl Reading {
    /// The voltage if the reading is valid.
    pub fn volts(self) -> Option<Volts> {
        match self {
            Self::Ok(volts) => Some(volts),
            Self::Overload | Self::Timeout | Self::NotMeasured => None,
        }
    }

    /// Whether there is a voltage.
    pub fn is_ok(self) -> bool {
        matches!(self, Self::Ok(_))
    }

    /// The flag's stable number on the wire and on disk: 0 ok, 1 overload, 2 timeout, 3 not measured.
    pub fn flag(self) -> u8 {
        match self {
            Self::Ok(_) => 0,
            Self::Overload => 1,
            Self::Timeout => 2,
            Self::NotMeasured => 3,
        }
    }

    /// From a flag and a voltage; `None` for an unknown flag, or for flag 0 with a voltage that is not finite.
    pub fn from_flag(flag: u8, volts: f64) -> Option<Self> {
        match flag {
            0 if volts.is_finite() => Some(Self::Ok(Volts(volts))),
            1 => Some(Self::Overload),
            2 => Some(Self::Timeout),
            3 => Some(Self::NotMeasured),
            _ => None,
        }
    }
}

/// Everything that must agree between a baseline and a frame for their difference to mean anything.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// [`crate::Protocol::hash`] of the questions asked.
    pub protocol_hash: String,
    /// Injected current.
    pub current: Amps,
    /// The voltmeter's range.
    pub range: Volts,
    /// Integration in power-line cycles.
    pub nplc: f64,
    /// Waiting time after the current has moved.
    pub settle: Duration,
    /// Name of the wiring.
    pub wiring: String,
}

impl Settings {
    /// The names of the settings in which two differ, with both values, for a message; empty when they agree.
    pub fn differences(&self, other: &Self) -> Vec<String> {
        let mut differences = Vec::new();
        let mut compare = |name: &str, mine: String, theirs: String| {
            if mine != theirs {
                differences.push(format!("{name} {mine} against {theirs}"));
            }
        };
        compare(
            "protocol",
            self.protocol_hash.clone(),
            other.protocol_hash.clone(),
        );
        compare(
            "current",
            self.current.to_string(),
            other.current.to_string(),
        );
        compare("range", self.range.to_string(), other.range.to_string());
        compare("NPLC", self.nplc.to_string(), other.nplc.to_string());
        compare(
            "settle",
            format!("{:?}", self.settle),
            format!("{:?}", other.settle),
        );
        compare("wiring", self.wiring.clone(), other.wiring.clone());
        differences
    }
}

/// What a frame's own readings say about it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Quality {
    /// Readings over range.
    pub overloads: usize,
    /// Readings without an answer in time.
    pub timeouts: usize,
    /// Readings not taken.
    pub not_measured: usize,
    /// Driving electrodes (plus side) at which the source was in compliance.
    pub compliance: Vec<Electrode>,
    /// Largest difference of a reading from its reciprocal twin, relative to the largest reading; `None` without twins.
    pub reciprocity: Option<f64>,
}

impl Quality {
    /// Whether every reading was taken and is valid, the source never in compliance.
    pub fn is_clean(&self) -> bool {
        self.overloads == 0
            && self.timeouts == 0
            && self.not_measured == 0
            && self.compliance.is_empty()
    }
}

/// All answers to one protocol, with when and how they were taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Counted from 1 in its session; 0 before a session has taken it.
    pub sequence: u64,
    /// Answers in the protocol's order.
    pub readings: Vec<Reading>,
    /// Monotonic time of the first step, since the daemon (or the recording) started.
    pub monotonic: Duration,
    /// Wall time of the first step.
    pub wall: DateTime<Utc>,
    /// From first step to last reading.
    pub duration: Duration,
    /// How it was taken.
    pub settings: Settings,
    /// Driving electrodes (plus side) at which the source was in compliance.
    pub compliance: Vec<Electrode>,
    /// Whether the voltages come from a simulated sheet.
    pub simulated: bool,
}

impl Frame {
    /// Counts flags, and measures reciprocity where the protocol has twins (see [`crate::Protocol::reciprocal_twins`]).
    pub fn quality(&self, twins: &[Option<usize>]) -> Quality {
        let count = |flag: u8| {
            self.readings
                .iter()
                .filter(|reading| reading.flag() == flag)
                .count()
        };
        let largest = self
            .readings
            .iter()
            .filter_map(|reading| reading.volts())
            .fold(0.0_f64, |largest, volts| largest.max(volts.0.abs()));
        let reciprocity = self
            .readings
            .iter()
            .zip(twins)
            .filter_map(|(reading, twin)| {
                let other = self.readings.get((*twin)?)?;
                Some((reading.volts()?.0 - other.volts()?.0).abs())
            })
            .reduce(f64::max)
            .filter(|_| largest > 0.0)
            .map(|difference| difference / largest);
        Quality {
            overloads: count(1),
            timeouts: count(2),
            not_measured: count(3),
            compliance: self.compliance.clone(),
            reciprocity,
        }
    }
}

/// The unloaded sheet: the mean of some frames, reading by reading.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// A name, unique in a logbook.
    pub id: String,
    /// Mean of the valid readings; a reading valid in no frame keeps its flag.
    pub readings: Vec<Reading>,
    /// Standard deviation of one reading over the frames, V; `None` with fewer than two valid ones.
    pub deviation: Vec<Option<f64>>,
    /// Frames averaged.
    pub frames: usize,
    /// Wall time of the last frame.
    pub wall: DateTime<Utc>,
    /// How it was taken.
    pub settings: Settings,
    /// Whether the voltages come from a simulated sheet.
    pub simulated: bool,
}

/// Why frames do not make a baseline, or a baseline does not fit a frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BaselineError {
    /// No frame to average.
    #[error("a baseline needs at least one frame")]
    NoFrames,
    /// Settings differ.
    #[error("baseline '{baseline}' was taken with other settings: {differences}; record a new one")]
    OtherSettings {
        /// Its name.
        baseline: String,
        /// Which settings, with both values.
        differences: String,
    },
    /// One is simulated, the other is not.
    #[error("baseline '{baseline}' is {baseline_kind}, the rig is {frame_kind}; record a new one")]
    OtherKind {
        /// Its name.
        baseline: String,
        /// `simulated` or `measured`.
        baseline_kind: &'static str,
        /// `simulated` or `measured`.
        frame_kind: &'static str,
    },
    /// Reading counts differ.
    #[error("baseline '{baseline}' has {has} readings, {wants} are needed")]
    Length {
        /// Its name.
        baseline: String,
        /// What it has.
        has: usize,
        /// What is needed.
        wants: usize,
    },
}

impl Baseline {
    /// Averages frames of the unloaded sheet; a reading that is invalid in some frame is averaged over the others.
    ///
    /// # Errors
    /// No frame, or frames with different settings or lengths.
    pub fn from_frames(id: impl Into<String>, frames: &[Frame]) -> Result<Self, BaselineError> {
        let id = id.into();
        let last = frames.last().ok_or(BaselineError::NoFrames)?;
        for frame in frames {
            if frame.readings.len() != last.readings.len() {
                return Err(BaselineError::Length {
                    baseline: id,
                    has: last.readings.len(),
                    wants: frame.readings.len(),
                });
            }
            let differences = frame.settings.differences(&last.settings);
            if !differences.is_empty() {
                return Err(BaselineError::OtherSettings {
                    baseline: id,
                    differences: differences.join(", "),
                });
            }
        }
        let (readings, deviation) = (0..last.readings.len())
            .map(|reading| {
                let valid: Vec<f64> = frames
                    .iter()
                    .filter_map(|frame| frame.readings[reading].volts())
                    .map(|volts| volts.0)
                    .collect();
                if valid.is_empty() {
                    return (last.readings[reading], None);
                }
                let mean = valid.iter().sum::<f64>() / valid.len() as f64;
                let deviation = (valid.len() > 1).then(|| {
                    let squares: f64 = valid.iter().map(|volts| (volts - mean).powi(2)).sum();
                    (squares / (valid.len() - 1) as f64).sqrt()
                });
                (Reading::Ok(Volts(mean)), deviation)
            })
            .unzip();
        Ok(Self {
            id,
            readings,
            deviation,
            frames: frames.len(),
            wall: last.wall,
            settings: last.settings.clone(),
            simulated: last.simulated,
        })
    }

    /// Refuses a frame (or the settings of a coming one) that this baseline was not taken for.
    ///
    /// # Errors
    /// Names the settings that differ.
    pub fn check(
        &self,
        settings: &Settings,
        readings: usize,
        simulated: bool,
    ) -> Result<(), BaselineError> {
        let kind = |simulated| if simulated { "simulated" } else { "measured" };
        if self.readings.len() != readings {
            return Err(BaselineError::Length {
                baseline: self.id.clone(),
                has: self.readings.len(),
                wants: readings,
            });
        }
        let differences = self.settings.differences(settings);
        if !differences.is_empty() {
            return Err(BaselineError::OtherSettings {
                baseline: self.id.clone(),
                differences: differences.join(", "),
            });
        }
        if self.simulated != simulated {
            return Err(BaselineError::OtherKind {
                baseline: self.id.clone(),
                baseline_kind: kind(self.simulated),
                frame_kind: kind(simulated),
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(readings: Vec<Reading>) -> Frame {
        Frame {
            sequence: 1,
            readings,
            monotonic: Duration::ZERO,
            wall: DateTime::UNIX_EPOCH,
            duration: Duration::from_secs(1),
            settings: Settings {
                protocol_hash: "p".into(),
                current: Amps(1e-3),
                range: Volts(1.0),
                nplc: 1.0,
                settle: Duration::from_millis(1),
                wiring: "w".into(),
            },
            compliance: Vec::new(),
            simulated: true,
        }
    }

    #[test]
    fn a_baseline_averages_what_is_valid_and_keeps_the_flag_of_what_never_was() {
        let frames = [
            frame(vec![
                Reading::Ok(Volts(1.0)),
                Reading::Overload,
                Reading::Timeout,
            ]),
            frame(vec![
                Reading::Ok(Volts(3.0)),
                Reading::Ok(Volts(5.0)),
                Reading::Timeout,
            ]),
        ];
        let baseline = Baseline::from_frames("b", &frames).unwrap();
        assert_eq!(
            baseline.readings,
            [
                Reading::Ok(Volts(2.0)),
                Reading::Ok(Volts(5.0)),
                Reading::Timeout
            ]
        );
        assert_eq!(baseline.deviation, [Some(2.0_f64.sqrt()), None, None]);
    }

    #[test]
    fn a_baseline_taken_with_other_settings_is_refused_by_name() {
        let taken = frame(vec![Reading::Ok(Volts(1.0))]);
        let baseline = Baseline::from_frames("monday", std::slice::from_ref(&taken)).unwrap();
        let mut other = taken.settings.clone();
        other.current = Amps(2e-3);
        let refusal = baseline.check(&other, 1, true).unwrap_err().to_string();
        assert!(
            refusal.contains("'monday'") && refusal.contains("current 1 mA against 2 mA"),
            "{refusal}"
        );
        assert!(baseline.check(&taken.settings, 1, false).is_err());
        assert!(baseline.check(&taken.settings, 2, true).is_err());
    }

    #[test]
    fn quality_counts_and_measures_reciprocity() {
        let frame = frame(vec![
            Reading::Ok(Volts(1.0)),
            Reading::Ok(Volts(0.9)),
            Reading::Overload,
        ]);
        let quality = frame.quality(&[Some(1), Some(0), None]);
        assert_eq!(quality.overloads, 1);
        assert!((quality.reciprocity.unwrap() - 0.1).abs() < 1e-12);
        assert!(!quality.is_clean());
    }

    #[test]
    fn not_a_number_has_no_flag_ok() {
        assert_eq!(Reading::from_flag(0, f64::NAN), None);
        assert_eq!(Reading::from_flag(9, 1.0), None);
        for reading in [
            Reading::Ok(Volts(1.0)),
            Reading::Overload,
            Reading::Timeout,
            Reading::NotMeasured,
        ] {
            assert_eq!(Reading::from_flag(reading.flag(), 1.0), Some(reading));
        }
    }
}
