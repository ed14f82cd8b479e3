//! Writes commands as text.

use std::fmt;

use scpi::quote;

use super::Command;
use super::grammar::PLAIN;
use super::vocabulary::LISTS;
use crate::List;
use crate::command::Line;
use crate::kind::short;

/// Writes ranges of error numbers in parentheses.
pub(crate) fn error_numbers(numbers: &[[i32; 2]]) -> String {
    let entries: Vec<String> = numbers
        .iter()
        .map(|[from, to]| match from == to {
            true => format!("{from:+}"),
            false => format!("{from:+}:{to:+}"),
        })
        .collect();
    format!("({})", entries.join(","))
}

fn window(line: Line) -> u8 {
    match line {
        Line::Upper => 1,
        Line::Lower => 2,
    }
}

impl Command {
    /// The header of a command without arguments.
    fn plain_header(&self) -> Option<String> {
        PLAIN
            .iter()
            .find(|(_, command)| command == self)
            .map(|(notation, _)| short(notation))
    }
}

impl List {
    /// The headers for setting a list, for appending to it, and for the number of its values.
    fn headers(self) -> [String; 3] {
        LISTS
            .iter()
            .find(|(.., list)| *list == self)
            .map(|(values, more, _)| {
                let count = short(values.trim_end_matches(":DATA"));
                [short(values), short(more), count + ":POIN"]
            })
            .unwrap_or_default()
    }

    fn written(self, values: &[f64]) -> String {
        let values: Vec<String> = values.iter().map(|v| self.kind().written(*v)).collect();
        values.join(",")
    }
}

/// Writes the command in short form from the root, without a leading colon. Numbers are written with the fewest digits
/// that read back to the same bits.
impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(header) = self.plain_header() {
            return f.write_str(&header);
        }
        match self {
            Command::Common(common) => common.fmt(f),
            Command::Save(place) => write!(f, "*SAV {place}"),
            Command::Recall(place) => write!(f, "*RCL {place}"),
            Command::SetLevel(level) => write!(f, "SOUR:CURR {:E}", level.0),
            Command::Level(ask) => write!(f, "SOUR:CURR{ask}"),
            Command::SetRange(level) => write!(f, "SOUR:CURR:RANG {:E}", level.0),
            Command::Range(ask) => write!(f, "SOUR:CURR:RANG{ask}"),
            Command::SetAutorange(on) => write!(f, "SOUR:CURR:RANG:AUTO {}", u8::from(*on)),
            Command::SetCompliance(limit) => write!(f, "SOUR:CURR:COMP {:E}", limit.0),
            Command::Compliance(ask) => write!(f, "SOUR:CURR:COMP{ask}"),
            Command::SetFilter(on) => write!(f, "SOUR:CURR:FILT {}", u8::from(*on)),
            Command::SetOutput(on) => write!(f, "OUTP {}", u8::from(*on)),
            Command::SetShield(shield) => write!(f, "OUTP:ISH {shield}"),
            Command::SetLowToEarth(on) => write!(f, "OUTP:LTE {}", u8::from(*on)),
            Command::SetSpeed(speed) => write!(f, "OUTP:RESP {speed}"),
            Command::SetParameter(parameter, value) => {
                let header = short(parameter.notation());
                write!(f, "{header} {}", parameter.kind().written(*value))
            }
            Command::Parameter(parameter, ask) => {
                write!(f, "{}{ask}", short(parameter.notation()))
            }
            Command::SetList(list, values) => {
                let [header, ..] = list.headers();
                write!(f, "{header} {}", list.written(values))
            }
            Command::AppendList(list, values) => {
                let [_, header, _] = list.headers();
                write!(f, "{header} {}", list.written(values))
            }
            Command::List(list) => write!(f, "{}?", list.headers()[0]),
            Command::ListLength(list) => write!(f, "{}?", list.headers()[2]),
            Command::CopyWave(place) => write!(f, "SOUR:WAVE:ARB:COPY {place}"),
            Command::DeltaPresent(mode) => write!(f, "SOUR:{mode}:NVPR?"),
            Command::ArmDelta(mode) => write!(f, "SOUR:{mode}:ARM"),
            Command::DeltaArmed(mode) => write!(f, "SOUR:{mode}:ARM?"),
            Command::SerialSend(line) => write!(f, "SYST:COMM:SER:SEND {}", quote(line)),
            Command::SetElements(elements) => {
                let words: Vec<String> = elements.iter().map(ToString::to_string).collect();
                write!(f, "FORM:ELEM {}", words.join(","))
            }
            Command::EnableErrors(numbers) => {
                write!(f, "STAT:QUE:ENAB {}", error_numbers(numbers))
            }
            Command::DisableErrors(numbers) => {
                write!(f, "STAT:QUE:DIS {}", error_numbers(numbers))
            }
            Command::SetText(line, text) => {
                write!(f, "DISP:WIND{}:TEXT {}", window(*line), quote(text))
            }
            Command::Text(line) => write!(f, "DISP:WIND{}:TEXT?", window(*line)),
            Command::TextAttributes(line) => write!(f, "DISP:WIND{}:ATTR?", window(*line)),
            Command::Events(group) => write!(f, "STAT:{group}?"),
            Command::Conditions(group) => write!(f, "STAT:{group}:COND?"),
            Command::SetEnable(group, mask) => write!(f, "STAT:{group}:ENAB {mask}"),
            Command::Enable(group) => write!(f, "STAT:{group}:ENAB?"),
            Command::Beep { hertz, seconds } => write!(f, "SYST:BEEP {hertz:E},{seconds:E}"),
            Command::SetAddress(address, value) => {
                write!(f, "SYST:COMM:ETH:{address} {}", quote(&value.to_string()))
            }
            Command::Address(address) => write!(f, "SYST:COMM:ETH:{address}?"),
            Command::BoardSerial(board) => write!(f, "SYST:{board}:SNUM?"),
            Command::BoardRevision(board) => write!(f, "SYST:{board}:REV?"),
            Command::Options
            | Command::Autorange
            | Command::Filter
            | Command::ClearSource
            | Command::Output
            | Command::Shield
            | Command::LowToEarth
            | Command::Speed
            | Command::Interlock
            | Command::ArmSweep
            | Command::SweepArmed
            | Command::AbortSweep
            | Command::Initiate
            | Command::Abort
            | Command::SignalArm
            | Command::SignalTrigger
            | Command::ArmWave
            | Command::StartWave
            | Command::AbortWave
            | Command::LatestReading
            | Command::FreshReading
            | Command::MathReading
            | Command::MakeStatistic
            | Command::StatisticReading
            | Command::LimitFailed
            | Command::EnabledErrors
            | Command::DisabledErrors
            | Command::SerialEnter
            | Command::ClearBuffer
            | Command::BufferData
            | Command::BufferLength
            | Command::BufferFree
            | Command::BufferType
            | Command::Elements
            | Command::PresetStatus
            | Command::NextError
            | Command::ClearErrors
            | Command::Version
            | Command::Preset
            | Command::Local
            | Command::Remote
            | Command::SaveAddresses => {
                unreachable!("a command without arguments is in the table of such commands")
            }
        }
    }
}
