//! Configuration of channels: fact sheet section 5.

use std::fmt;

use scpi::{Argument, Call, Numeric, ParseError, Unit};

use crate::meter::{INTEGRATION, RANGES};

use super::grammar::{Table, before_channels, limit, only_channels, value_and_channels};
use super::{Channels, OnOff, QueryList, TrailingList};

/// A DC voltage range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Range {
    /// The instrument selects the range at every reading.
    Auto,
    /// One of [`crate::RANGES`].
    Fixed(f64),
}

/// One setting of a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Setting {
    /// The range.
    Range(Range),
    /// Whether autorange is on; off keeps the present range.
    RangeAuto(bool),
    /// Integration time, power-line cycles.
    Nplc(f64),
    /// Integration time, s; replaces an integration time in power-line cycles.
    Aperture(f64),
    /// Whether the aperture is the integration time, instead of the power-line cycles.
    ApertureEnabled(bool),
    /// Resolution, V: selects the integration time.
    Resolution(Numeric),
    /// Whether a zero reading follows every reading.
    Autozero(bool),
    /// Take one zero reading now, and none after readings.
    AutozeroOnce,
    /// Input resistance: over 10 Gohm on the low ranges (on), or 10 Mohm on all ranges (off).
    InputAuto(bool),
    /// Delay before each scanned reading, s.
    Delay(f64),
    /// Whether the delay is determined by the integration time.
    DelayAuto(bool),
}

/// A setting without its value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quantity {
    /// See [`Setting::Range`].
    Range,
    /// See [`Setting::RangeAuto`].
    RangeAuto,
    /// See [`Setting::Nplc`].
    Nplc,
    /// See [`Setting::Aperture`].
    Aperture,
    /// See [`Setting::ApertureEnabled`].
    ApertureEnabled,
    /// See [`Setting::Resolution`].
    Resolution,
    /// See [`Setting::Autozero`].
    Autozero,
    /// See [`Setting::InputAuto`].
    InputAuto,
    /// See [`Setting::Delay`].
    Delay,
    /// See [`Setting::DelayAuto`].
    DelayAuto,
}

/// The form that an instrument accepts of the headers of [`Quantity::Autozero`] and [`Quantity::InputAuto`]. These
/// differ between the 34980A's help and the manual of the similar 34970A.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum HeaderForm {
    /// `VOLT:DC:ZERO:AUTO` and `VOLT:DC:IMP:AUTO`, as in the 34980A's help.
    #[default]
    Documented,
    /// `ZERO:AUTO` and `INP:IMP:AUTO`, as in the 34970A's manual.
    Of34970A,
}

/// Configuration of channels; without a channel list, of the internal voltmeter.
#[derive(Debug, Clone, PartialEq)]
pub enum Sense {
    /// Configure for DC volts: set the scan list, and every other setting to its default.
    Configure {
        /// Range.
        range: Range,
        /// Resolution, V: selects the integration time.
        resolution: Option<Numeric>,
        /// The scan list.
        channels: Channels,
    },
    /// Read function, range and resolution.
    Configuration(Channels),
    /// Change one setting.
    Set(Setting, Channels),
    /// Read one setting, or its smallest, largest or default value.
    Ask(Quantity, Option<Numeric>, Channels),
    /// As [`Sense::Set`], with the 34970A's header.
    SetOlder(Setting, Channels),
    /// As [`Sense::Ask`], with the 34970A's header.
    AskOlder(Quantity, Option<Numeric>, Channels),
}

const HEADERS: [(Quantity, &str, &str); 10] = [
    (Quantity::Nplc, "[SENSe]:VOLTage[:DC]:NPLC", "VOLT:DC:NPLC"),
    (
        Quantity::Range,
        "[SENSe]:VOLTage[:DC]:RANGe",
        "VOLT:DC:RANG",
    ),
    (
        Quantity::RangeAuto,
        "[SENSe]:VOLTage[:DC]:RANGe:AUTO",
        "VOLT:DC:RANG:AUTO",
    ),
    (
        Quantity::Aperture,
        "[SENSe]:VOLTage[:DC]:APERture",
        "VOLT:DC:APER",
    ),
    (
        Quantity::ApertureEnabled,
        "[SENSe]:VOLTage[:DC]:APERture:ENABled",
        "VOLT:DC:APER:ENAB",
    ),
    (
        Quantity::Resolution,
        "[SENSe]:VOLTage[:DC]:RESolution",
        "VOLT:DC:RES",
    ),
    (
        Quantity::Autozero,
        "[SENSe]:VOLTage[:DC]:ZERO:AUTO",
        "VOLT:DC:ZERO:AUTO",
    ),
    (
        Quantity::InputAuto,
        "[SENSe]:VOLTage[:DC]:IMPedance:AUTO",
        "VOLT:DC:IMP:AUTO",
    ),
    (Quantity::Delay, "ROUTe:CHANnel:DELay", "ROUT:CHAN:DEL"),
    (
        Quantity::DelayAuto,
        "ROUTe:CHANnel:DELay:AUTO",
        "ROUT:CHAN:DEL:AUTO",
    ),
];

/// The 34970A's headers where they differ.
const OLDER_HEADERS: [(Quantity, &str, &str); 2] = [
    (Quantity::Autozero, "[SENSe]:ZERO:AUTO", "ZERO:AUTO"),
    (Quantity::InputAuto, "INPut:IMPedance:AUTO", "INP:IMP:AUTO"),
];

type Set = fn(Setting, Channels) -> Sense;
type Ask = fn(Quantity, Option<Numeric>, Channels) -> Sense;

pub(super) fn rows(table: &mut Table) {
    let documented = HEADERS.map(|row| (row, Sense::Set as Set, Sense::Ask as Ask));
    let older = OLDER_HEADERS.map(|row| (row, Sense::SetOlder as Set, Sense::AskOlder as Ask));
    for ((quantity, notation, _), set, ask) in documented.into_iter().chain(older) {
        table.add(notation, move |call| {
            let (value, channels) = value_and_channels(call)?;
            Ok(set(setting(quantity, value)?, channels))
        });
        table.add(&format!("{notation}?"), move |call| {
            let (values, channels) = before_channels(call)?;
            if values.len() > 1 {
                return Err(ParseError::ParameterNotAllowed);
            }
            Ok(ask(quantity, limit(values.first())?, channels))
        });
    }
    table.add("CONFigure[:SCALar]:VOLTage[:DC]", |call| {
        let (range, resolution, channels) = volts(call)?;
        Ok(Sense::Configure {
            range,
            resolution,
            channels,
        })
    });
    table.add("CONFigure?", |call| {
        only_channels(call).map(Sense::Configuration)
    });
}

/// `[<range>[,<resolution>]][,(@list)]`.
pub(super) fn volts(call: &Call) -> Result<(Range, Option<Numeric>, Channels), ParseError> {
    let (values, channels) = before_channels(call)?;
    let (range_value, resolution) = match values {
        [] => (None, None),
        [range] => (Some(range), None),
        [range, resolution] => (Some(range), Some(resolution.number(Unit::Volt)?)),
        _ => return Err(ParseError::ParameterNotAllowed),
    };
    Ok((
        range_value.map_or(Ok(Range::Auto), |value| range(value, Unit::Volt, &RANGES))?,
        resolution.filter(|resolution| *resolution != Numeric::Def),
        channels,
    ))
}

/// Formats `[<range>[,<resolution>]][,(@list)]`.
pub(super) fn write_volts(
    f: &mut fmt::Formatter<'_>,
    range: Range,
    resolution: Option<Numeric>,
    channels: &Channels,
) -> fmt::Result {
    write!(f, "{range}")?;
    if let Some(resolution) = resolution {
        write!(f, ",{resolution}")?;
    }
    write!(f, "{}", TrailingList(channels))
}

fn setting(quantity: Quantity, value: &Argument) -> Result<Setting, ParseError> {
    Ok(match quantity {
        Quantity::Range => Setting::Range(range(value, Unit::Volt, &RANGES)?),
        Quantity::RangeAuto => Setting::RangeAuto(value.boolean()?),
        Quantity::Nplc => {
            let nplc = value.number(Unit::PowerLineCycle)?;
            Setting::Nplc(integration_of(nplc.within(0.02, 200.0, 1.0)?))
        }
        Quantity::Aperture => {
            let aperture = value.number(Unit::Second)?.within(300e-6, 1.0, 1.0)?;
            // the instrument stores steps of 4 us
            Setting::Aperture((aperture / 4e-6).round() * 4.0 / 1e6)
        }
        Quantity::ApertureEnabled => Setting::ApertureEnabled(value.boolean()?),
        Quantity::Resolution => Setting::Resolution(value.number(Unit::Volt)?),
        Quantity::Autozero => match autozero(value)? {
            Some(on) => Setting::Autozero(on),
            None => Setting::AutozeroOnce,
        },
        Quantity::InputAuto => Setting::InputAuto(value.boolean()?),
        Quantity::Delay => {
            // the instrument stores milliseconds
            let delay = value.number(Unit::Second)?.within(0.0, 60.0, 0.0)?;
            Setting::Delay((delay * 1e3).round() / 1e3)
        }
        Quantity::DelayAuto => Setting::DelayAuto(value.boolean()?),
    })
}

/// Reads on or off, or `None` for ONCE.
pub(super) fn autozero(value: &Argument) -> Result<Option<bool>, ParseError> {
    match value {
        Argument::Word(word) if word.eq_ignore_ascii_case("ONCE") => Ok(None),
        value => value.boolean().map(Some),
    }
}

/// The smallest of the ranges that holds a value.
pub(super) fn range(value: &Argument, unit: Unit, ranges: &[f64]) -> Result<Range, ParseError> {
    if let Argument::Word(word) = value
        && word.eq_ignore_ascii_case("AUTO")
    {
        return Ok(Range::Auto);
    }
    let fixed = match value.number(unit)? {
        Numeric::Def => return Ok(Range::Auto),
        Numeric::Min => ranges.first().copied(),
        Numeric::Max => ranges.last().copied(),
        Numeric::Value(value) => ranges.iter().copied().find(|range| value.abs() <= *range),
        _ => None,
    };
    fixed.map(Range::Fixed).ok_or(ParseError::OutOfRange)
}

/// The shortest available integration time that is not shorter than requested.
fn integration_of(nplc: f64) -> f64 {
    INTEGRATION
        .into_iter()
        .map(|(time, _)| time)
        .find(|time| nplc <= *time)
        .unwrap_or(200.0)
}

impl Setting {
    /// The setting without its value.
    pub fn quantity(self) -> Quantity {
        match self {
            Self::Range(_) => Quantity::Range,
            Self::RangeAuto(_) => Quantity::RangeAuto,
            Self::Nplc(_) => Quantity::Nplc,
            Self::Aperture(_) => Quantity::Aperture,
            Self::ApertureEnabled(_) => Quantity::ApertureEnabled,
            Self::Resolution(_) => Quantity::Resolution,
            Self::Autozero(_) | Self::AutozeroOnce => Quantity::Autozero,
            Self::InputAuto(_) => Quantity::InputAuto,
            Self::Delay(_) => Quantity::Delay,
            Self::DelayAuto(_) => Quantity::DelayAuto,
        }
    }
}

impl Quantity {
    /// The short form of the header in this form; most headers have only one form.
    pub fn header(self, form: HeaderForm) -> &'static str {
        let older = OLDER_HEADERS
            .into_iter()
            .filter(|_| form == HeaderForm::Of34970A);
        older
            .chain(HEADERS)
            .find(|(quantity, ..)| *quantity == self)
            .map_or("", |(_, _, short)| short)
    }

    /// Whether the 34970A's header differs from the documented one.
    #[cfg(feature = "simulator")]
    fn has_two_headers(self) -> bool {
        OLDER_HEADERS.iter().any(|(quantity, ..)| *quantity == self)
    }
}

#[cfg(feature = "simulator")]
impl Sense {
    /// The form of the header, if the setting has two forms.
    pub(crate) fn header_form(&self) -> Option<HeaderForm> {
        match self {
            Self::SetOlder(..) | Self::AskOlder(..) => Some(HeaderForm::Of34970A),
            Self::Set(setting, _) if setting.quantity().has_two_headers() => {
                Some(HeaderForm::Documented)
            }
            Self::Ask(quantity, ..) if quantity.has_two_headers() => Some(HeaderForm::Documented),
            _ => None,
        }
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("AUTO"),
            Self::Fixed(range) => write!(f, "{range}"),
        }
    }
}

/// Writes the value, as it follows the header.
impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Range(range) => write!(f, "{range}"),
            Self::Nplc(value) | Self::Aperture(value) | Self::Delay(value) => write!(f, "{value}"),
            Self::Resolution(value) => write!(f, "{value}"),
            Self::RangeAuto(on)
            | Self::ApertureEnabled(on)
            | Self::Autozero(on)
            | Self::InputAuto(on)
            | Self::DelayAuto(on) => write!(f, "{}", OnOff(*on)),
            Self::AutozeroOnce => f.write_str("ONCE"),
        }
    }
}

impl fmt::Display for Sense {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Configure {
                range,
                resolution,
                channels,
            } => {
                f.write_str("CONF:VOLT:DC ")?;
                write_volts(f, *range, *resolution, channels)
            }
            Self::Configuration(list) => write!(f, "CONF?{}", QueryList(list)),
            Self::Set(setting, list) => write_setting(f, *setting, list, HeaderForm::Documented),
            Self::SetOlder(setting, list) => write_setting(f, *setting, list, HeaderForm::Of34970A),
            Self::Ask(quantity, limit, list) => {
                write_query(f, *quantity, *limit, list, HeaderForm::Documented)
            }
            Self::AskOlder(quantity, limit, list) => {
                write_query(f, *quantity, *limit, list, HeaderForm::Of34970A)
            }
        }
    }
}

fn write_setting(
    f: &mut fmt::Formatter<'_>,
    setting: Setting,
    list: &Channels,
    form: HeaderForm,
) -> fmt::Result {
    let header = setting.quantity().header(form);
    write!(f, "{header} {setting}{}", TrailingList(list))
}

fn write_query(
    f: &mut fmt::Formatter<'_>,
    quantity: Quantity,
    limit: Option<Numeric>,
    list: &Channels,
    form: HeaderForm,
) -> fmt::Result {
    let header = quantity.header(form);
    match limit {
        None => write!(f, "{header}?{}", QueryList(list)),
        Some(limit) => write!(f, "{header}? {limit}{}", TrailingList(list)),
    }
}
