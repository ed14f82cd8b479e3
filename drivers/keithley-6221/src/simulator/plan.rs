//! The points of sweeps and the shapes of waves, computed from the settings when they are armed, and again when they
//! start.

use std::time::Duration;

use scpi::ParseError;
use survey::{Amps, Volts};

use super::lists::Lists;
use super::values::{LINEAR, LOGARITHMIC, Values};
use super::wave::{Shape, Wave, WaveDuration};
use crate::range::LARGEST_CURRENT;
use crate::{List, Parameter, RANGES, Range};

const MOST_POINTS: f64 = 65_535.0;
/// Indices of the choice [`Parameter::Ranging`].
const BEST: f64 = 0.0;
const AUTO: f64 = 1.0;
/// Indices of the choice [`Parameter::Function`].
const SQUARE: usize = 1;
const RAMP: usize = 2;
const FIRST_ARBITRARY: usize = 3;

/// A point of a sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    pub(super) level: Amps,
    pub(super) delay: Duration,
    /// The voltage limit, if the sweep sets one.
    pub(super) limit: Option<Volts>,
    pub(super) range: Range,
}

/// Computes the points of a sweep.
///
/// # Errors
/// -221 for settings that define no valid sweep: too many points, a logarithmic sweep from, to or across 0, lists of
/// different length, a level beyond the fixed range.
pub(super) fn plan_sweep(
    values: &Values,
    lists: &Lists,
    fixed: Range,
) -> Result<Vec<Point>, ParseError> {
    let spacing = values.get(Parameter::Spacing);
    let (levels, delays, limits) = if spacing == LINEAR {
        let delay = vec![values.get(Parameter::Delay)];
        (linear(values)?, delay, vec![])
    } else if spacing == LOGARITHMIC {
        let delay = vec![values.get(Parameter::Delay)];
        (logarithmic(values)?, delay, vec![])
    } else {
        let list = |list| lists.get(list).to_vec();
        (list(List::Levels), list(List::Delays), list(List::Limits))
    };
    // A list of one value applies to all points (SCPI-99 volume 2, LIST subsystem).
    if [delays.len(), limits.len()]
        .iter()
        .any(|length| *length > 1 && *length != levels.len())
        || levels.is_empty()
    {
        return Err(ParseError::SettingsConflict);
    }
    let ranging = values.get(Parameter::Ranging);
    let largest = levels
        .iter()
        .fold(0.0, |most: f64, level| most.max(level.abs()));
    let common = if ranging == BEST {
        Range::holding(Amps(largest)).ok_or(ParseError::SettingsConflict)?
    } else {
        fixed
    };
    let of = |list: &[f64], k: usize| list.get(k).or(list.first()).copied();
    let point = |(k, level): (usize, &f64)| {
        let level = Amps(*level);
        let range = if ranging == AUTO {
            Range::holding(level).unwrap_or(RANGES[RANGES.len() - 1])
        } else {
            common
        };
        if !range.holds(level) {
            return Err(ParseError::SettingsConflict);
        }
        Ok(Point {
            level,
            delay: survey::duration(of(&delays, k).unwrap_or(1.0)),
            limit: of(&limits, k).map(Volts),
            range,
        })
    };
    levels.iter().enumerate().map(point).collect()
}

fn linear(values: &Values) -> Result<Vec<f64>, ParseError> {
    let points = values.linear_points();
    if points > MOST_POINTS {
        return Err(ParseError::SettingsConflict);
    }
    let (start, stop) = (values.get(Parameter::Start), values.get(Parameter::Stop));
    let step = values.get(Parameter::Step).copysign(stop - start);
    // Within 1 to 65535.
    let points = points as u32;
    Ok((0..points)
        .map(|k| {
            let level = start + step * f64::from(k);
            // Rounded sums of decimals may exceed the last level slightly.
            if step < 0.0 {
                level.max(stop)
            } else {
                level.min(stop)
            }
        })
        .collect())
}

fn logarithmic(values: &Values) -> Result<Vec<f64>, ParseError> {
    let (start, stop) = (values.get(Parameter::Start), values.get(Parameter::Stop));
    if start * stop <= 0.0 {
        return Err(ParseError::SettingsConflict);
    }
    // The kind of the parameter keeps it within 1 to 65535.
    let points = values.get(Parameter::Points) as u32;
    let steps = f64::from(points.max(2) - 1);
    Ok((0..points)
        .map(|k| match k {
            0 => start,
            last if last + 1 == points => stop,
            k => start * (stop / start).powf(f64::from(k) / steps),
        })
        .collect())
}

/// Computes a wave.
///
/// # Errors
/// -221 for a wave beyond its range or the instrument's limits, and for an arbitrary wave that was never set.
pub(super) fn plan_wave(
    values: &Values,
    lists: &Lists,
    kept: &[Vec<f64>; 4],
    fixed: Range,
) -> Result<Wave, ParseError> {
    let part = values.get(Parameter::DutyCycle) / 100.0;
    // The index of one of the eight words.
    let shape = match values.get(Parameter::Function) as usize {
        SQUARE => Shape::Square(part),
        RAMP => Shape::Ramp(part),
        FIRST_ARBITRARY => Shape::Arbitrary(lists.get(List::Wave).to_vec()),
        place @ 4.. => Shape::Arbitrary(kept[place - FIRST_ARBITRARY - 1].clone()),
        _ => Shape::Sine,
    };
    if matches!(&shape, Shape::Arbitrary(points) if points.is_empty()) {
        return Err(ParseError::SettingsConflict);
    }
    let settings = [
        Parameter::Frequency,
        Parameter::Amplitude,
        Parameter::Offset,
    ]
    .map(|parameter| values.get(parameter));
    let lasting = if values.cycles_lead() {
        WaveDuration::Cycles(values.get(Parameter::WaveCycles))
    } else {
        WaveDuration::Seconds(values.get(Parameter::WaveTime))
    };
    let [_, amplitude, offset] = settings;
    let peak = Amps(amplitude + offset.abs());
    // Rounded sums of decimals may exceed the largest current slightly.
    let peak = if peak <= LARGEST_CURRENT * (1.0 + 1e-12) {
        Amps(peak.0.min(LARGEST_CURRENT.0))
    } else {
        return Err(ParseError::SettingsConflict);
    };
    let range = if values.is_on(Parameter::WaveRanging) {
        Some(fixed).filter(|range| range.holds(peak))
    } else {
        Range::holding(peak)
    };
    let range = range.ok_or(ParseError::SettingsConflict)?;
    Ok(Wave::new(shape, settings, lasting, range))
}
