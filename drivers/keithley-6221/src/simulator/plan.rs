//! The points of a sweep, worked out when it is armed.

use std::time::Duration;

use scpi::ParseError;
use survey::{Amps, Volts};

use super::lists::Lists;
use super::values::{LINEAR, LOGARITHMIC, Values};
use crate::{List, Parameter, RANGES, Range};

const MOST_POINTS: f64 = 65_535.0;
/// Places of the choice [`Parameter::Ranging`].
const BEST: f64 = 0.0;
const AUTO: f64 = 1.0;

/// A point of a sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    pub(super) level: Amps,
    pub(super) delay: Duration,
    /// The voltage limit, where the sweep has its own.
    pub(super) limit: Option<Volts>,
    pub(super) range: Range,
}

/// Works out the points.
///
/// # Errors
/// -221 for settings that make no sweep: too many points, a logarithm of 0 or across it, lists of different length, a
/// level beyond the fixed range.
pub(super) fn plan(values: &Values, lists: &Lists, fixed: Range) -> Result<Vec<Point>, ParseError> {
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
    // A list of one value holds for all points (SCPI-99 volume 2, LIST subsystem).
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
            delay: Duration::from_secs_f64(of(&delays, k).unwrap_or(1.0)),
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
            // Sums of decimals may lie a hair beyond the last level.
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
