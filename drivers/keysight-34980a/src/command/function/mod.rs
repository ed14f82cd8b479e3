//! Functions of the voltmeter other than DC volts: the rest of the manual's CONFigure, MEASure and SENSe pages.
//!
//! Each function keeps its own settings on every channel; 2-wire and 4-wire resistance share theirs, as the manual
//! states. Changing a setting of a function does not select the function; only `CONF`, `MEAS?` and `FUNC` do.

mod details;

use std::fmt;

use scpi::{Call, Numeric, ParseError, Unit};

use super::grammar::{Table, before_channels, limit, only_channels, value_and_channels};
pub(crate) use details::ValueKind;
#[cfg(test)]
pub(super) use details::details;
#[cfg(feature = "simulator")]
pub(crate) use details::value_kind;
use details::{PROBES, ROWS, kind_of, range, row_of, value_of};

use super::{Channels, OnOff, QueryList, Range, TrailingList};

/// A function of the voltmeter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Function {
    /// DC volts; its settings are in [`super::Sense`].
    DcVolts,
    /// AC volts, r.m.s. of the alternating part.
    AcVolts,
    /// Resistance between the terminals.
    Resistance,
    /// Resistance, sensed on analogue bus 2.
    FourWire,
    /// Direct current.
    DcCurrent,
    /// Alternating current, r.m.s.
    AcCurrent,
    /// Frequency of a voltage.
    Frequency,
    /// Period of a voltage.
    Period,
    /// Temperature by a thermocouple, an RTD or a thermistor.
    Temperature,
}

/// A setting of a function.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Detail {
    /// The range; for a frequency or period the range of its voltage.
    Range,
    /// Whether the instrument selects the range.
    RangeAuto,
    /// Integration time, power-line cycles.
    Nplc,
    /// Integration time, s; for a frequency or period the gate time.
    Aperture,
    /// Whether the aperture is the integration time, instead of the power-line cycles.
    ApertureEnabled,
    /// Resolution in the function's unit.
    Resolution,
    /// Lowest frequency expected, Hz: 3, 20 or 200.
    Bandwidth,
    /// Offset compensation: measure a second time without the test current.
    Compensated,
    /// Measure zero after each reading.
    Autozero,
    /// Type of transducer.
    Probe,
    /// Type of thermocouple.
    Couple,
    /// Source of the reference junction's temperature.
    JunctionSource,
    /// Temperature of a fixed reference junction, degrees Celsius.
    Junction,
    /// Whether a thermocouple is checked for an open circuit first.
    CoupleCheck,
    /// Temperature coefficient of a 2-wire RTD: 85 for 0.00385, 91 for 0.00391.
    Rtd,
    /// Resistance of a 2-wire RTD at 0 degrees Celsius, ohm.
    RtdOhms,
    /// Offset compensation of a 2-wire RTD: measure a second time without the test current.
    RtdCompensated,
    /// Type of thermistor, ohm at 25 degrees Celsius.
    Thermistor,
    /// Unit of temperatures.
    Degrees,
}

/// The value of a setting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SettingValue {
    /// A number in the setting's unit.
    Number(f64),
    /// On or off.
    Switch(bool),
    /// A word, in short form.
    Word(&'static str),
    /// A range.
    Range(Range),
    /// A resolution.
    Resolution(Numeric),
}

/// The parameters of CONF and MEAS?.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasurementRequest {
    /// The function; never DC volts.
    pub function: Function,
    /// The range; [`Range::Auto`] for frequency, period and temperature, whose range is not a parameter of CONF.
    pub range: Range,
    /// The resolution in the function's unit.
    pub resolution: Option<Numeric>,
    /// For a temperature: the transducer and its type.
    pub probe: Option<(&'static str, &'static str)>,
}

/// Configuration and measurement with any function; without a channel list for the internal voltmeter.
#[derive(Debug, Clone, PartialEq)]
pub enum Functions {
    /// Select a function, set it to its defaults, and make the list the scan list.
    Configure(MeasurementRequest, Channels),
    /// As [`Functions::Configure`], followed by a measurement; the reply has all readings.
    Measure(MeasurementRequest, Channels),
    /// Select a function; its settings stay as they are.
    Select(Function, Channels),
    /// Read the selected function.
    Selected(Channels),
    /// Change a setting.
    Set(Function, Detail, SettingValue, Channels),
    /// Read a setting, or its smallest, largest or default value.
    Ask(Function, Detail, Option<Numeric>, Channels),
}

/// Notation, short form, the word of `FUNC?` and `CONF?`, ranges, unit of numbers, unit after readings.
type FunctionRow = (
    &'static str,
    &'static str,
    &'static str,
    &'static [f64],
    Unit,
    &'static str,
);

/// DC voltage ranges are [`crate::RANGES`].
const VOLTS: &[f64] = &crate::meter::RANGES;
const OHMS: &[f64] = &[1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8];
const AMPS: &[f64] = &[0.01, 0.1, 1.0];

/// Frequencies that can be measured, Hz.
pub(crate) const FREQUENCIES: [f64; 2] = [3.0, 300e3];

impl Function {
    /// All functions.
    pub const ALL: [Self; 9] = [
        Self::DcVolts,
        Self::AcVolts,
        Self::Resistance,
        Self::FourWire,
        Self::DcCurrent,
        Self::AcCurrent,
        Self::Frequency,
        Self::Period,
        Self::Temperature,
    ];

    fn row(self) -> FunctionRow {
        match self {
            Self::DcVolts => ("VOLTage[:DC]", "VOLT:DC", "VOLT", VOLTS, Unit::Volt, "VDC"),
            Self::AcVolts => ("VOLTage:AC", "VOLT:AC", "VOLT:AC", VOLTS, Unit::Volt, "VAC"),
            Self::Resistance => ("RESistance", "RES", "RES", OHMS, Unit::Ohm, "OHM"),
            Self::FourWire => ("FRESistance", "FRES", "FRES", OHMS, Unit::Ohm, "OHM"),
            Self::DcCurrent => ("CURRent[:DC]", "CURR:DC", "CURR", AMPS, Unit::Ampere, "ADC"),
            Self::AcCurrent => (
                "CURRent:AC",
                "CURR:AC",
                "CURR:AC",
                AMPS,
                Unit::Ampere,
                "AAC",
            ),
            Self::Frequency => ("FREQuency", "FREQ", "FREQ", VOLTS, Unit::Hertz, "HZ"),
            Self::Period => ("PERiod", "PER", "PER", VOLTS, Unit::Second, "SEC"),
            Self::Temperature => ("TEMPerature", "TEMP", "TEMP", &[], Unit::None, "C"),
        }
    }

    fn short(self) -> &'static str {
        self.row().1
    }

    /// The name in the replies to `FUNC?` and `CONF?`.
    pub fn word(self) -> &'static str {
        self.row().2
    }

    /// The ranges, in the function's unit; volts for frequency and period, none for temperature.
    pub fn ranges(self) -> &'static [f64] {
        self.row().3
    }

    /// The unit that follows a reading when `FORM:READ:UNIT` is on.
    pub fn mark(self) -> &'static str {
        self.row().5
    }

    /// Whether a reading integrates a direct voltage or current.
    pub(crate) fn integrates(self) -> bool {
        use Function::{DcCurrent, DcVolts, FourWire, Resistance, Temperature};
        matches!(
            self,
            DcVolts | Resistance | FourWire | DcCurrent | Temperature
        )
    }

    fn is_ohms(self) -> bool {
        matches!(self, Self::Resistance | Self::FourWire)
    }

    fn counts(self) -> bool {
        matches!(self, Self::Frequency | Self::Period)
    }

    fn alternates(self) -> bool {
        matches!(self, Self::AcVolts | Self::AcCurrent)
    }
}

pub(super) fn rows(table: &mut Table) {
    for function in Function::ALL {
        let (node, ..) = function.row();
        for (detail, tail, _, whose, kind) in ROWS {
            if !whose(function) {
                continue;
            }
            let (detail, kind) = (*detail, *kind);
            let notation = match detail {
                Detail::Degrees => "UNIT:TEMPerature".to_owned(),
                _ => format!("[SENSe]:{node}:{tail}"),
            };
            table.add(&notation, move |call| {
                let (value, channels) = value_and_channels(call)?;
                let value = value_of(function, kind, value)?;
                Ok(Functions::Set(function, detail, value, channels))
            });
            table.add(&format!("{notation}?"), move |call| {
                let (values, channels) = before_channels(call)?;
                if values.len() > 1 {
                    return Err(ParseError::ParameterNotAllowed);
                }
                let requested = limit(values.first())?;
                Ok(Functions::Ask(function, detail, requested, channels))
            });
        }
        if function != Function::DcVolts {
            table.add(&format!("CONFigure[:SCALar]:{node}"), move |call| {
                let (request, channels) = request(function, call)?;
                Ok(Functions::Configure(request, channels))
            });
            table.add(&format!("MEASure[:SCALar]:{node}?"), move |call| {
                let (request, channels) = request(function, call)?;
                Ok(Functions::Measure(request, channels))
            });
        }
    }
    table.add("[SENSe]:FUNCtion", |call| {
        let (value, channels) = value_and_channels(call)?;
        Ok(Functions::Select(named(value.string()?)?, channels))
    });
    table.add("[SENSe]:FUNCtion?", |call| {
        only_channels(call).map(Functions::Selected)
    });
}

/// Parses the name of a function such as `"VOLT:AC"`, in long or short form.
fn named(text: &str) -> Result<Function, ParseError> {
    let text = text.strip_prefix("SENS:").unwrap_or(text);
    let call = scpi::parse_message(text).into_iter().next();
    let call = call.ok_or(ParseError::IllegalParameter)??;
    Function::ALL
        .into_iter()
        .find(|function| scpi::Pattern::new(function.row().0).matches(&call))
        .ok_or(ParseError::IllegalParameter)
}

/// `[<range>[,<resolution>]][,(@list)]`; for a temperature `<probe>,<kind>[,1[,<resolution>]][,(@list)]`.
fn request(function: Function, call: &Call) -> Result<(MeasurementRequest, Channels), ParseError> {
    let (values, channels) = before_channels(call)?;
    let mut request = MeasurementRequest {
        function,
        range: Range::Auto,
        resolution: None,
        probe: None,
    };
    let values = if function == Function::Temperature {
        let [probe, kind, rest @ ..] = values else {
            return Err(ParseError::MissingParameter);
        };
        let SettingValue::Word(probe) = value_of(function, ValueKind::Words(PROBES, "TC"), probe)?
        else {
            return Err(ParseError::IllegalParameter);
        };
        request.probe = Some((probe, kind_of(probe, kind)?));
        rest
    } else {
        values
    };
    let (expected, resolution) = match values {
        [] => (None, None),
        [expected] => (Some(expected), None),
        [expected, resolution] => (Some(expected), Some(resolution)),
        _ => return Err(ParseError::ParameterNotAllowed),
    };
    if let Some(expected) = expected {
        match function {
            // the instrument ignores this value; clients send a 1
            Function::Temperature => drop(expected.number(Unit::None)?),
            Function::Frequency => {
                let [least, most] = FREQUENCIES;
                expected.number(Unit::Hertz)?.within(least, most, 20.0)?;
            }
            Function::Period => {
                let [lowest, highest] = FREQUENCIES;
                let period = expected.number(Unit::Second)?;
                period.within(1.0 / highest, 1.0 / lowest, 0.05)?;
            }
            _ => request.range = range(function, expected)?,
        }
    }
    if let Some(resolution) = resolution {
        let resolution = resolution.number(function.row().4)?;
        request.resolution = (resolution != Numeric::Def).then_some(resolution);
    }
    Ok((request, channels))
}

impl fmt::Display for SettingValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => write!(f, "{value}"),
            Self::Switch(on) => write!(f, "{}", OnOff(*on)),
            Self::Word(word) => f.write_str(word),
            Self::Range(range) => write!(f, "{range}"),
            Self::Resolution(resolution) => write!(f, "{resolution}"),
        }
    }
}

impl fmt::Display for MeasurementRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let with_range = match (self.function, self.probe) {
            (_, Some((probe, kind))) => {
                write!(f, "{probe},{kind}")?;
                self.resolution.map(|_| ",1".to_owned())
            }
            (Function::Frequency | Function::Period, None) => Some("DEF".to_owned()),
            _ => Some(self.range.to_string()),
        };
        f.write_str(&with_range.unwrap_or_default())?;
        if let Some(resolution) = self.resolution {
            write!(f, ",{resolution}")?;
        }
        Ok(())
    }
}

impl fmt::Display for Functions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let header = |function: Function, detail| match row_of(function, detail) {
            Some((Detail::Degrees, _, short, ..)) => (*short).to_owned(),
            Some((_, _, short, ..)) => format!("{}:{short}", function.short()),
            None => function.short().to_owned(),
        };
        match self {
            Self::Configure(request, list) => {
                write!(
                    f,
                    "CONF:{} {request}{}",
                    request.function.short(),
                    TrailingList(list)
                )
            }
            Self::Measure(request, list) => {
                write!(
                    f,
                    "MEAS:{}? {request}{}",
                    request.function.short(),
                    TrailingList(list)
                )
            }
            Self::Select(function, list) => {
                write!(f, "FUNC \"{}\"{}", function.word(), TrailingList(list))
            }
            Self::Selected(list) => write!(f, "FUNC?{}", QueryList(list)),
            Self::Set(function, detail, value, list) => {
                write!(
                    f,
                    "{} {value}{}",
                    header(*function, *detail),
                    TrailingList(list)
                )
            }
            Self::Ask(function, detail, None, list) => {
                write!(f, "{}?{}", header(*function, *detail), QueryList(list))
            }
            Self::Ask(function, detail, Some(limit), list) => {
                write!(
                    f,
                    "{}? {limit}{}",
                    header(*function, *detail),
                    TrailingList(list)
                )
            }
        }
    }
}
