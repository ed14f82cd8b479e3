//! The commands of the 34980A as values, and their grammar in both directions. No SCPI text stands anywhere else.
//!
//! Chapters as in the fact sheet, sections 4 (switching), 5 (measuring) and 7 (status). Numbers are read into what the
//! instrument makes of them: a range is the smallest that holds the value, an integration time the next that exists.

use std::fmt;
use std::str::FromStr;
use std::sync::LazyLock;

use scpi::{Argument, Call, ChannelList, Common, Numeric, ParseError, Pattern, Unit};

/// DC voltage ranges, V (section 5).
pub const RANGES: [f64; 5] = [0.1, 1.0, 10.0, 100.0, 300.0];

/// Integration times, power-line cycles, and the resolution of each as a fraction of the range (section 5). For 2, 20
/// and 200 cycles the sources give none; that of the next shorter is taken.
pub const INTEGRATION: [(f64, f64); 8] = [
    (0.02, 1e-4),
    (0.2, 1e-5),
    (1.0, 3e-6),
    (2.0, 3e-6),
    (10.0, 1e-6),
    (20.0, 1e-6),
    (100.0, 3e-7),
    (200.0, 3e-7),
];

/// A DC voltage range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Range {
    /// The instrument chooses at every reading.
    Auto,
    /// One of [`RANGES`].
    Fixed(f64),
}

/// What starts a sweep.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TriggerSource {
    /// At once.
    Immediate,
    /// `*TRG`.
    Bus,
    /// A pulse at the rear.
    External,
    /// The timer.
    Timer,
}

/// A field that a reading may carry behind its value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Field {
    /// ` VDC`.
    Unit,
    /// Time since the start of the scan.
    Time,
    /// Channel number.
    Channel,
    /// Number of the alarm.
    Alarm,
}

/// A group of status registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum StatusGroup {
    /// Measuring, waiting for a trigger.
    Operation,
    /// Overload, memory.
    Questionable,
}

/// Channels that a setting is for; `None`: those of the scan list.
pub type Channels = Option<ChannelList>;

/// One command.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// A common command.
    Common(Common),
    /// Measure and answer all readings; with a list, as if that were the scan list.
    Read(Channels),
    /// Measure into memory.
    Initiate,
    /// Answer all readings in memory.
    Fetch,
    /// Stop measuring.
    Abort,
    /// Close channels.
    Close(ChannelList),
    /// Open everything else in the slots named, then close channels.
    CloseExclusive(ChannelList),
    /// Read whether channels are closed.
    Closed(ChannelList),
    /// Open channels.
    Open(ChannelList),
    /// Read whether channels are open.
    Opened(ChannelList),
    /// Open everything, or everything in one slot.
    OpenAll(Option<u32>),
    /// Open the relays of all analogue buses, or of one.
    OpenBuses(Option<u32>),
    /// Set the scan list.
    SetScan(ChannelList),
    /// Read the scan list.
    Scan,
    /// Read how many channels the scan list has.
    ScanSize,
    /// Set the delay before each scanned reading, s.
    SetChannelDelay(f64, Channels),
    /// Read it.
    ChannelDelay(Channels),
    /// Let the delay follow the integration time, or not.
    SetChannelDelayAuto(bool, Channels),
    /// Read whether it does.
    ChannelDelayAuto(Channels),
    /// Measure DC volts: sets the scan list, and everything else to its default.
    ConfigureVolts {
        /// Range.
        range: Range,
        /// Resolution, V: chooses the integration time.
        resolution: Option<Numeric>,
        /// The scan list.
        channels: Channels,
    },
    /// Read function, range and resolution.
    Configuration(Channels),
    /// Set the integration time, power-line cycles.
    SetNplc(f64, Channels),
    /// Read it.
    Nplc(Channels),
    /// Set the range.
    SetRange(Range, Channels),
    /// Read it.
    Range(Channels),
    /// Let the instrument choose the range, or keep the one it has.
    SetRangeAuto(bool, Channels),
    /// Read whether it chooses.
    RangeAuto(Channels),
    /// Take a zero reading after every reading, or not.
    SetAutozero(bool, Channels),
    /// Read whether it does.
    Autozero(Channels),
    /// Over 10 Gohm on the low ranges (on), or 10 Mohm on all.
    SetInputAuto(bool, Channels),
    /// Read which.
    InputAuto(Channels),
    /// Set what starts a sweep.
    SetTriggerSource(TriggerSource),
    /// Read it.
    TriggerSource,
    /// Set the time from sweep to sweep, s.
    SetTriggerTimer(f64),
    /// Read it.
    TriggerTimer,
    /// Set how many sweeps a measurement has.
    SetTriggerCount(u32),
    /// Read it.
    TriggerCount,
    /// Append a field to every reading, or not.
    SetField(Field, bool),
    /// Read whether it is appended.
    Field(Field),
    /// Read what a slot holds.
    CardType(u32),
    /// Take the oldest error.
    NextError,
    /// Read the year of the SCPI standard kept.
    Version,
    /// Read how often relays were closed.
    RelayCycles(ChannelList),
    /// Read a group's events and clear them.
    Events(StatusGroup),
    /// Read a group's conditions.
    Conditions(StatusGroup),
    /// Choose which of a group's events are summed up.
    SetEnable(StatusGroup, u16),
    /// Read which.
    Enable(StatusGroup),
    /// Zero the enables of both groups.
    PresetStatus,
}

const SOURCES: [(&str, TriggerSource); 4] = [
    ("IMMediate", TriggerSource::Immediate),
    ("BUS", TriggerSource::Bus),
    ("EXTernal", TriggerSource::External),
    ("TIMer", TriggerSource::Timer),
];

const FIELDS: [(&str, Field); 4] = [
    ("UNIT", Field::Unit),
    ("TIME", Field::Time),
    ("CHANnel", Field::Channel),
    ("ALARm", Field::Alarm),
];

const GROUPS: [(&str, StatusGroup); 2] = [
    ("OPERation", StatusGroup::Operation),
    ("QUEStionable", StatusGroup::Questionable),
];

type Hearer = Box<dyn Fn(&Call) -> Result<Command, ParseError> + Send + Sync>;

/// Headers in the manual's notation with what they mean; ending in `?` for queries. The most frequent come first.
static GRAMMAR: LazyLock<Vec<(bool, Pattern, Hearer)>> = LazyLock::new(|| {
    use Command as C;
    let mut grammar = Vec::new();
    let mut hear = |notation: &str, hearer: Hearer| {
        grammar.push((notation.ends_with('?'), Pattern::new(notation), hearer));
    };
    macro_rules! rows {
        ($($notation:literal => $hearer:expr;)*) => { $(hear($notation, Box::new($hearer));)* };
    }
    rows! {
        "READ?" => |call| only_channels(call).map(C::Read);
        "ROUTe:CLOSe" => |call| list(call).map(C::Close);
        "ROUTe:OPEN" => |call| list(call).map(C::Open);
        "ROUTe:CLOSe?" => |call| list(call).map(C::Closed);
        "ROUTe:OPEN?" => |call| list(call).map(C::Opened);
        "ROUTe:CLOSe:EXCLusive" => |call| list(call).map(C::CloseExclusive);
        "ROUTe:OPEN:ALL" => |call| one_or_all(call, 8).map(C::OpenAll);
        "ROUTe:OPEN:ABUS" => |call| one_or_all(call, 4).map(C::OpenBuses);
        "ROUTe:SCAN" => |call| list(call).map(C::SetScan);
        "ROUTe:SCAN?" => |call| plain(call, C::Scan);
        "ROUTe:SCAN:SIZE?" => |call| plain(call, C::ScanSize);
        "ROUTe:CHANnel:DELay" => |call| {
            let (value, channels) = value_and_channels(call)?;
            // Milliseconds are what the instrument keeps.
            let delay = value.number(Unit::Second)?.within(0.0, 60.0, 0.0)?;
            Ok(C::SetChannelDelay((delay * 1e3).round() / 1e3, channels))
        };
        "ROUTe:CHANnel:DELay?" => |call| only_channels(call).map(C::ChannelDelay);
        "ROUTe:CHANnel:DELay:AUTO" => |call| switch(call, C::SetChannelDelayAuto);
        "ROUTe:CHANnel:DELay:AUTO?" => |call| only_channels(call).map(C::ChannelDelayAuto);
        "CONFigure:VOLTage[:DC]" => configure;
        "CONFigure?" => |call| only_channels(call).map(C::Configuration);
        "[SENSe]:VOLTage[:DC]:NPLC" => |call| {
            let (value, channels) = value_and_channels(call)?;
            let nplc = value.number(Unit::PowerLineCycle)?.within(0.02, 200.0, 1.0)?;
            Ok(C::SetNplc(integration_of(nplc), channels))
        };
        "[SENSe]:VOLTage[:DC]:NPLC?" => |call| only_channels(call).map(C::Nplc);
        "[SENSe]:VOLTage[:DC]:RANGe" => |call| {
            let (value, channels) = value_and_channels(call)?;
            Ok(C::SetRange(range(value)?, channels))
        };
        "[SENSe]:VOLTage[:DC]:RANGe?" => |call| only_channels(call).map(C::Range);
        "[SENSe]:VOLTage[:DC]:RANGe:AUTO" => |call| switch(call, C::SetRangeAuto);
        "[SENSe]:VOLTage[:DC]:RANGe:AUTO?" => |call| only_channels(call).map(C::RangeAuto);
        "[SENSe]:ZERO:AUTO" => |call| switch(call, C::SetAutozero);
        "[SENSe]:ZERO:AUTO?" => |call| only_channels(call).map(C::Autozero);
        "INPut:IMPedance:AUTO" => |call| switch(call, C::SetInputAuto);
        "INPut:IMPedance:AUTO?" => |call| only_channels(call).map(C::InputAuto);
        "INITiate[:IMMediate]" => |call| plain(call, C::Initiate);
        "FETCh?" => |call| plain(call, C::Fetch);
        "ABORt" => |call| plain(call, C::Abort);
        "TRIGger:SOURce" => |call| {
            let [source] = call.exactly()?;
            source.choice(&SOURCES).map(C::SetTriggerSource)
        };
        "TRIGger:SOURce?" => |call| plain(call, C::TriggerSource);
        "TRIGger:TIMer" => |call| {
            let [time] = call.exactly()?;
            time.number(Unit::Second)?.within(0.0, 359_999.999, 10.0).map(C::SetTriggerTimer)
        };
        "TRIGger:TIMer?" => |call| plain(call, C::TriggerTimer);
        "TRIGger:COUNt" => |call| {
            let [count] = call.exactly()?;
            // The limits are those of u32. INF is not among them: see the simulator.
            count.integer(1, 50_000).map(|count| C::SetTriggerCount(count as u32))
        };
        "TRIGger:COUNt?" => |call| plain(call, C::TriggerCount);
        "SYSTem:CTYPe?" => |call| {
            let [slot] = call.exactly()?;
            slot.integer(1, 8).map(|slot| C::CardType(slot as u32))
        };
        "SYSTem:ERRor[:NEXT]?" => |call| plain(call, C::NextError);
        "SYSTem:VERSion?" => |call| plain(call, C::Version);
        "DIAGnostic:RELay:CYCLes?" => |call| list(call).map(C::RelayCycles);
        "STATus:PRESet" => |call| plain(call, C::PresetStatus);
    }
    for (name, field) in FIELDS {
        let notation = format!("FORMat:READing:{name}");
        let set = move |call: &Call| {
            let [on] = call.exactly()?;
            on.boolean().map(|on| C::SetField(field, on))
        };
        hear(&notation, Box::new(set));
        let ask = move |call: &Call| plain(call, C::Field(field));
        hear(&format!("{notation}?"), Box::new(ask));
    }
    for (name, group) in GROUPS {
        let events = move |call: &Call| plain(call, C::Events(group));
        hear(&format!("STATus:{name}[:EVENt]?"), Box::new(events));
        let conditions = move |call: &Call| plain(call, C::Conditions(group));
        hear(&format!("STATus:{name}:CONDition?"), Box::new(conditions));
        let enable = move |call: &Call| plain(call, C::Enable(group));
        hear(&format!("STATus:{name}:ENABle?"), Box::new(enable));
        let set = move |call: &Call| {
            let [mask] = call.exactly()?;
            // The limits are those of u16.
            mask.integer(0, 65_535)
                .map(|mask| C::SetEnable(group, mask as u16))
        };
        hear(&format!("STATus:{name}:ENABle"), Box::new(set));
    }
    grammar
});

impl Command {
    /// Reads one unit of a message.
    ///
    /// # Errors
    /// -113 for a header that is not one of these, and what the arguments deserve.
    pub fn of(call: &Call) -> Result<Self, ParseError> {
        if let Some(common) = Common::of(call) {
            return common.map(Self::Common);
        }
        GRAMMAR
            .iter()
            .find(|(query, pattern, _)| *query == call.query && pattern.matches(call))
            .map_or(Err(ParseError::UndefinedHeader), |(_, _, hear)| hear(call))
    }
}

fn plain(call: &Call, command: Command) -> Result<Command, ParseError> {
    call.exactly::<0>().map(|_| command)
}

fn list(call: &Call) -> Result<ChannelList, ParseError> {
    let [channels] = call.exactly()?;
    channels.channels()
}

fn only_channels(call: &Call) -> Result<Channels, ParseError> {
    call.at_most_one()?.map(Argument::channels).transpose()
}

/// The arguments before the channel list, which may only be the last, and that list.
fn before_channels(call: &Call) -> Result<(&[Argument], Channels), ParseError> {
    match call.arguments.split_last() {
        Some((last @ Argument::Expression(_), values)) => Ok((values, Some(last.channels()?))),
        _ => Ok((&call.arguments, None)),
    }
}

fn value_and_channels(call: &Call) -> Result<(&Argument, Channels), ParseError> {
    match before_channels(call)? {
        ([], _) => Err(ParseError::MissingParameter),
        ([value], channels) => Ok((value, channels)),
        _ => Err(ParseError::ParameterNotAllowed),
    }
}

fn switch(call: &Call, command: fn(bool, Channels) -> Command) -> Result<Command, ParseError> {
    let (on, channels) = value_and_channels(call)?;
    Ok(command(on.boolean()?, channels))
}

/// `ALL` or nothing, or a number from 1 to `most`.
fn one_or_all(call: &Call, most: i64) -> Result<Option<u32>, ParseError> {
    match call.at_most_one()? {
        None => Ok(None),
        Some(Argument::Word(word)) if word.eq_ignore_ascii_case("ALL") => Ok(None),
        // `most` is 8 at the most.
        Some(number) => number.integer(1, most).map(|number| Some(number as u32)),
    }
}

fn configure(call: &Call) -> Result<Command, ParseError> {
    let (values, channels) = before_channels(call)?;
    let (range_value, resolution) = match values {
        [] => (None, None),
        [range] => (Some(range), None),
        [range, resolution] => (Some(range), Some(resolution.number(Unit::Volt)?)),
        _ => return Err(ParseError::ParameterNotAllowed),
    };
    Ok(Command::ConfigureVolts {
        range: range_value.map_or(Ok(Range::Auto), range)?,
        resolution: resolution.filter(|resolution| *resolution != Numeric::Def),
        channels,
    })
}

/// The smallest range that holds a value.
fn range(value: &Argument) -> Result<Range, ParseError> {
    if let Argument::Word(word) = value
        && word.eq_ignore_ascii_case("AUTO")
    {
        return Ok(Range::Auto);
    }
    let [least, .., most] = RANGES;
    match value.number(Unit::Volt)? {
        Numeric::Def => Ok(Range::Auto),
        Numeric::Min => Ok(Range::Fixed(least)),
        Numeric::Max => Ok(Range::Fixed(most)),
        Numeric::Value(value) => RANGES
            .into_iter()
            .find(|range| value.abs() <= *range)
            .map(Range::Fixed)
            .ok_or(ParseError::OutOfRange),
        _ => Err(ParseError::OutOfRange),
    }
}

/// The shortest integration time that is not shorter than asked.
fn integration_of(nplc: f64) -> f64 {
    INTEGRATION
        .into_iter()
        .map(|(time, _)| time)
        .find(|time| nplc <= *time)
        .unwrap_or(200.0)
}

/// The short form of the notation that stands for a value.
fn word<T: Copy + PartialEq>(choices: &[(&'static str, T)], value: T) -> String {
    choices
        .iter()
        .filter(|(_, candidate)| *candidate == value)
        .flat_map(|(notation, _)| notation.chars())
        .filter(|c| !c.is_ascii_lowercase())
        .collect()
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("AUTO"),
            Self::Fixed(range) => write!(f, "{range}"),
        }
    }
}

impl TriggerSource {
    /// As `TRIG:SOUR?` answers it.
    pub fn word(self) -> String {
        word(&SOURCES, self)
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let on = |on: &bool| if *on { "ON" } else { "OFF" };
        // A setting's list follows a comma, a query's a blank; none leaves both out.
        let behind = |channels: &Channels| match channels {
            Some(channels) => format!(",{channels}"),
            None => String::new(),
        };
        let asked = |channels: &Channels| match channels {
            Some(channels) => format!(" {channels}"),
            None => String::new(),
        };
        let all = |number: &Option<u32>| number.map_or("ALL".to_owned(), |n| n.to_string());
        match self {
            Self::Common(common) => write!(f, "{common}"),
            Self::Read(list) => write!(f, "READ?{}", asked(list)),
            Self::Initiate => f.write_str("INIT"),
            Self::Fetch => f.write_str("FETC?"),
            Self::Abort => f.write_str("ABOR"),
            Self::Close(list) => write!(f, "ROUT:CLOS {list}"),
            Self::CloseExclusive(list) => write!(f, "ROUT:CLOS:EXCL {list}"),
            Self::Closed(list) => write!(f, "ROUT:CLOS? {list}"),
            Self::Open(list) => write!(f, "ROUT:OPEN {list}"),
            Self::Opened(list) => write!(f, "ROUT:OPEN? {list}"),
            Self::OpenAll(slot) => write!(f, "ROUT:OPEN:ALL {}", all(slot)),
            Self::OpenBuses(bus) => write!(f, "ROUT:OPEN:ABUS {}", all(bus)),
            Self::SetScan(list) => write!(f, "ROUT:SCAN {list}"),
            Self::Scan => f.write_str("ROUT:SCAN?"),
            Self::ScanSize => f.write_str("ROUT:SCAN:SIZE?"),
            Self::SetChannelDelay(delay, list) => {
                write!(f, "ROUT:CHAN:DEL {delay}{}", behind(list))
            }
            Self::ChannelDelay(list) => write!(f, "ROUT:CHAN:DEL?{}", asked(list)),
            Self::SetChannelDelayAuto(auto, list) => {
                write!(f, "ROUT:CHAN:DEL:AUTO {}{}", on(auto), behind(list))
            }
            Self::ChannelDelayAuto(list) => write!(f, "ROUT:CHAN:DEL:AUTO?{}", asked(list)),
            Self::ConfigureVolts {
                range,
                resolution,
                channels,
            } => {
                write!(f, "CONF:VOLT:DC {range}")?;
                if let Some(resolution) = resolution {
                    write!(f, ",{resolution}")?;
                }
                f.write_str(&behind(channels))
            }
            Self::Configuration(list) => write!(f, "CONF?{}", asked(list)),
            Self::SetNplc(nplc, list) => write!(f, "VOLT:DC:NPLC {nplc}{}", behind(list)),
            Self::Nplc(list) => write!(f, "VOLT:DC:NPLC?{}", asked(list)),
            Self::SetRange(range, list) => write!(f, "VOLT:DC:RANG {range}{}", behind(list)),
            Self::Range(list) => write!(f, "VOLT:DC:RANG?{}", asked(list)),
            Self::SetRangeAuto(auto, list) => {
                write!(f, "VOLT:DC:RANG:AUTO {}{}", on(auto), behind(list))
            }
            Self::RangeAuto(list) => write!(f, "VOLT:DC:RANG:AUTO?{}", asked(list)),
            Self::SetAutozero(zero, list) => write!(f, "ZERO:AUTO {}{}", on(zero), behind(list)),
            Self::Autozero(list) => write!(f, "ZERO:AUTO?{}", asked(list)),
            Self::SetInputAuto(auto, list) => {
                write!(f, "INP:IMP:AUTO {}{}", on(auto), behind(list))
            }
            Self::InputAuto(list) => write!(f, "INP:IMP:AUTO?{}", asked(list)),
            Self::SetTriggerSource(source) => write!(f, "TRIG:SOUR {}", source.word()),
            Self::TriggerSource => f.write_str("TRIG:SOUR?"),
            Self::SetTriggerTimer(time) => write!(f, "TRIG:TIM {time}"),
            Self::TriggerTimer => f.write_str("TRIG:TIM?"),
            Self::SetTriggerCount(count) => write!(f, "TRIG:COUN {count}"),
            Self::TriggerCount => f.write_str("TRIG:COUN?"),
            Self::SetField(field, shown) => {
                write!(f, "FORM:READ:{} {}", word(&FIELDS, *field), on(shown))
            }
            Self::Field(field) => write!(f, "FORM:READ:{}?", word(&FIELDS, *field)),
            Self::CardType(slot) => write!(f, "SYST:CTYP? {slot}"),
            Self::NextError => f.write_str("SYST:ERR?"),
            Self::Version => f.write_str("SYST:VERS?"),
            Self::RelayCycles(list) => write!(f, "DIAG:REL:CYCL? {list}"),
            Self::Events(group) => write!(f, "STAT:{}?", word(&GROUPS, *group)),
            Self::Conditions(group) => write!(f, "STAT:{}:COND?", word(&GROUPS, *group)),
            Self::SetEnable(group, mask) => {
                write!(f, "STAT:{}:ENAB {mask}", word(&GROUPS, *group))
            }
            Self::Enable(group) => write!(f, "STAT:{}:ENAB?", word(&GROUPS, *group)),
            Self::PresetStatus => f.write_str("STAT:PRES"),
        }
    }
}

impl FromStr for Command {
    type Err = ParseError;

    /// Reads a message of one unit.
    fn from_str(text: &str) -> Result<Self, ParseError> {
        let mut calls = scpi::parse_message(text).into_iter();
        match (calls.next(), calls.next()) {
            (Some(call), None) => Self::of(&call?),
            _ => Err(ParseError::Syntax),
        }
    }
}

/// Commands that go out in one segment.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Message(pub Vec<Command>);

impl fmt::Display for Message {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, command) in self.0.iter().enumerate() {
            match (index, command) {
                (0, _) => {}
                (_, Command::Common(_)) => f.write_str(";")?,
                _ => f.write_str(";:")?,
            }
            write!(f, "{command}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
