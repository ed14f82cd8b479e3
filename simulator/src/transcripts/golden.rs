//! Goldens: conversations that a simulator must reproduce, each with its source.
//!
//! ```text
//! # words for people
//! instrument 34980a
//! cites keysight-34980a, section 1
//! slot 1 34924A
//! > *IDN?
//! ~ Agilent Technologies,34980A,MY44000001,2.43-2.43-0.00-0.00
//! > ROUT:CLOS (@1001)
//! .
//! @ 1.5
//! > ROUT:CLOS? (@1001)
//! < 1
//! ```
//!
//! `>` is sent, `<` is the exact reply, `~` is a reply of this shape (any digit for a digit, any sign for a sign; an
//! overload is an overload), `.` means no reply, and `@` that the next message is sent at least this number of seconds
//! after power on. Before the first `>` come `instrument` (`6221`, `34980a`, `gpio`), `cites`, and the configuration:
//! `slot N MODEL`, `vendor NAME`, `ohms R` on the source's terminals, `volts V` at the voltmeter.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::Instrument;
use crate::instrument::isolated::{InstrumentSetup, IsolatedInstrument};

/// A conversation with its instrument.
#[derive(Debug, Clone, PartialEq)]
pub struct Golden {
    /// Configuration of the instrument.
    pub setup: InstrumentSetup,
    /// Source of the conversation: a section of a fact sheet, a recording.
    pub cites: Vec<String>,
    /// The conversation.
    pub lines: Vec<GoldenLine>,
}

/// A line of the conversation, with its number in the file (from 1).
#[derive(Debug, Clone, PartialEq)]
pub struct GoldenLine {
    /// Its number; 0 if it was not read from a file.
    pub number: usize,
    /// Its content.
    pub step: Step,
}

/// Content of a line of a golden.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// The next message is sent no earlier than this time after power on.
    At(Duration),
    /// A message.
    Say(String),
    /// Its reply.
    Answer(Expected),
    /// There is no reply.
    Silence,
}

/// An expected reply.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Expected {
    /// Exactly this text.
    Text(String),
    /// Any text of this shape.
    Shape(String),
}

impl Expected {
    /// Whether a reply matches.
    pub fn holds(&self, reply: &str) -> bool {
        match self {
            Self::Text(text) => text == reply,
            Self::Shape(shape) => differs_in_digits_only(shape, reply),
        }
    }
}

/// How an instrument reports an overload (fact sheets, 34980A section 5 and 6221 section 3).
const OVERLOAD: &str = "9.90000000E+37";

/// Whether two replies differ in digits and signs only.
fn differs_in_digits_only(one: &str, other: &str) -> bool {
    let overloads = |text: &str| -> Vec<usize> {
        let found = text.match_indices(OVERLOAD);
        found.map(|(at, _)| at).collect()
    };
    let alike = |(one, other): (char, char)| {
        let sign = |letter| matches!(letter, '+' | '-');
        one == other || one.is_ascii_digit() && other.is_ascii_digit() || sign(one) && sign(other)
    };
    one.chars().count() == other.chars().count()
        && one.chars().zip(other.chars()).all(alike)
        && overloads(one) == overloads(other)
}

/// Errors of goldens.
#[derive(Debug, thiserror::Error)]
pub enum GoldenError {
    /// The file cannot be read.
    #[error("the golden {} cannot be read; check the path", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        #[source]
        cause: std::io::Error,
    },
    /// An invalid line.
    #[error("{place}:{line}: {reason}")]
    Line {
        /// The file.
        place: String,
        /// Counted from 1.
        line: usize,
        /// What is wrong, and what is allowed.
        reason: String,
    },
    /// The instrument or the source is missing.
    #[error("{place}: there is no line '{what} ...' before the first message")]
    Missing {
        /// The file.
        place: String,
        /// The line that is missing.
        what: &'static str,
    },
    /// The simulator's reply differs.
    #[error(
        "{place}:{line}: {expected} is expected as the reply to '{content}', the simulator replies {answered}"
    )]
    Differs {
        /// The file.
        place: String,
        /// The line with the expected reply.
        line: usize,
        /// The message.
        content: String,
        /// What is expected.
        expected: String,
        /// The reply.
        answered: String,
    },
}

impl Golden {
    /// Reads a file.
    ///
    /// # Errors
    /// A file that cannot be read or is not a golden.
    pub fn read(path: &Path) -> Result<Self, GoldenError> {
        let text = std::fs::read_to_string(path).map_err(|cause| GoldenError::Unreadable {
            path: path.to_owned(),
            cause,
        })?;
        Self::parse(&path.display().to_string(), &text)
    }

    /// Parses a text; `place` is its name in errors.
    ///
    /// # Errors
    /// An invalid line, with its number; a missing instrument or source.
    pub fn parse(place: &str, text: &str) -> Result<Self, GoldenError> {
        let mut instrument = None;
        let mut setup = InstrumentSetup::of(Instrument::Source);
        let (mut cites, mut lines): (Vec<String>, Vec<GoldenLine>) = (Vec::new(), Vec::new());
        for (index, line) in text.lines().enumerate() {
            let number = index + 1;
            let wrong = |reason: String| GoldenError::Line {
                place: place.to_owned(),
                line: number,
                reason,
            };
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
            let step = match word {
                ">" => Some(Step::Say(rest.to_owned())),
                "<" => Some(Step::Answer(Expected::Text(rest.to_owned()))),
                "~" => Some(Step::Answer(Expected::Shape(rest.to_owned()))),
                "." => Some(Step::Silence),
                "@" => {
                    let seconds = rest.trim().parse().ok();
                    let at = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
                    let at =
                        at.ok_or_else(|| wrong(format!("'{rest}' is not a time in seconds")))?;
                    Some(Step::At(at))
                }
                _ if !lines.is_empty() => {
                    return Err(wrong(format!("'{word}' is none of > < ~ . @ and #")));
                }
                "instrument" => {
                    let named = Instrument::named(rest.trim());
                    let known = || Instrument::listed(|kind| kind.name, "and");
                    let reason = || format!("'{rest}' is none of {}", known());
                    instrument = Some(named.ok_or_else(|| wrong(reason()))?);
                    None
                }
                "cites" => {
                    cites.push(rest.trim().to_owned());
                    None
                }
                "vendor" => {
                    setup.vendor = Some(rest.trim().to_owned());
                    None
                }
                "slot" => {
                    let (slot, module) =
                        crate::profile::slot(&rest.trim().replacen(' ', "=", 1)).map_err(&wrong)?;
                    if setup.slots[slot - 1].replace(module).is_some() {
                        return Err(wrong(format!(
                            "slot {slot} is given twice; delete one line"
                        )));
                    }
                    None
                }
                "ohms" | "volts" => {
                    let value: f64 = rest
                        .trim()
                        .parse()
                        .map_err(|_| wrong(format!("'{rest}' is no number")))?;
                    match word {
                        "ohms" if value >= 0.0 => setup.ohms = value,
                        "volts" if !value.is_nan() => setup.volts = value,
                        _ => return Err(wrong(format!("{word} cannot be {value}"))),
                    }
                    None
                }
                _ => {
                    return Err(wrong(format!(
                        "'{word}' is none of instrument, cites, slot, vendor, ohms, volts, > < ~ . @ and #"
                    )));
                }
            };
            let Some(step) = step else {
                continue;
            };
            let answers = matches!(step, Step::Answer(_) | Step::Silence);
            let behind = lines.last().map(|line| &line.step);
            if answers && !matches!(behind, Some(Step::Say(_))) {
                return Err(wrong("a reply must follow a message".to_owned()));
            }
            lines.push(GoldenLine { number, step });
        }
        let missing = |what| GoldenError::Missing {
            place: place.to_owned(),
            what,
        };
        setup.instrument = instrument.ok_or_else(|| missing("instrument"))?;
        if cites.is_empty() {
            return Err(missing("cites"));
        }
        Ok(Self {
            setup,
            cites,
            lines,
        })
    }

    /// Plays the conversation to a simulator after power on.
    ///
    /// # Errors
    /// [`GoldenError::Differs`] at the first reply that is not as expected.
    pub fn play(&self, place: &str) -> Result<(), GoldenError> {
        let mut isolated = IsolatedInstrument::new(&self.setup);
        let mut now = Duration::ZERO;
        let (mut content, mut answered) = ("", None);
        for line in &self.lines {
            let (expected, holds) = match &line.step {
                Step::At(at) => {
                    now = now.max(*at);
                    continue;
                }
                Step::Say(message) => {
                    let (reply, busy) = isolated.receive(message, now);
                    now = now.saturating_add(busy);
                    (content, answered) = (message.as_str(), reply);
                    continue;
                }
                Step::Silence => ("nothing".to_owned(), answered.is_none()),
                Step::Answer(expected) => {
                    let holds = answered
                        .as_deref()
                        .is_some_and(|reply| expected.holds(reply));
                    (expected.to_string(), holds)
                }
            };
            if !holds {
                return Err(GoldenError::Differs {
                    place: place.to_owned(),
                    line: line.number,
                    content: content.to_owned(),
                    expected,
                    answered: answered
                        .map_or_else(|| "nothing".to_owned(), |text| format!("'{text}'")),
                });
            }
        }
        Ok(())
    }
}

impl fmt::Display for Expected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(text) => write!(f, "'{text}'"),
            Self::Shape(shape) => write!(f, "the shape of '{shape}'"),
        }
    }
}

impl fmt::Display for Golden {
    /// In the format of the file.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let InstrumentSetup {
            instrument,
            vendor,
            slots,
            ohms,
            volts,
        } = &self.setup;
        writeln!(f, "instrument {}", instrument.name())?;
        for cited in &self.cites {
            writeln!(f, "cites {cited}")?;
        }
        if let Some(vendor) = vendor {
            writeln!(f, "vendor {vendor}")?;
        }
        for (index, module) in slots.iter().enumerate() {
            if let Some(module) = module {
                writeln!(f, "slot {} {module}", index + 1)?;
            }
        }
        if ohms.is_finite() {
            writeln!(f, "ohms {ohms}")?;
        }
        if *volts != 0.0 {
            writeln!(f, "volts {volts}")?;
        }
        for line in &self.lines {
            match &line.step {
                Step::At(at) => writeln!(f, "@ {}", at.as_secs_f64())?,
                Step::Say(message) => writeln!(f, "> {message}")?,
                Step::Answer(Expected::Text(text)) => writeln!(f, "< {text}")?,
                Step::Answer(Expected::Shape(shape)) => writeln!(f, "~ {shape}")?,
                Step::Silence => writeln!(f, ".")?,
            }
        }
        Ok(())
    }
}
