//! The board's line protocol in both directions: fact sheet section 5. No other module contains text of the protocol.
//!
//! Lines end in LF; every command has exactly one reply, so that a lost reply is detected:
//!
//! | command | reply |
//! |---|---|
//! | `*IDN?` | `<vendor>,GPIO-MUX,<serial>,<firmware>` |
//! | `SET I+\|I-\|V+\|V- <electrode>\|OFF`, `PAIR I\|V <k>` | the four electrodes: `3,4,OFF,OFF` |
//! | `OFF`, `WDOG <ms>`, `STAT?` | the four electrodes |
//! | `LAST?` | microseconds from the board's start to its last edge |
//! | `SYST:ERR?` | `+0,"No error"` |
//! | any rejected command | `ERR <code>,"<text>"` |

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use scpi::{ErrorEntry, quote};
use survey::{Electrode, Relay};

/// Entries of the board's error queue.
pub(crate) const MOST_ERRORS: usize = 20;

/// One of the four terminals that the board connects to an electrode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Pole {
    /// The source's high side: relays 101 and up.
    IPlus,
    /// The source's low side: relays 201 and up.
    IMinus,
    /// The voltmeter's HI: relays 301 and up.
    VPlus,
    /// The voltmeter's LO: relays 401 and up.
    VMinus,
}

impl Pole {
    /// All poles, in the order of every reply.
    pub const ALL: [Self; 4] = [Self::IPlus, Self::IMinus, Self::VPlus, Self::VMinus];

    /// Index in a [`State`].
    pub fn index(self) -> usize {
        match self {
            Self::IPlus => 0,
            Self::IMinus => 1,
            Self::VPlus => 2,
            Self::VMinus => 3,
        }
    }

    /// The relay number of "this electrode on this pole" in a wiring.
    pub fn relay(self, electrode: Electrode) -> Relay {
        Relay((self.index() as u32 + 1) * 100 + electrode.number() as u32)
    }

    /// The pole and electrode of a relay number.
    pub fn of(relay: Relay) -> Option<(Self, Electrode)> {
        let pole = *Self::ALL.get((relay.0 / 100).checked_sub(1)? as usize)?;
        let electrode = Electrode::from_number((relay.0 % 100) as usize)?;
        Some((pole, electrode))
    }
}

impl fmt::Display for Pole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::IPlus => "I+",
            Self::IMinus => "I-",
            Self::VPlus => "V+",
            Self::VMinus => "V-",
        })
    }
}

/// Two poles that `PAIR` moves together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pair {
    /// I+ and I-.
    Current,
    /// V+ and V-.
    Voltage,
}

impl Pair {
    /// The two poles of the pair, plus first.
    pub fn poles(self) -> [Pole; 2] {
        match self {
            Self::Current => [Pole::IPlus, Pole::IMinus],
            Self::Voltage => [Pole::VPlus, Pole::VMinus],
        }
    }
}

/// The electrode on each pole, in the order of [`Pole::ALL`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct State(pub [Option<Electrode>; 4]);

impl State {
    /// The electrode on a pole.
    pub fn on(&self, pole: Pole) -> Option<Electrode> {
        self.0[pole.index()]
    }

    /// This state with another electrode, or none, on a pole.
    pub fn with(mut self, pole: Pole, electrode: Option<Electrode>) -> Self {
        self.0[pole.index()] = electrode;
        self
    }

    /// The electrode that is on both current poles: it would short the source.
    pub fn shorted(&self) -> Option<Electrode> {
        self.on(Pole::IPlus)
            .filter(|electrode| self.on(Pole::IMinus) == Some(*electrode))
    }
}

/// A command to the board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Query the identity.
    Identify,
    /// Connect an electrode, or none, to a pole.
    Set(Pole, Option<Electrode>),
    /// Connect an electrode to the plus pole and its neighbour to the minus pole.
    Pair(Pair, Electrode),
    /// Open all connections.
    Off,
    /// Query the four electrodes.
    AskState,
    /// Query the time of the last edge.
    AskLastEdge,
    /// Query the oldest error and remove it.
    NextError,
    /// Set the watchdog, ms: it opens all connections if no command arrives for this long; 0 disables it.
    Watchdog(u32),
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Identify => f.write_str("*IDN?"),
            Self::Set(pole, None) => write!(f, "SET {pole} OFF"),
            Self::Set(pole, Some(electrode)) => write!(f, "SET {pole} {electrode}"),
            Self::Pair(Pair::Current, electrode) => write!(f, "PAIR I {electrode}"),
            Self::Pair(Pair::Voltage, electrode) => write!(f, "PAIR V {electrode}"),
            Self::Off => f.write_str("OFF"),
            Self::AskState => f.write_str("STAT?"),
            Self::AskLastEdge => f.write_str("LAST?"),
            Self::NextError => f.write_str("SYST:ERR?"),
            Self::Watchdog(milliseconds) => write!(f, "WDOG {milliseconds}"),
        }
    }
}

impl FromStr for Command {
    type Err = ErrorEntry;

    fn from_str(line: &str) -> Result<Self, ErrorEntry> {
        let upper = line.to_ascii_uppercase();
        let words: Vec<&str> = upper.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["*IDN?"] => Ok(Self::Identify),
            ["SET", pole, "OFF"] => Ok(Self::Set(pole_named(pole)?, None)),
            ["SET", pole, electrode] => Ok(Self::Set(
                pole_named(pole)?,
                Some(electrode_numbered(electrode)?),
            )),
            ["PAIR", "I", electrode] => {
                Ok(Self::Pair(Pair::Current, electrode_numbered(electrode)?))
            }
            ["PAIR", "V", electrode] => {
                Ok(Self::Pair(Pair::Voltage, electrode_numbered(electrode)?))
            }
            ["PAIR", _, _] => Err(ErrorEntry::new(-224, "Illegal parameter value; I or V")),
            ["OFF"] => Ok(Self::Off),
            ["STAT?"] => Ok(Self::AskState),
            ["LAST?"] => Ok(Self::AskLastEdge),
            [header] if asks_next_error(header) => Ok(Self::NextError),
            ["WDOG", milliseconds] => whole(milliseconds, "milliseconds").map(Self::Watchdog),
            ["SET" | "PAIR" | "WDOG", rest @ ..] => Err(if rest.len() < 2 {
                ErrorEntry::new(-109, "Missing parameter")
            } else {
                ErrorEntry::new(-108, "Parameter not allowed")
            }),
            ["*IDN?" | "OFF" | "STAT?" | "LAST?", ..] => {
                Err(ErrorEntry::new(-108, "Parameter not allowed"))
            }
            [header, ..] if asks_next_error(header) => {
                Err(ErrorEntry::new(-108, "Parameter not allowed"))
            }
            _ => Err(ErrorEntry::new(-113, "Undefined header")),
        }
    }
}

fn pole_named(word: &str) -> Result<Pole, ErrorEntry> {
    Pole::ALL
        .into_iter()
        .find(|pole| pole.to_string() == word)
        .ok_or_else(|| ErrorEntry::new(-224, "Illegal parameter value; I+, I-, V+ or V-"))
}

fn electrode_numbered(word: &str) -> Result<Electrode, ErrorEntry> {
    let number = whole(word, "an electrode's number or OFF")?;
    Electrode::from_number(number)
        .ok_or_else(|| ErrorEntry::new(-222, "Data out of range; electrodes count from 1"))
}

/// Parses an integer. Text that is not an integer and an integer out of range have different error numbers.
fn whole<N: FromStr>(word: &str, meant: &str) -> Result<N, ErrorEntry> {
    let digits = word.strip_prefix(['+', '-']).unwrap_or(word);
    if digits.is_empty() || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return Err(ErrorEntry::new(-104, format!("Data type error; {meant}")));
    }
    word.parse()
        .map_err(|_| ErrorEntry::new(-222, format!("Data out of range; {meant}")))
}

/// Whether the header is `SYST:ERR?` in a spelling of SCPI: each word long or short; `NEXT` and the leading colon may
/// be left out.
fn asks_next_error(header: &str) -> bool {
    let path = header.strip_prefix(':').unwrap_or(header);
    let words: Option<Vec<&str>> = path.strip_suffix('?').map(|path| path.split(':').collect());
    matches!(
        words.as_deref(),
        Some(["SYST" | "SYSTEM", "ERR" | "ERROR"] | ["SYST" | "SYSTEM", "ERR" | "ERROR", "NEXT"])
    )
}

/// A reply of the board.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reply {
    /// The identity.
    Identity(String),
    /// The four electrodes.
    State(State),
    /// Time of the last edge since the board's start.
    LastEdge(Duration),
    /// An entry of the error queue.
    Error(ErrorEntry),
    /// The command was rejected.
    Refused(ErrorEntry),
}

impl fmt::Display for Reply {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Identity(text) => f.write_str(text),
            Self::State(state) => write!(f, "{state}"),
            Self::LastEdge(at) => write!(f, "{}", at.as_micros()),
            Self::Error(ErrorEntry { code, message }) => write!(f, "{code:+},{}", quote(message)),
            Self::Refused(error) => write!(f, "ERR {error}"),
        }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, electrode) in self.0.iter().enumerate() {
            if index > 0 {
                f.write_str(",")?;
            }
            match electrode {
                Some(electrode) => write!(f, "{electrode}")?,
                None => f.write_str("OFF")?,
            }
        }
        Ok(())
    }
}

/// A reply that does not have the expected form.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' does not name four electrodes")]
pub struct NotAState(String);

impl FromStr for State {
    type Err = NotAState;

    fn from_str(text: &str) -> Result<Self, NotAState> {
        let garbled = || NotAState(text.to_owned());
        let words: Vec<&str> = text.trim().split(',').collect();
        let words: [&str; 4] = words.try_into().map_err(|_| garbled())?;
        let mut state = Self::default();
        for (pole, word) in state.0.iter_mut().zip(words) {
            *pole = match word {
                "OFF" => None,
                number => Some(
                    number
                        .parse()
                        .ok()
                        .and_then(Electrode::from_number)
                        .ok_or_else(garbled)?,
                ),
            };
        }
        Ok(state)
    }
}

/// Parses an error reply, `ERR <code>,"<text>"`; `None` for any other reply.
pub fn error_in_reply(reply: &str) -> Option<ErrorEntry> {
    reply.strip_prefix("ERR ")?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_of_the_driver_are_parsed_by_the_board() {
        let electrode = Electrode(25);
        let mut commands = vec![
            Command::Identify,
            Command::Pair(Pair::Current, electrode),
            Command::Pair(Pair::Voltage, electrode),
            Command::Off,
            Command::AskState,
            Command::AskLastEdge,
            Command::NextError,
            Command::Watchdog(2000),
        ];
        for pole in Pole::ALL {
            commands.extend([
                Command::Set(pole, None),
                Command::Set(pole, Some(electrode)),
            ]);
        }
        for command in commands {
            assert_eq!(command.to_string().parse(), Ok(command));
        }
    }

    #[test]
    fn states_and_refusals_are_read_as_written() {
        let state = State([Some(Electrode(25)), Some(Electrode(0)), None, None]);
        assert_eq!(state.to_string(), "26,1,OFF,OFF");
        assert_eq!(state.to_string().parse(), Ok(state));
        assert!("1,2,3".parse::<State>().is_err());
        assert!("0,2,3,4".parse::<State>().is_err());
        let refused = ErrorEntry::new(-221, "Settings conflict");
        assert_eq!(
            error_in_reply(&Reply::Refused(refused.clone()).to_string()),
            Some(refused)
        );
    }

    #[test]
    fn relays_are_pole_and_electrode() {
        assert_eq!(Pole::of(Relay(126)), Some((Pole::IPlus, Electrode(25))));
        assert_eq!(Pole::VMinus.relay(Electrode(0)), Relay(401));
        for stranger in [Relay(0), Relay(26), Relay(100), Relay(501)] {
            assert_eq!(Pole::of(stranger), None);
        }
    }
}
