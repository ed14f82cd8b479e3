//! The settings of each function, and their values.

use scpi::{Argument, ParseError, Unit};

use super::{Detail, Function, SettingValue};
use crate::command::Range;
use crate::command::sense::{self, autozero};

pub(super) const PROBES: &[(&str, &str)] = &[
    ("TCouple", "TC"),
    ("TC", "TC"),
    ("RTD", "RTD"),
    ("FRTD", "FRTD"),
    ("THERmistor", "THER"),
];
const COUPLES: &[(&str, &str)] = &[
    ("B", "B"),
    ("E", "E"),
    ("J", "J"),
    ("K", "K"),
    ("N", "N"),
    ("R", "R"),
    ("S", "S"),
    ("T", "T"),
];
const JUNCTIONS: &[(&str, &str)] = &[("INTernal", "INT"), ("EXTernal", "EXT"), ("FIXed", "FIX")];
const DEGREES: &[(&str, &str)] = &[("C", "C"), ("F", "F"), ("K", "K")];
const RTDS: &[f64] = &[85.0, 91.0];
const THERMISTORS: &[f64] = &[2252.0, 5000.0, 10_000.0];

/// The values of a setting.
#[derive(Clone, Copy)]
pub(crate) enum ValueKind {
    Switch,
    /// A switch that may also be ONCE.
    Autozero,
    Range,
    Resolution,
    /// Unit, and smallest, largest and default value.
    Number(Unit, [f64; 3]),
    /// Rounded up to the next of these values; then the default.
    Step(Unit, &'static [f64], f64),
    /// Exactly one of these values; then the default.
    OneOf(&'static [f64], f64),
    Words(&'static [(&'static str, &'static str)], &'static str),
}

/// The setting, its notation after that of the function, its short form, the functions that have it, its values.
pub(super) type Row = (
    Detail,
    &'static str,
    &'static str,
    fn(Function) -> bool,
    ValueKind,
);

const GATES: &[f64] = &[0.01, 0.1, 1.0];
const LOWEST: &[f64] = &[3.0, 20.0, 200.0];

#[rustfmt::skip]
pub(super) const ROWS: &[Row] = &[
    (Detail::Range, "RANGe", "RANG", |f| f.alternates() || f.is_ohms() || f == Function::DcCurrent, ValueKind::Range),
    (Detail::RangeAuto, "RANGe:AUTO", "RANG:AUTO", |f| f.alternates() || f.is_ohms() || f == Function::DcCurrent, ValueKind::Switch),
    (Detail::Range, "VOLTage:RANGe", "VOLT:RANG", Function::counts, ValueKind::Range),
    (Detail::RangeAuto, "VOLTage:RANGe:AUTO", "VOLT:RANG:AUTO", Function::counts, ValueKind::Switch),
    (Detail::Nplc, "NPLC", "NPLC", integrates_too, ValueKind::Step(Unit::PowerLineCycle, &[0.02, 0.2, 1.0, 2.0, 10.0, 20.0, 100.0, 200.0], 1.0)),
    (Detail::Aperture, "APERture", "APER", integrates_too, ValueKind::Number(Unit::Second, [300e-6, 1.0, 1.0])),
    (Detail::Aperture, "APERture", "APER", Function::counts, ValueKind::Step(Unit::Second, GATES, 0.1)),
    (Detail::ApertureEnabled, "APERture:ENABled", "APER:ENAB", integrates_too, ValueKind::Switch),
    (Detail::Resolution, "RESolution", "RES", |f| f.is_ohms() || f == Function::DcCurrent, ValueKind::Resolution),
    (Detail::Bandwidth, "BANDwidth", "BAND", Function::alternates, ValueKind::Step(Unit::Hertz, LOWEST, 20.0)),
    (Detail::Bandwidth, "RANGe:LOWer", "RANG:LOW", Function::counts, ValueKind::Step(Unit::Hertz, LOWEST, 20.0)),
    (Detail::Compensated, "OCOMpensated", "OCOM", Function::is_ohms, ValueKind::Switch),
    (Detail::Autozero, "ZERO:AUTO", "ZERO:AUTO", integrates_too, ValueKind::Autozero),
    (Detail::Probe, "TRANsducer:TYPE", "TRAN:TYPE", is_temperature, ValueKind::Words(PROBES, "TC")),
    (Detail::Couple, "TRANsducer:TCouple:TYPE", "TRAN:TC:TYPE", is_temperature, ValueKind::Words(COUPLES, "J")),
    (Detail::JunctionSource, "TRANsducer:TCouple:RJUNction:TYPE", "TRAN:TC:RJUN:TYPE", is_temperature, ValueKind::Words(JUNCTIONS, "FIX")),
    (Detail::Junction, "TRANsducer:TCouple:RJUNction", "TRAN:TC:RJUN", is_temperature, ValueKind::Number(Unit::None, [-20.0, 80.0, 0.0])),
    (Detail::CoupleCheck, "TRANsducer:TCouple:CHECk", "TRAN:TC:CHEC", is_temperature, ValueKind::Switch),
    (Detail::Rtd, "TRANsducer:RTD:TYPE", "TRAN:RTD:TYPE", is_temperature, ValueKind::OneOf(RTDS, 85.0)),
    (Detail::Rtd, "TRANsducer:FRTD:TYPE", "TRAN:FRTD:TYPE", is_temperature, ValueKind::OneOf(RTDS, 85.0)),
    (Detail::RtdOhms, "TRANsducer:RTD:RESistance", "TRAN:RTD:RES", is_temperature, ValueKind::Number(Unit::Ohm, [49.0, 2100.0, 100.0])),
    (Detail::RtdOhms, "TRANsducer:FRTD:RESistance", "TRAN:FRTD:RES", is_temperature, ValueKind::Number(Unit::Ohm, [49.0, 2100.0, 100.0])),
    (Detail::RtdCompensated, "TRANsducer:RTD:OCOMpensated", "TRAN:RTD:OCOM", is_temperature, ValueKind::Switch),
    (Detail::RtdCompensated, "TRANsducer:FRTD:OCOMpensated", "TRAN:FRTD:OCOM", is_temperature, ValueKind::Switch),
    (Detail::Thermistor, "TRANsducer:THERmistor:TYPE", "TRAN:THER:TYPE", is_temperature, ValueKind::OneOf(THERMISTORS, 5000.0)),
    (Detail::Degrees, "", "UNIT:TEMP", is_temperature, ValueKind::Words(DEGREES, "C")),
];

/// Whether the function integrates and is not DC volts, which have rows of their own.
fn integrates_too(function: Function) -> bool {
    function.integrates() && function != Function::DcVolts
}

fn is_temperature(function: Function) -> bool {
    function == Function::Temperature
}

pub(super) fn row_of(function: Function, detail: Detail) -> Option<&'static Row> {
    ROWS.iter()
        .find(|(of, _, _, whose, _)| *of == detail && whose(function))
}

/// The values of a function's setting; `None` if the function has no such setting.
#[cfg(feature = "simulator")]
pub(crate) fn value_kind(function: Function, detail: Detail) -> Option<ValueKind> {
    row_of(function, detail).map(|(.., kind)| *kind)
}

/// Every setting of a function, each once.
#[cfg(test)]
pub(in crate::command) fn details(function: Function) -> Vec<Detail> {
    let mut all: Vec<Detail> = ROWS
        .iter()
        .filter(|(.., whose, _)| whose(function))
        .map(|(detail, ..)| *detail)
        .collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// The smallest of a function's ranges that holds a value.
pub(super) fn range(function: Function, value: &Argument) -> Result<Range, ParseError> {
    let unit = match function {
        Function::Frequency | Function::Period => Unit::Volt,
        _ => function.row().4,
    };
    sense::range(value, unit, function.ranges())
}

pub(super) fn value_of(
    function: Function,
    kind: ValueKind,
    value: &Argument,
) -> Result<SettingValue, ParseError> {
    Ok(match kind {
        ValueKind::Switch => SettingValue::Switch(value.boolean()?),
        ValueKind::Autozero => {
            autozero(value)?.map_or(SettingValue::Word("ONCE"), SettingValue::Switch)
        }
        ValueKind::Range => SettingValue::Range(range(function, value)?),
        ValueKind::Resolution => SettingValue::Resolution(value.number(function.row().4)?),
        ValueKind::Number(unit, [least, most, default]) => {
            SettingValue::Number(value.number(unit)?.within(least, most, default)?)
        }
        ValueKind::Step(unit, steps, default) => {
            let [least, most] = [steps[0], steps[steps.len() - 1]];
            let requested = value.number(unit)?.within(least, most, default)?;
            // The bandwidth argument is the lowest expected frequency: the filter must include it.
            let found = match unit {
                Unit::Hertz => steps.iter().rev().find(|step| **step <= requested),
                _ => steps.iter().find(|step| requested <= **step),
            };
            SettingValue::Number(found.copied().unwrap_or(most))
        }
        ValueKind::OneOf(values, default) => {
            let requested = value.number(Unit::None)?;
            let requested = requested.within(values[0], values[values.len() - 1], default)?;
            match values.contains(&requested) {
                true => SettingValue::Number(requested),
                false => return Err(ParseError::IllegalParameter),
            }
        }
        ValueKind::Words(words, default) => match value {
            Argument::Word(word) if word.eq_ignore_ascii_case("DEF") => SettingValue::Word(default),
            value => SettingValue::Word(value.choice(words)?),
        },
    })
}

/// Reads the type of a transducer: a letter for a thermocouple, otherwise a number.
pub(super) fn kind_of(probe: &str, kind: &Argument) -> Result<&'static str, ParseError> {
    let value_kind = match probe {
        "TC" => ValueKind::Words(COUPLES, "J"),
        "THER" => ValueKind::OneOf(THERMISTORS, 5000.0),
        _ => ValueKind::OneOf(RTDS, 85.0),
    };
    match value_of(Function::Temperature, value_kind, kind)? {
        SettingValue::Word(word) => Ok(word),
        SettingValue::Number(85.0) => Ok("85"),
        SettingValue::Number(91.0) => Ok("91"),
        SettingValue::Number(2252.0) => Ok("2252"),
        SettingValue::Number(5000.0) => Ok("5000"),
        _ => Ok("10000"),
    }
}
