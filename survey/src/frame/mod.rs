//! Frames, baselines and the settings that make them comparable.

#[cfg(test)]
mod tests;

use std::time::Duration;

use chrono::{DateTime, Utc};
use serde::{Deserialize, Serialize};

use crate::{Amps, Electrode, Measurement, Reading, Volts};

/// The settings that must agree between a baseline and a frame for their difference to be meaningful.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// [`crate::Protocol::hash`] of the measurements.
    pub protocol_hash: String,
    /// Injected current.
    pub current: Amps,
    /// The voltmeter's range.
    pub range: Volts,
    /// Integration in power-line cycles.
    pub nplc: f64,
    /// Settling time after a change of current.
    pub settle: Duration,
    /// Name of the wiring.
    pub wiring: String,
    /// Measures against noise, offset and drift.
    #[serde(default)]
    pub precautions: Precautions,
}

/// Measures against noise, offset and drift. The default is none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Precautions {
    /// Whether every reading is followed by a zero reading of the voltmeter.
    pub autozero: bool,
    /// Readings averaged to one.
    pub averages: u32,
    /// Waiting time before each scanned channel.
    pub channel_delay: Duration,
    /// Whether each injection was read with both polarities; a reading is half the difference.
    pub reversal: bool,
    /// Whether a zero-current frame has been subtracted.
    pub zeroed: bool,
    /// Whether each reading had its own range; the range in the settings is then the largest one used.
    pub planned_ranges: bool,
    /// Resolution of the voltmeter at this integration time, as a fraction of its range, from its driver's table; 0:
    /// unknown.
    #[serde(skip_serializing_if = "is_zero")]
    pub resolution: f64,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Default for Precautions {
    fn default() -> Self {
        Self {
            autozero: false,
            averages: 1,
            channel_delay: Duration::ZERO,
            reversal: false,
            zeroed: false,
            planned_ranges: false,
            resolution: 0.0,
        }
    }
}

impl Settings {
    /// Noise of one reading: the voltmeter's resolution, taken as a standard deviation, times the range of the
    /// settings; zero if the resolution is unknown (an imported CSV).
    pub fn noise(&self) -> Volts {
        let Precautions {
            averages,
            reversal,
            zeroed,
            resolution,
            ..
        } = &self.precautions;
        let readings = f64::from((*averages).max(1)) * if *reversal { 2.0 } else { 1.0 };
        let subtracted = if *zeroed { 2.0 } else { 1.0 };
        Volts(resolution * self.range.0 * (subtracted / readings).sqrt())
    }

    /// The settings that differ, with both values, for a message; empty if all agree.
    pub fn differences(&self, other: &Self) -> Vec<String> {
        // with planned ranges the ranges may differ; two different fixed ranges mean that the setting was changed
        let planned = self.precautions.planned_ranges || other.precautions.planned_ranges;
        let both = self.described().into_iter().zip(other.described());
        both.filter(|((name, mine), (_, theirs))| mine != theirs && !(planned && *name == "range"))
            .map(|((name, mine), (_, theirs))| format!("{name} {mine} against {theirs}"))
            .collect()
    }

    /// The settings that must agree, with their values for a message. Averages only change the noise.
    fn described(&self) -> [(&'static str, String); 10] {
        let precautions = &self.precautions;
        let word = |on| if on { "on" } else { "off" }.to_owned();
        [
            ("protocol", self.protocol_hash.clone()),
            ("current", self.current.to_string()),
            ("range", self.range.to_string()),
            ("NPLC", self.nplc.to_string()),
            ("settle", format!("{:?}", self.settle)),
            ("wiring", self.wiring.clone()),
            ("autozero", word(precautions.autozero)),
            ("current reversal", word(precautions.reversal)),
            ("zero-current frame", word(precautions.zeroed)),
            ("channel delay", format!("{:?}", precautions.channel_delay)),
        ]
    }
}

/// A reading taken by the scan in addition to the protocol's. It is used for contact checks and never masks a reading.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Extra {
    /// The measurement.
    pub measurement: Measurement,
    /// Its result.
    pub reading: Reading,
}

/// All readings of one protocol, with their time and settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Counted from 1 in its session; 0 before a session has taken it.
    pub sequence: u64,
    /// Readings in the protocol's order.
    pub readings: Vec<Reading>,
    /// Readings taken in addition to the protocol's, if the wiring scans them. Not kept in records.
    #[serde(default)]
    pub extra: Vec<Extra>,
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
    /// Subtracts a zero-current frame, reading by reading. A reading that is invalid in either frame is invalid in the
    /// result.
    ///
    /// # Errors
    /// The numbers of readings differ.
    pub fn subtract(&mut self, zero: &Self) -> Result<(), BaselineError> {
        if zero.readings.len() != self.readings.len() {
            return Err(BaselineError::Length {
                baseline: "zero-current frame".to_owned(),
                has: zero.readings.len(),
                wants: self.readings.len(),
            });
        }
        let less = |reading: Reading, zero: Reading| match (reading, zero) {
            (Reading::Ok(volts), Reading::Ok(offset)) => Reading::Ok(volts - offset),
            (Reading::Ok(_), lacking) => lacking,
            (lacking, _) => lacking,
        };
        for (reading, zero) in self.readings.iter_mut().zip(&zero.readings) {
            *reading = less(*reading, *zero);
        }
        for extra in &mut self.extra {
            let zero = zero
                .extra
                .iter()
                .find(|zero| zero.measurement == extra.measurement);
            if let Some(zero) = zero {
                extra.reading = less(extra.reading, zero.reading);
            }
        }
        self.settings.precautions.zeroed = true;
        Ok(())
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
        /// Number of its readings.
        has: usize,
        /// Number of readings needed.
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
                    has: frame.readings.len(),
                    wants: last.readings.len(),
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
        let readings: Vec<&[Reading]> = frames.iter().map(|frame| &*frame.readings).collect();
        let (readings, deviation) = mean_of(&readings);
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

    /// Checks that this baseline fits a frame (or the settings of frames to come).
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

/// The mean of each reading over the frames in which it is valid, and the standard deviation of one reading, V, if it
/// is valid in two frames or more. A reading that is valid in no frame keeps the flag of the last frame.
pub fn mean_of(frames: &[&[Reading]]) -> (Vec<Reading>, Vec<Option<f64>>) {
    let last = frames.last().copied().unwrap_or_default();
    let of = |(index, flag): (usize, &Reading)| {
        let valid: Vec<f64> = frames
            .iter()
            .filter_map(|frame| frame[index].volts())
            .map(|volts| volts.0)
            .collect();
        if valid.is_empty() {
            return (*flag, None);
        }
        let mean = valid.iter().sum::<f64>() / valid.len() as f64;
        let deviation = (valid.len() > 1).then(|| {
            let squares: f64 = valid.iter().map(|volts| (volts - mean).powi(2)).sum();
            (squares / (valid.len() - 1) as f64).sqrt()
        });
        (Reading::Ok(Volts(mean)), deviation)
    };
    last.iter().enumerate().map(of).unzip()
}
