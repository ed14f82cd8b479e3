//! The text form of faults, for commands, scenes and profiles: parsing and formatting.

use std::fmt;
use std::str::FromStr;
use std::sync::LazyLock;
use std::time::Duration;

use keysight_34980a::ModuleError;
use survey::Relay;

use super::{Fault, FaultError, ReplyFault};
use crate::instrument::{Instrument, Wire};

/// Longest duration of a fault; longer ones are taken for typing errors.
const LONGEST: Duration = Duration::from_secs(86_400);

/// The grammar of faults, for help texts.
pub(crate) static GRAMMAR: LazyLock<String> = LazyLock::new(|| {
    let numbers = Instrument::ALL.map(Instrument::kind);
    let numbers = numbers.iter().filter(|kind| kind.has_numbers);
    let numbers: Vec<&str> = numbers.map(|kind| kind.word).collect();
    let numbers = numbers.join("|");
    format!(
        "\
wire INSTRUMENT cut|silent|sound    cut: connections are closed; silent: they stay open and carry no data; sound: normal
drop INSTRUMENT                     its connections break once; new connections are accepted
late INSTRUMENT SECONDS [COUNT]     the next replies are delayed by this time
lost INSTRUMENT [COUNT]             the next replies are not sent
doubled INSTRUMENT [COUNT]          the next replies are sent twice
half-line INSTRUMENT [COUNT]        only the first half of the next replies is sent
rubbish INSTRUMENT [COUNT]          the next replies are an invalid line with bytes that are not ASCII
{:<36}the next replies with readings have the text NAN in their place
{:<36}the next replies with readings repeat the readings of the previous reply
slow INSTRUMENT SECONDS             every reply takes longer by this time; 0 ends it
reset INSTRUMENT                    power off and on; the board sends its banner again
power-cut                           power off and on of all instruments at once; their network connections break
queue-overflow INSTRUMENT           its error queue overflows
stuck-open RELAY                    reads closed when it is commanded to close, and stays open
stuck-closed RELAY                  reads open when it is commanded to open, and stays closed
free RELAY                          the relay is no longer stuck
slot N empty|filled|MODULE          the module is removed, inserted again, or replaced by another one (with a power cycle)
voltmeter missing|present           the mainframe has no internal voltmeter (with a power cycle)
overload on|off                     every reading is over range
interlock open|closed               the interlock of the 6221
terminal-block N open|shut          the terminal block of the module in slot N
pulse 6221 LINE                     a pulse on line 1 to 6 of its trigger link
pulse 34980a                        a pulse at its external trigger
serial unplug|plug                  the board's port is removed, or back
none                                ends every fault
INSTRUMENT is {}; RELAY is 1003, or on a board pole x 100 + electrode;
MODULE is 34922A, or with its terminal block 34934A,4x128; a reading is a number with an exponent.",
        format!("nan {numbers} [COUNT]"),
        format!("stale {numbers} [COUNT]"),
        Instrument::listed(|kind| kind.word, "or"),
    )
});

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let which =
            |yes: bool, this: &'static str, that: &'static str| if yes { this } else { that };
        match self {
            Self::Wire(instrument, wire) => {
                let state = match wire {
                    Wire::Sound => "sound",
                    Wire::Cut => "cut",
                    Wire::Silent => "silent",
                };
                write!(f, "wire {} {state}", word(*instrument))
            }
            Self::Drop(instrument) => write!(f, "drop {}", word(*instrument)),
            Self::Replies(instrument, reply_fault, count) => {
                let at = word(*instrument);
                match reply_fault {
                    ReplyFault::Late(by) => write!(f, "late {at} {} {count}", by.as_secs_f64()),
                    ReplyFault::Lost => write!(f, "lost {at} {count}"),
                    ReplyFault::Doubled => write!(f, "doubled {at} {count}"),
                    ReplyFault::HalfLine => write!(f, "half-line {at} {count}"),
                    ReplyFault::Rubbish => write!(f, "rubbish {at} {count}"),
                    ReplyFault::NotANumber => write!(f, "nan {at} {count}"),
                    ReplyFault::Stale => write!(f, "stale {at} {count}"),
                }
            }
            Self::Slow(instrument, by) => {
                write!(f, "slow {} {}", word(*instrument), by.as_secs_f64())
            }
            Self::Reset(instrument) => write!(f, "reset {}", word(*instrument)),
            Self::PowerCut => f.write_str("power-cut"),
            Self::QueueOverflow(instrument) => write!(f, "queue-overflow {}", word(*instrument)),
            Self::StuckOpen(relay) => write!(f, "stuck-open {relay}"),
            Self::StuckClosed(relay) => write!(f, "stuck-closed {relay}"),
            Self::Free(relay) => write!(f, "free {relay}"),
            Self::Slot(slot, filled) => {
                write!(f, "slot {slot} {}", which(*filled, "filled", "empty"))
            }
            Self::Module(slot, module) => write!(f, "slot {slot} {module}"),
            Self::Voltmeter(here) => write!(f, "voltmeter {}", which(*here, "present", "missing")),
            Self::Overload(on) => write!(f, "overload {}", which(*on, "on", "off")),
            Self::Interlock(closed) => write!(f, "interlock {}", which(*closed, "closed", "open")),
            Self::TerminalBlock(slot, shut) => {
                write!(f, "terminal-block {slot} {}", which(*shut, "shut", "open"))
            }
            Self::Pulse(Some(line)) => write!(f, "pulse 6221 {line}"),
            Self::Pulse(None) => f.write_str("pulse 34980a"),
            Self::Serial(plugged) => write!(f, "serial {}", which(*plugged, "plug", "unplug")),
            Self::None => f.write_str("none"),
        }
    }
}

fn word(instrument: Instrument) -> &'static str {
    instrument.kind().word
}

fn instrument(given: &str) -> Result<Instrument, String> {
    let given = given.to_ascii_lowercase();
    let mut all = Instrument::ALL.into_iter();
    all.find(|instrument| word(*instrument) == given)
        .ok_or_else(|| {
            let known = Instrument::listed(|kind| kind.word, "or");
            format!("'{given}' is not {known}")
        })
}

fn seconds(word: &str) -> Result<Duration, String> {
    word.parse()
        .ok()
        .and_then(|seconds| Duration::try_from_secs_f64(seconds).ok())
        .filter(|time| *time <= LONGEST)
        .ok_or_else(|| format!("'{word}' is not a time of 0 to 86400 seconds"))
}

fn count(word: Option<&&str>) -> Result<u32, String> {
    let Some(word) = word else { return Ok(1) };
    word.parse()
        .ok()
        .filter(|count| *count > 0)
        .ok_or_else(|| format!("'{word}' is not a count of replies"))
}

fn slot(word: &str) -> Result<u32, String> {
    word.parse()
        .ok()
        .filter(|slot| (1..=8).contains(slot))
        .ok_or_else(|| format!("there is no slot '{word}', slots are 1 to 8"))
}

fn relay(word: &str) -> Result<Relay, String> {
    word.parse()
        .map(Relay)
        .map_err(|_| format!("'{word}' is not the number of a relay"))
}

fn either(word: &str, yes: &str, no: &str) -> Result<bool, String> {
    match word {
        word if word == yes => Ok(true),
        word if word == no => Ok(false),
        _ => Err(format!("'{word}' is not {no} or {yes}")),
    }
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let words: Vec<&str> = text.split_whitespace().collect();
        let fault = match words.as_slice() {
            ["wire", at, state] => instrument(at).and_then(|at| {
                let wire = match *state {
                    "sound" => Wire::Sound,
                    "cut" => Wire::Cut,
                    "silent" => Wire::Silent,
                    _ => return Err(format!("'{state}' is not cut, silent or sound")),
                };
                Ok(Self::Wire(at, wire))
            }),
            ["drop", at] => instrument(at).map(Self::Drop),
            ["late", at, by, rest @ ..] if rest.len() < 2 => instrument(at).and_then(|at| {
                Ok(Self::Replies(
                    at,
                    ReplyFault::Late(seconds(by)?),
                    count(rest.first())?,
                ))
            }),
            [
                kind @ ("lost" | "doubled" | "half-line" | "rubbish" | "nan" | "stale"),
                at,
                rest @ ..,
            ] if rest.len() < 2 => instrument(at).and_then(|at| {
                let reply_fault = match *kind {
                    "lost" => ReplyFault::Lost,
                    "doubled" => ReplyFault::Doubled,
                    "half-line" => ReplyFault::HalfLine,
                    "rubbish" => ReplyFault::Rubbish,
                    "nan" => ReplyFault::NotANumber,
                    _ => ReplyFault::Stale,
                };
                if reply_fault.is_of_readings() && !at.kind().has_numbers {
                    return Err(format!("the {}'s replies hold no readings", word(at)));
                }
                Ok(Self::Replies(at, reply_fault, count(rest.first())?))
            }),
            ["slow", at, by] => instrument(at).and_then(|at| Ok(Self::Slow(at, seconds(by)?))),
            ["reset", at] => instrument(at).map(Self::Reset),
            ["queue-overflow", at] => instrument(at).map(Self::QueueOverflow),
            ["stuck-open", which] => relay(which).map(Self::StuckOpen),
            ["stuck-closed", which] => relay(which).map(Self::StuckClosed),
            ["free", which] => relay(which).map(Self::Free),
            ["slot", number, "filled"] => slot(number).map(|slot| Self::Slot(slot, true)),
            ["slot", number, "empty"] => slot(number).map(|slot| Self::Slot(slot, false)),
            ["slot", number, module] => slot(number).and_then(|slot| {
                let parsed = module.parse();
                parsed
                    .map(|module| Self::Module(slot, module))
                    .map_err(|why: ModuleError| format!("'{module}' is not empty or filled: {why}"))
            }),
            ["power-cut"] => Ok(Self::PowerCut),
            ["terminal-block", number, state] => either(state, "shut", "open")
                .and_then(|shut| Ok(Self::TerminalBlock(slot(number)?, shut))),
            ["voltmeter", state] => either(state, "present", "missing").map(Self::Voltmeter),
            ["overload", state] => either(state, "on", "off").map(Self::Overload),
            ["interlock", state] => either(state, "closed", "open").map(Self::Interlock),
            ["pulse", "34980a"] => Ok(Self::Pulse(None)),
            ["pulse", "6221", line] => line
                .parse()
                .ok()
                .filter(|line| (1..=6).contains(line))
                .map(|line| Self::Pulse(Some(line)))
                .ok_or_else(|| format!("there is no line '{line}', lines are 1 to 6")),
            ["serial", state] => either(state, "plug", "unplug").map(Self::Serial),
            ["none"] => Ok(Self::None),
            [] => Err("it is empty; 'tactus-sim fault --help' lists the kinds".to_owned()),
            [first, ..] => Err(GRAMMAR
                .lines()
                .find(|line| line.split_whitespace().next() == Some(first))
                .and_then(|line| line.split("    ").next())
                .map_or_else(
                    || "'tactus-sim fault --help' lists the kinds".to_owned(),
                    |usage| format!("it is written {usage}"),
                )),
        };
        fault.map_err(|why| FaultError::Words {
            words: text.trim().to_owned(),
            why,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_reads_as_it_is_written() {
        for words in [
            "wire 6221 cut",
            "wire board silent",
            "drop 34980a",
            "late 6221 0.5 1",
            "lost 34980a 3",
            "doubled 6221 1",
            "half-line board 2",
            "rubbish board 1",
            "nan 34980a 1",
            "stale 6221 2",
            "power-cut",
            "slow 34980a 1.5",
            "reset board",
            "queue-overflow 6221",
            "stuck-open 1003",
            "stuck-closed 1036",
            "free 1003",
            "slot 3 empty",
            "slot 1 34922A",
            "slot 1 34934A,4x128",
            "voltmeter missing",
            "overload on",
            "interlock open",
            "terminal-block 2 open",
            "pulse 6221 6",
            "pulse 34980a",
            "serial unplug",
            "none",
        ] {
            let fault: Fault = words.parse().unwrap();
            assert_eq!(fault.to_string(), words);
            if let Some(mended) = fault.ending() {
                assert_eq!(mended.to_string().parse::<Fault>().unwrap(), mended);
                assert_eq!(mended.ending(), None);
            }
        }
        assert_eq!(
            "lost 6221".parse::<Fault>().unwrap().to_string(),
            "lost 6221 1"
        );
    }

    #[test]
    fn unknown_words_are_refused_with_the_known_ones() {
        for (words, reported) in [
            ("", "it is empty; 'tactus-sim fault --help'"),
            ("fire 6221", "tactus-sim fault --help"),
            (
                "wire 6221",
                "it is written wire INSTRUMENT cut|silent|sound",
            ),
            ("wire 6222 cut", "'6222' is not 6221, 34980a or board"),
            ("late 6221 soon", "'soon' is not a time"),
            ("late 6221 1e300", "not a time of 0 to 86400 seconds"),
            ("lost 6221 0", "'0' is not a count"),
            ("slot 9 empty", "slots are 1 to 8"),
            ("slot 1 34999A", "'34999A' is not empty or filled: "),
            ("nan board", "the board's replies hold no readings"),
            ("stale 6221 -1", "'-1' is not a count"),
            ("power-cut 6221", "it is written power-cut"),
            ("stuck-open K3", "'K3' is not the number of a relay"),
            ("pulse 6221 7", "lines are 1 to 6"),
            ("overload maybe", "'maybe' is not off or on"),
        ] {
            let refusal = words.parse::<Fault>().unwrap_err().to_string();
            assert!(refusal.contains(reported), "{words}: {refusal}");
        }
    }
}
