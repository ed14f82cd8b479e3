//! Quality checks of a frame from its own readings: counts, physical laws of a passive sheet, and flags for violations.

#[cfg(test)]
mod tests;

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{Dipole, Electrode, Frame, Protocol, Reading};

/// A deviation from what a sound sheet and rig would measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum QualityFlag {
    /// Readings over range, late, or not taken.
    Incomplete,
    /// The source was in compliance at an injection.
    Compliance,
    /// A reading differs from its reciprocal twin by more than [`Checks::TOLERANCE`] of the largest reading plus six
    /// times its noise: motion within the frame, leakage, or a wiring fault.
    Reciprocity,
    /// The voltages round the ring do not sum to zero, within the same tolerance: a relay or lead is in the wrong
    /// place.
    LoopSum,
    /// A reading is larger than the voltage of its driven pair, or its sign differs from the baseline's: no load causes
    /// that.
    Plausibility,
}

impl QualityFlag {
    /// The word used on D-Bus, in records and in `--json`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Incomplete => "incomplete",
            Self::Compliance => "compliance",
            Self::Reciprocity => "reciprocity",
            Self::LoopSum => "loop_sum",
            Self::Plausibility => "plausibility",
        }
    }

    /// All flags, in order.
    pub const ALL: [Self; 5] = [
        Self::Incomplete,
        Self::Compliance,
        Self::Reciprocity,
        Self::LoopSum,
        Self::Plausibility,
    ];

    /// The flag of a word; `None` for an unknown word.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|flag| flag.word() == word)
    }
}

impl fmt::Display for QualityFlag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// Results of the quality checks of a frame.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Quality {
    /// Readings over range.
    pub overloads: usize,
    /// Readings not taken.
    pub not_measured: usize,
    /// Driving electrodes (plus side) at which the source was in compliance.
    pub compliance: Vec<Electrode>,
    /// Largest difference of a reading from its reciprocal twin, relative to the largest reading; `None` without twins.
    pub reciprocity: Option<f64>,
    /// Largest sum of the voltages round the ring at one injection, relative to the largest reading of the protocol;
    /// `None` if no injection was read all the way round.
    #[serde(default)]
    pub loop_sum: Option<f64>,
    /// Readings that no load on a passive sheet explains.
    #[serde(default)]
    pub implausible: usize,
    /// Violations, in the order of [`QualityFlag`].
    #[serde(default)]
    pub flags: Vec<QualityFlag>,
}

impl Quality {
    /// The counts only, without the checks.
    pub fn counted(frame: &Frame) -> Self {
        let count = |flag: u8| {
            let flagged = frame.readings.iter().filter(|one| one.flag() == flag);
            flagged.count()
        };
        Self {
            overloads: count(1),
            not_measured: count(3),
            compliance: frame.compliance.clone(),
            ..Self::default()
        }
    }

    /// The flags' words, joined by commas; empty if there is none.
    pub fn words(&self) -> String {
        let words: Vec<&str> = self.flags.iter().map(|flag| flag.word()).collect();
        words.join(",")
    }
}

/// The checks for frames of one protocol.
#[derive(Debug, Clone)]
pub struct Checks {
    protocol: Protocol,
    twins: Vec<Option<usize>>,
    baseline: Vec<Reading>,
}

impl Checks {
    /// Allowed difference of twins, and allowed loop sum, as a fraction of the largest reading, before noise is added.
    pub const TOLERANCE: f64 = 1e-3;

    /// Noise allowance in standard deviations: one of 299 pairs exceeds it once in a million frames.
    const DEVIATIONS: f64 = 6.0;

    /// Readings below this fraction of the largest are not compared by sign.
    const SIGN_FROM: f64 = 5e-3;

    /// Checks for frames of this protocol, without a baseline.
    pub fn new(protocol: &Protocol) -> Self {
        Self {
            twins: protocol.reciprocal_twins(),
            protocol: protocol.clone(),
            baseline: Vec::new(),
        }
    }

    /// Adds a baseline's readings, whose signs no load changes.
    #[must_use]
    pub fn against(mut self, baseline: &[Reading]) -> Self {
        baseline.clone_into(&mut self.baseline);
        self
    }

    /// Checks a frame.
    pub fn of(&self, frame: &Frame) -> Quality {
        let mut quality = Quality::counted(frame);
        let largest = largest(&frame.readings);
        quality.reciprocity = self.reciprocal(frame);
        if largest > 0.0 {
            quality.loop_sum = self.loop_sum(frame).map(|worst| worst / largest);
            quality.implausible = self.implausible(frame, largest);
        }
        let noise = frame.settings.noise().0 / largest;
        let beyond = |value: Option<f64>, readings: f64| {
            let allowed = Self::TOLERANCE.max(Self::DEVIATIONS * readings.sqrt() * noise);
            value.is_some_and(|value| value > allowed)
        };
        let ring = self.protocol.electrodes() as f64;
        let flags = [
            (
                QualityFlag::Incomplete,
                quality.overloads + quality.not_measured > 0,
            ),
            (QualityFlag::Compliance, !quality.compliance.is_empty()),
            (QualityFlag::Reciprocity, beyond(quality.reciprocity, 2.0)),
            (QualityFlag::LoopSum, beyond(quality.loop_sum, ring)),
            (QualityFlag::Plausibility, quality.implausible > 0),
        ];
        quality.flags = flags
            .into_iter()
            .filter_map(|(flag, raised)| raised.then_some(flag))
            .collect();
        quality
    }

    /// [`Quality::reciprocity`] alone.
    pub fn reciprocal(&self, frame: &Frame) -> Option<f64> {
        let largest = largest(&frame.readings);
        let worst = self.reciprocity(frame).filter(|_| largest > 0.0)?;
        Some(worst / largest)
    }

    /// Largest difference of twins, V.
    fn reciprocity(&self, frame: &Frame) -> Option<f64> {
        frame
            .readings
            .iter()
            .zip(&self.twins)
            .filter_map(|(reading, twin)| {
                let other = frame.readings.get((*twin)?)?;
                Some((reading.volts()?.0 - other.volts()?.0).abs())
            })
            .reduce(f64::max)
    }

    /// Largest sum round the ring, V, over the injections at which every neighbouring pair was read.
    fn loop_sum(&self, frame: &Frame) -> Option<f64> {
        let ring = self.protocol.electrodes();
        self.protocol
            .drives()
            .into_iter()
            .filter_map(|drive| {
                let mut sums = vec![None; ring];
                let mut take = |sense: Dipole, reading: Reading| {
                    if sense == Dipole::adjacent(sense.plus.0, ring) {
                        sums[sense.plus.0] = reading.volts().map(|volts| volts.0);
                    }
                };
                for (measurement, reading) in
                    self.protocol.measurements().iter().zip(&frame.readings)
                {
                    if measurement.drive == drive {
                        take(measurement.sense, *reading);
                    }
                }
                for extra in frame
                    .extra
                    .iter()
                    .filter(|extra| extra.measurement.drive == drive)
                {
                    take(extra.measurement.sense, extra.reading);
                }
                sums.into_iter().sum::<Option<f64>>().map(f64::abs)
            })
            .reduce(f64::max)
    }

    /// Readings larger than the voltage of their driven pair (all potentials of a passive sheet lie between those of
    /// the driven electrodes), or of the opposite sign to the baseline's.
    fn implausible(&self, frame: &Frame, largest: f64) -> usize {
        let tolerance = Self::TOLERANCE * largest;
        let driven = |drive: Dipole| {
            frame
                .extra
                .iter()
                .find(|extra| extra.measurement.drive == drive && extra.measurement.sense == drive)
                .and_then(|extra| extra.reading.volts())
        };
        let mut bound: Option<(Dipole, Option<f64>)> = None;
        let readings = self.protocol.measurements().iter().zip(&frame.readings);
        readings
            .enumerate()
            .filter(|(index, (measurement, reading))| {
                let Some(volts) = reading.volts() else {
                    return false;
                };
                let most = match bound {
                    Some((drive, most)) if drive == measurement.drive => most,
                    _ => {
                        let most = driven(measurement.drive).map(|volts| volts.0.abs());
                        bound = Some((measurement.drive, most));
                        most
                    }
                };
                let too_large = most.is_some_and(|most| volts.0.abs() > most + tolerance);
                let before = self.baseline.get(*index).and_then(|before| before.volts());
                let least = Self::SIGN_FROM * largest;
                let turned = before.is_some_and(|before| {
                    before.0 * volts.0 < 0.0 && before.0.abs() > least && volts.0.abs() > least
                });
                too_large || turned
            })
            .count()
    }
}

fn largest(readings: &[Reading]) -> f64 {
    readings
        .iter()
        .filter_map(|reading| reading.volts())
        .fold(0.0_f64, |largest, volts| largest.max(volts.0.abs()))
}
