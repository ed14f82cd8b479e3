//! The table of headers in the manual's notation, with their commands.

use std::str::FromStr;
use std::sync::LazyLock;

use scpi::{Argument, Call, Common, ParseError, Table, Unit, parse_message};
use survey::{Amps, Volts};

use super::vocabulary::{
    ADDRESSES, ASKS, BOARDS, ELEMENTS, GROUPS, LINES, LISTS, MODES, SHIELDS, SPEEDS,
};
use super::{Ask, Command, Element, List};
use crate::Parameter;
use crate::kind::Kind;
use crate::range::{LARGEST_CURRENT, LARGEST_LIMIT, RANGES, SMALLEST_LIMIT};

/// Most values of an arbitrary wave in one message (fact sheet, section 4).
const MOST_WAVE_POINTS: usize = 100;

/// Commands without arguments. A notation that ends with `?` is a query.
pub(super) const PLAIN: &[(&str, Command)] = &[
    ("*OPT?", Command::Options),
    ("[SOURce]:CURRent:RANGe:AUTO?", Command::Autorange),
    ("[SOURce]:CURRent:FILTer[:STATe]?", Command::Filter),
    ("[SOURce]:CLEar[:IMMediate]", Command::ClearSource),
    ("OUTPut[:STATe]?", Command::Output),
    ("OUTPut:ISHield?", Command::Shield),
    ("OUTPut:LTEarth?", Command::LowToEarth),
    ("OUTPut:RESPonse?", Command::Speed),
    ("OUTPut:INTerlock:TRIPped?", Command::Interlock),
    ("[SOURce]:SWEep:ARM[:STATe]", Command::ArmSweep),
    ("[SOURce]:SWEep:ARM[:STATe]?", Command::SweepArmed),
    ("[SOURce]:SWEep:ABORt", Command::AbortSweep),
    ("INITiate[:IMMediate]", Command::Initiate),
    ("ABORt", Command::Abort),
    ("ARM[:SEQuence][:LAYer]:SIGNal", Command::SignalArm),
    ("TRIGger[:SEQuence][:LAYer]:SIGNal", Command::SignalTrigger),
    ("[SOURce]:WAVE:ARM", Command::ArmWave),
    ("[SOURce]:WAVE:INITiate", Command::StartWave),
    ("[SOURce]:WAVE:ABORt", Command::AbortWave),
    ("SENSe:DATA[:LATest]?", Command::LatestReading),
    ("SENSe:DATA:FRESh?", Command::FreshReading),
    ("CALCulate:DATA[:LATest]?", Command::MathReading),
    ("CALCulate:DATA:FRESh?", Command::MathReading),
    ("CALCulate2:IMMediate", Command::MakeStatistic),
    ("CALCulate2:DATA?", Command::StatisticReading),
    ("CALCulate3:LIMit:FAIL?", Command::LimitFailed),
    ("SYSTem:COMMunicate:SERial:ENTer?", Command::SerialEnter),
    ("TRACe:CLEar", Command::ClearBuffer),
    ("TRACe:DATA?", Command::BufferData),
    ("TRACe:POINts:ACTual?", Command::BufferLength),
    ("TRACe:ACTual?", Command::BufferLength),
    ("TRACe:FREE?", Command::BufferFree),
    ("TRACe[:DATA]:TYPE?", Command::BufferType),
    ("FORMat:ELEMents?", Command::Elements),
    ("STATus:PRESet", Command::PresetStatus),
    ("SYSTem:ERRor[:NEXT]?", Command::NextError),
    ("STATus:QUEue[:NEXT]?", Command::NextError),
    ("STATus:QUEue:CLEar", Command::ClearErrors),
    ("SYSTem:CLEar", Command::ClearErrors),
    ("STATus:QUEue:ENABle?", Command::EnabledErrors),
    ("STATus:QUEue:DISable?", Command::DisabledErrors),
    ("SYSTem:VERSion?", Command::Version),
    ("SYSTem:PRESet", Command::Preset),
    ("SYSTem:COMMunicate:LOCal", Command::Local),
    ("SYSTem:COMMunicate:REMote", Command::Remote),
    ("SYSTem:COMMunicate:ETHernet:SAVE", Command::SaveAddresses),
];

/// The grammar, with its notation parsed once.
static GRAMMAR: LazyLock<Table<Command>> = LazyLock::new(|| {
    let mut table = Table::default();
    source(&mut table);
    for (notation, command) in PLAIN {
        table.plain(notation, command.clone());
    }
    for &parameter in Parameter::ALL {
        table.add(parameter.notation(), move |call| {
            let [value] = call.exactly()?;
            let value = parameter.kind().read(value)?;
            Ok(Command::SetParameter(parameter, value))
        });
        let query = format!("{}?", parameter.notation());
        table.add(&query, move |call| {
            if parameter.kind().is_number() {
                Ok(Command::Parameter(parameter, ask(call)?))
            } else {
                call.exactly::<0>()?;
                Ok(Command::Parameter(parameter, Ask::Now))
            }
        });
    }
    lists(&mut table);
    status_and_system(&mut table);
    table
});

fn source(table: &mut Table<Command>) {
    const LEVEL: &str = "[SOURce]:CURRent[:LEVel][:IMMediate][:AMPLitude]";
    table.add(LEVEL, |call| current(call).map(Command::SetLevel));
    table.add(&format!("{LEVEL}?"), |call| ask(call).map(Command::Level));
    table.add("[SOURce]:CURRent:RANGe", |call| {
        range(call).map(Command::SetRange)
    });
    table.add("[SOURce]:CURRent:RANGe?", |call| {
        ask(call).map(Command::Range)
    });
    table.switch("[SOURce]:CURRent:RANGe:AUTO", Command::SetAutorange);
    table.add("[SOURce]:CURRent:COMPliance", |call| {
        limit(call).map(Command::SetCompliance)
    });
    table.add("[SOURce]:CURRent:COMPliance?", |call| {
        ask(call).map(Command::Compliance)
    });
    table.switch("[SOURce]:CURRent:FILTer[:STATe]", Command::SetFilter);
    table.switch("OUTPut[:STATe]", Command::SetOutput);
    table.add("OUTPut:ISHield", |call| {
        let [shield] = call.exactly()?;
        shield.choice(&SHIELDS).map(Command::SetShield)
    });
    table.switch("OUTPut:LTEarth", Command::SetLowToEarth);
    table.add("OUTPut:RESPonse", |call| {
        let [speed] = call.exactly()?;
        speed.choice(&SPEEDS).map(Command::SetSpeed)
    });
    for (name, mode) in MODES {
        table.plain(
            &format!("[SOURce]:{name}:NVPResent?"),
            Command::DeltaPresent(mode),
        );
        table.plain(&format!("[SOURce]:{name}:ARM"), Command::ArmDelta(mode));
        table.plain(&format!("[SOURce]:{name}:ARM?"), Command::DeltaArmed(mode));
    }
}

fn lists(table: &mut Table<Command>) {
    for (values, more, list) in LISTS {
        table.add(values, move |call| {
            Ok(Command::SetList(list, list_values(list, &call.arguments)?))
        });
        table.add(more, move |call| {
            Ok(Command::AppendList(
                list,
                list_values(list, &call.arguments)?,
            ))
        });
        table.plain(&format!("{values}?"), Command::List(list));
        let count = values.trim_end_matches(":DATA");
        table.plain(&format!("{count}:POINts?"), Command::ListLength(list));
    }
    table.add("[SOURce]:WAVE:ARBitrary:COPY", |call| {
        place(call, 1, 4).map(Command::CopyWave)
    });
    table.add("FORMat:ELEMents", |call| {
        elements(&call.arguments).map(Command::SetElements)
    });
}

fn status_and_system(table: &mut Table<Command>) {
    for (name, group) in GROUPS {
        table.plain(&format!("STATus:{name}[:EVENt]?"), Command::Events(group));
        table.plain(
            &format!("STATus:{name}:CONDition?"),
            Command::Conditions(group),
        );
        table.plain(&format!("STATus:{name}:ENABle?"), Command::Enable(group));
        table.add(&format!("STATus:{name}:ENABle"), move |call| {
            let [mask] = call.exactly()?;
            // The limits are those of u16.
            let mask = mask.integer(0, 65535)? as u16;
            Ok(Command::SetEnable(group, mask))
        });
    }
    table.add("STATus:QUEue:ENABle", |call| {
        numbers(call).map(Command::EnableErrors)
    });
    table.add("STATus:QUEue:DISable", |call| {
        numbers(call).map(Command::DisableErrors)
    });
    for (window, line, most) in LINES {
        let text = format!("{window}:TEXT[:DATA]");
        table.add(&text, move |call| {
            let [text] = call.exactly()?;
            let text = text.string()?;
            match text.chars().count() <= most {
                true => Ok(Command::SetText(line, text.to_owned())),
                false => Err(ParseError::TooMuchData),
            }
        });
        table.plain(&format!("{text}?"), Command::Text(line));
        table.plain(
            &format!("{window}:ATTRibutes?"),
            Command::TextAttributes(line),
        );
    }
    table.add("*SAV", |call| place(call, 0, 4).map(Command::Save));
    table.add("*RCL", |call| place(call, 0, 4).map(Command::Recall));
    table.add("SYSTem:BEEPer[:IMMediate]", |call| {
        let [hertz, seconds] = call.exactly()?;
        Ok(Command::Beep {
            hertz: hertz.number(Unit::Hertz)?.within(65.0, 2e6, 65.0)?,
            seconds: seconds.number(Unit::Second)?.within(0.0, 7.9, 0.0)?,
        })
    });
    for (name, address) in ADDRESSES {
        let notation = format!("SYSTem:COMMunicate:ETHernet:{name}");
        table.add(&notation, move |call| {
            let [text] = call.exactly()?;
            let words = text.string()?.trim();
            let words = words.parse().map_err(|_| ParseError::IllegalParameter)?;
            Ok(Command::SetAddress(address, words))
        });
        table.plain(&format!("{notation}?"), Command::Address(address));
    }
    table.add("SYSTem:COMMunicate:SERial:SEND", |call| {
        let [line] = call.exactly()?;
        Ok(Command::SerialSend(line.string()?.to_owned()))
    });
    for (name, board) in BOARDS {
        table.plain(
            &format!("SYSTem:{name}:SNUMber?"),
            Command::BoardSerial(board),
        );
        table.plain(
            &format!("SYSTem:{name}:REVision?"),
            Command::BoardRevision(board),
        );
    }
}

impl Command {
    /// Parses one unit of a message.
    ///
    /// # Errors
    /// -113 for an unknown header, or the error of the arguments.
    pub fn of(call: &Call) -> Result<Self, ParseError> {
        if let Some(common) = Common::of(call) {
            return common.map(Command::Common);
        }
        GRAMMAR.read(call)
    }
}

impl FromStr for Command {
    type Err = ParseError;

    /// Parses a message of exactly one command.
    fn from_str(text: &str) -> Result<Self, ParseError> {
        match parse_message(text).as_slice() {
            [call] => call.as_ref().map_err(|refusal| *refusal).and_then(Self::of),
            _ => Err(ParseError::Syntax),
        }
    }
}

/// Reads error numbers such as `(-440:+900,-113)`; the ends of a range may be in either order.
fn numbers(call: &Call) -> Result<Vec<[i32; 2]>, ParseError> {
    let [list] = call.exactly()?;
    let Argument::Expression(text) = list else {
        return Err(ParseError::DataType);
    };
    let inside = text
        .trim()
        .strip_prefix('(')
        .and_then(|text| text.strip_suffix(')'));
    let entry = |entry: &str| {
        let (from, to) = entry.split_once(':').unwrap_or((entry, entry));
        let [from, to] = [from, to].map(|number| number.trim().parse::<i32>());
        let (from, to) = (from.ok()?, to.ok()?);
        Some([from.min(to), from.max(to)])
    };
    let entries: Option<Vec<[i32; 2]>> = inside
        .filter(|inside| !inside.trim().is_empty())
        .map_or(Some(Vec::new()), |inside| {
            inside.split(',').map(entry).collect()
        });
    entries
        .filter(|_| inside.is_some())
        .ok_or(ParseError::InvalidExpression)
}

fn current(call: &Call) -> Result<Amps, ParseError> {
    let [value] = call.exactly()?;
    let most = LARGEST_CURRENT.0;
    value
        .number(Unit::Ampere)?
        .within(-most, most, 0.0)
        .map(Amps)
}

fn range(call: &Call) -> Result<Amps, ParseError> {
    let [value] = call.exactly()?;
    let most = LARGEST_CURRENT.0;
    match value.number(Unit::Ampere)? {
        scpi::Numeric::Min => Ok(RANGES[0].full_scale),
        scpi::Numeric::Max | scpi::Numeric::Def => Ok(RANGES[RANGES.len() - 1].full_scale),
        value => value.within(-most, most, most).map(Amps),
    }
}

fn limit(call: &Call) -> Result<Volts, ParseError> {
    let [value] = call.exactly()?;
    value
        .number(Unit::Volt)?
        .within(SMALLEST_LIMIT.0, LARGEST_LIMIT.0, 10.0)
        .map(Volts)
}

fn ask(call: &Call) -> Result<Ask, ParseError> {
    call.at_most_one()?
        .map_or(Ok(Ask::Now), |which: &Argument| which.choice(&ASKS))
}

/// Reads the number of a memory.
fn place(call: &Call, first: u8, last: u8) -> Result<u8, ParseError> {
    let [place] = call.exactly()?;
    let place = place.integer(first.into(), last.into())?;
    // The limits are those of u8.
    Ok(place as u8)
}

fn list_values(list: List, arguments: &[Argument]) -> Result<Vec<f64>, ParseError> {
    if arguments.is_empty() {
        return Err(ParseError::MissingParameter);
    }
    if list == List::Wave && arguments.len() > MOST_WAVE_POINTS {
        return Err(ParseError::TooMuchData);
    }
    let kind = list.kind();
    arguments.iter().map(|value| kind.read(value)).collect()
}

impl List {
    /// The values that an item of the list takes.
    pub fn kind(self) -> Kind {
        match self {
            List::Levels => Parameter::Start.kind(),
            List::Delays => Parameter::Delay.kind(),
            List::Limits => Kind::Real {
                unit: Unit::Volt,
                limits: [SMALLEST_LIMIT.0, LARGEST_LIMIT.0, 10.0],
                endless: false,
            },
            List::Wave => Kind::Real {
                unit: Unit::None,
                limits: [-1.0, 1.0, 0.0],
                endless: false,
            },
        }
    }
}

fn elements(arguments: &[Argument]) -> Result<Vec<Element>, ParseError> {
    if let [only] = arguments {
        let whole = [("ALL", true), ("DEFault", false)];
        match only.choice(&whole) {
            Ok(true) => return Ok(ELEMENTS.map(|(_, element)| element).to_vec()),
            Ok(false) => return Ok(Element::DEFAULT.to_vec()),
            Err(_) => {}
        }
    }
    if arguments.is_empty() {
        return Err(ParseError::MissingParameter);
    }
    let words = arguments.iter().map(|element| element.choice(&ELEMENTS));
    let words: Vec<Element> = words.collect::<Result<_, _>>()?;
    // Elements are reported in the instrument's order, independent of the order of the request.
    let kept = ELEMENTS.iter().map(|(_, element)| *element);
    Ok(kept.filter(|element| words.contains(element)).collect())
}
