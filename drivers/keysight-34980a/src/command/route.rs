//! Switching (section 4), the scan list (section 5) and sequences (section 6).

use std::fmt;

use scpi::{Call, ChannelList, ParseError, quote};

use super::grammar::{Table, before_channels, list, numbered, one_or};
use super::{Message, OnOff};
use crate::command::Command;

/// Relays, scan list, sequences.
#[derive(Debug, Clone, PartialEq)]
pub enum Route {
    /// Close channels.
    Close(ChannelList),
    /// Open everything else in the slots of the list, then close channels.
    CloseExclusive(ChannelList),
    /// Close channels of the high side and their partners of the low side (34934A, two-wire).
    ClosePair(ChannelList),
    /// Read whether channels are closed.
    Closed(ChannelList),
    /// Read whether both channels of a pair are closed.
    ClosedPair(ChannelList),
    /// Open channels.
    Open(ChannelList),
    /// Open channels of the high side and their partners of the low side.
    OpenPair(ChannelList),
    /// Read whether channels are open.
    Opened(ChannelList),
    /// Read whether both channels of a pair are open.
    OpenedPair(ChannelList),
    /// Open everything, or everything in one slot.
    OpenAll(Option<u32>),
    /// Open the relays of all analogue buses, or of one.
    OpenBuses(Option<u32>),
    /// Set whether commands may begin before relays have settled.
    SetOverlap(bool),
    /// Read whether commands may begin before relays have settled.
    Overlap,
    /// Read whether relays of one slot, or of any slot, are still moving.
    ModuleBusy(Option<u32>),
    /// Wait until the relays of one slot, or of all slots, have settled.
    ModuleWait(Option<u32>),
    /// Set the scan list.
    SetScan(ChannelList),
    /// Add to the scan list.
    AddScan(ChannelList),
    /// Remove from the scan list.
    RemoveScan(ChannelList),
    /// Read the scan list.
    Scan,
    /// Read the number of channels in the scan list.
    ScanSize,
    /// Set whether the scan list is ascending and without repeats, or keeps the given order.
    SetOrdered(bool),
    /// Read the order of the scan list.
    Ordered,
    /// Set user labels of channels (help: ROUTe:CHANnel:LABel\[:DEFine\]).
    SetLabel(String, ChannelList),
    /// Read the user labels of channels.
    Labels(ChannelList),
    /// Define a sequence.
    Define {
        /// The name of the sequence.
        name: String,
        /// The commands, in order.
        commands: Message,
    },
    /// Read the commands of a sequence.
    Definition(String),
    /// Run a sequence.
    Run(String),
    /// Delete one sequence, or all.
    Delete(Option<String>),
    /// Read the names of all sequences.
    Catalog,
    /// Read whether a sequence is running.
    SequenceBusy,
    /// Wait until no sequence is running.
    SequenceWait,
    /// Stop the running sequence.
    SequenceAbort,
}

/// Longest label; a longer one is truncated (help: ROUTe:CHANnel:LABel[:DEFine]).
const LONGEST_LABEL: usize = 18;
/// Longest name of a sequence (section 6).
const LONGEST_NAME: usize = 30;

pub(super) fn rows(table: &mut Table) {
    use Route as R;
    let slot = |call: &Call, all: &str| one_or(call.at_most_one()?, "SLOT", all, 8);
    table.add("ROUTe:CLOSe", |call| list(call).map(R::Close));
    table.add("ROUTe:OPEN", |call| list(call).map(R::Open));
    table.add("ROUTe:CLOSe?", |call| list(call).map(R::Closed));
    table.add("ROUTe:OPEN?", |call| list(call).map(R::Opened));
    table.add("ROUTe:CLOSe:EXCLusive", |call| {
        list(call).map(R::CloseExclusive)
    });
    table.add("ROUTe:CLOSe:PAIR", |call| list(call).map(R::ClosePair));
    table.add("ROUTe:CLOSe:PAIR?", |call| list(call).map(R::ClosedPair));
    table.add("ROUTe:OPEN:PAIR", |call| list(call).map(R::OpenPair));
    table.add("ROUTe:OPEN:PAIR?", |call| list(call).map(R::OpenedPair));
    table.add("ROUTe:OPEN:ALL", move |call| {
        slot(call, "ALL").map(R::OpenAll)
    });
    table.add("ROUTe:OPEN:ABUS", |call| {
        one_or(call.at_most_one()?, "ABUS", "ALL", 4).map(R::OpenBuses)
    });
    table.switch("ROUTe:OPERation:OVERlap[:ENABle]", R::SetOverlap);
    table.plain("ROUTe:OPERation:OVERlap[:ENABle]?", R::Overlap);
    table.add("ROUTe:MODule:BUSY?", move |call| {
        slot(call, "ANY").map(R::ModuleBusy)
    });
    table.add("ROUTe:MODule:WAIT", move |call| {
        slot(call, "ALL").map(R::ModuleWait)
    });
    table.add("ROUTe:SCAN", |call| list(call).map(R::SetScan));
    table.add("ROUTe:SCAN:ADD", |call| list(call).map(R::AddScan));
    table.add("ROUTe:SCAN:REMove", |call| list(call).map(R::RemoveScan));
    table.plain("ROUTe:SCAN?", R::Scan);
    table.plain("ROUTe:SCAN:SIZE?", R::ScanSize);
    table.switch("ROUTe:SCAN:ORDered", R::SetOrdered);
    table.plain("ROUTe:SCAN:ORDered?", R::Ordered);
    table.add("ROUTe:CHANnel:LABel[:DEFine]", |call| {
        let [label, channels] = call.exactly()?;
        let label = label.string()?.chars().take(LONGEST_LABEL).collect();
        Ok(R::SetLabel(label, channels.channels()?))
    });
    table.add("ROUTe:CHANnel:LABel[:DEFine]?", |call| {
        let (which, channels) = before_channels(call)?;
        let channels = channels.ok_or(ParseError::MissingParameter)?;
        match which {
            [] => Ok(R::Labels(channels)),
            // only user labels: the factory labels of channels are not known
            [which] => which.choice(&[("USER", ())]).map(|()| R::Labels(channels)),
            _ => Err(ParseError::ParameterNotAllowed),
        }
    });
    table.add("ROUTe:SEQuence:DEFine", define);
    table.add("ROUTe:SEQuence:DEFine?", |call| {
        name(call).map(R::Definition)
    });
    table.add("ROUTe:SEQuence:TRIGger[:IMMediate]", |call| {
        name(call).map(R::Run)
    });
    table.add("ROUTe:SEQuence:DELete[:NAME]", |call| {
        name(call).map(|name| R::Delete(Some(name)))
    });
    table.plain("ROUTe:SEQuence:DELete:ALL", R::Delete(None));
    table.plain("ROUTe:SEQuence:CATalog?", R::Catalog);
    table.plain("ROUTe:SEQuence:BUSY?", R::SequenceBusy);
    table.plain("ROUTe:SEQuence:WAIT", R::SequenceWait);
    table.plain("ROUTe:SEQuence:ABORt", R::SequenceAbort);
    table.add("SYSTem:CPON", |call| {
        let [slot] = call.exactly()?;
        if slot
            .word()
            .is_ok_and(|word| word.eq_ignore_ascii_case("ALL"))
        {
            return Ok(R::OpenAll(None));
        }
        numbered(slot, "SLOT", 8).map(|slot| R::OpenAll(Some(slot)))
    });
}

/// Checks a name (a letter, then letters, digits and underscores), and returns it in capitals.
fn checked_name(word: &str) -> Result<String, ParseError> {
    if word.len() > LONGEST_NAME || !word.starts_with(|c: char| c.is_ascii_alphabetic()) {
        return Err(ParseError::IllegalParameter);
    }
    Ok(word.to_ascii_uppercase())
}

fn name(call: &Call) -> Result<String, ParseError> {
    let [name] = call.exactly()?;
    checked_name(name.word()?)
}

/// Parses a definition and its commands. One command that is invalid, or not allowed in a sequence, discards the whole
/// sequence (section 6).
fn define(call: &Call) -> Result<Route, ParseError> {
    let [name, text] = call.exactly()?;
    let name = checked_name(name.word()?)?;
    let text = text.string()?;
    let mut commands = Vec::new();
    for call in scpi::parse_message(text) {
        let command = Command::of(&call?)?;
        if !command.is_allowed_in_sequence() {
            return Err(ParseError::SettingsConflict);
        }
        commands.push(command);
    }
    if commands.is_empty() {
        return Err(ParseError::IllegalParameter);
    }
    let commands = Message(commands);
    Ok(Route::Define { name, commands })
}

impl Command {
    /// Whether the command is allowed in a sequence: fact sheet section 6, except digital outputs and DACs, which no
    /// supported module has.
    fn is_allowed_in_sequence(&self) -> bool {
        use super::{Measure, System};
        matches!(
            self,
            Self::Route(
                Route::Close(_)
                    | Route::CloseExclusive(_)
                    | Route::Open(_)
                    | Route::OpenAll(_)
                    | Route::OpenBuses(_)
                    | Route::ModuleWait(_)
                    | Route::Run(_)
            ) | Self::Measure(Measure::Abort)
                | Self::System(System::Delay(_) | System::SetDisplay(_) | System::Beep)
        )
    }
}

impl fmt::Display for Route {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let one = |number: &Option<u32>, all: &str| {
            number.map_or_else(|| all.to_owned(), |number| number.to_string())
        };
        match self {
            Self::Close(list) => write!(f, "ROUT:CLOS {list}"),
            Self::CloseExclusive(list) => write!(f, "ROUT:CLOS:EXCL {list}"),
            Self::ClosePair(list) => write!(f, "ROUT:CLOS:PAIR {list}"),
            Self::Closed(list) => write!(f, "ROUT:CLOS? {list}"),
            Self::ClosedPair(list) => write!(f, "ROUT:CLOS:PAIR? {list}"),
            Self::Open(list) => write!(f, "ROUT:OPEN {list}"),
            Self::OpenPair(list) => write!(f, "ROUT:OPEN:PAIR {list}"),
            Self::Opened(list) => write!(f, "ROUT:OPEN? {list}"),
            Self::OpenedPair(list) => write!(f, "ROUT:OPEN:PAIR? {list}"),
            Self::OpenAll(slot) => write!(f, "ROUT:OPEN:ALL {}", one(slot, "ALL")),
            Self::OpenBuses(bus) => write!(f, "ROUT:OPEN:ABUS {}", one(bus, "ALL")),
            Self::SetOverlap(on) => write!(f, "ROUT:OPER:OVER {}", OnOff(*on)),
            Self::Overlap => f.write_str("ROUT:OPER:OVER?"),
            Self::ModuleBusy(slot) => write!(f, "ROUT:MOD:BUSY? {}", one(slot, "ANY")),
            Self::ModuleWait(slot) => write!(f, "ROUT:MOD:WAIT {}", one(slot, "ALL")),
            Self::SetScan(list) => write!(f, "ROUT:SCAN {list}"),
            Self::AddScan(list) => write!(f, "ROUT:SCAN:ADD {list}"),
            Self::RemoveScan(list) => write!(f, "ROUT:SCAN:REM {list}"),
            Self::Scan => f.write_str("ROUT:SCAN?"),
            Self::ScanSize => f.write_str("ROUT:SCAN:SIZE?"),
            Self::SetOrdered(on) => write!(f, "ROUT:SCAN:ORD {}", OnOff(*on)),
            Self::Ordered => f.write_str("ROUT:SCAN:ORD?"),
            Self::SetLabel(label, list) => write!(f, "ROUT:CHAN:LAB {},{list}", quote(label)),
            Self::Labels(list) => write!(f, "ROUT:CHAN:LAB? {list}"),
            Self::Define { name, commands } => {
                write!(f, "ROUT:SEQ:DEF {name},{}", quote(&commands.to_string()))
            }
            Self::Definition(name) => write!(f, "ROUT:SEQ:DEF? {name}"),
            Self::Run(name) => write!(f, "ROUT:SEQ:TRIG {name}"),
            Self::Delete(Some(name)) => write!(f, "ROUT:SEQ:DEL {name}"),
            Self::Delete(None) => f.write_str("ROUT:SEQ:DEL:ALL"),
            Self::Catalog => f.write_str("ROUT:SEQ:CAT?"),
            Self::SequenceBusy => f.write_str("ROUT:SEQ:BUSY?"),
            Self::SequenceWait => f.write_str("ROUT:SEQ:WAIT"),
            Self::SequenceAbort => f.write_str("ROUT:SEQ:ABOR"),
        }
    }
}
