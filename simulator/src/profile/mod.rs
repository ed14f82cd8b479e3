//! A profile: the instruments of a simulated rig. The scene describes the sheet.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use keysight_34980a::Module;
use serde::{Deserialize, Serialize};

use crate::circuit::load_network::{LoadNetwork, LoadNetworkError};
use crate::fault::TimedFault;

/// Speed of the instruments' time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pace {
    /// Real time.
    Real,
    /// Faster (above 1) or slower (below) by this factor.
    Scaled(f64),
    /// Replies are immediate; the instruments' clock still advances by the time they would have needed.
    Instant,
}

/// The instruments of a simulated rig.
///
/// ```
/// let profile = simulator::Profile::parse("mine.toml", "time = \"instant\"\n[slots]\n1 = \"34924A\"\n")?;
/// assert_eq!(profile.pace, simulator::Pace::Instant);
/// let refusal = simulator::Profile::parse("mine.toml", "time = \"instant\"\n[slotz]\n").unwrap_err();
/// assert!(refusal.to_string().starts_with("mine.toml:2:2: "), "{refusal}");
/// # Ok::<(), simulator::ProfileError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Speed of the instruments' time.
    pub pace: Pace,
    /// Mains frequency, Hz: 50 or 60.
    pub line_hz: f64,
    /// The current source.
    pub source: Source,
    /// The switch and voltmeter.
    pub mainframe: Mainframe,
    /// The modules in slots 1 to 8.
    pub slots: [Option<Module>; 8],
    /// The multiplexer board, if there is one.
    pub board: Option<Board>,
    /// The load on the terminals.
    pub load: LoadNetwork,
    /// Faults with their times.
    pub faults: Vec<TimedFault>,
}

/// Treatment of a second client of the 6221 while the first is connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SecondClient {
    /// Accepted, but its messages are only received after the first has disconnected.
    #[default]
    Held,
    /// Disconnected immediately.
    Refused,
    /// Served like the first.
    Served,
}

/// Settings of the simulated 6221.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Source {
    /// Serial number in `*IDN?`.
    pub serial: String,
    /// Time a message takes, ms.
    pub command_ms: f64,
    /// Treatment of a second TCP client.
    pub second_client: SecondClient,
    /// How long the only connection stays occupied after a client vanished without closing it, s.
    pub slot_hold_s: f64,
}

impl Default for Source {
    fn default() -> Self {
        Self {
            serial: "1234567".to_owned(),
            command_ms: 5.0,
            second_client: SecondClient::default(),
            slot_hold_s: 0.0,
        }
    }
}

/// Settings of the simulated 34980A.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mainframe {
    /// Serial number in `*IDN?`.
    pub serial: String,
    /// Time a message takes, ms.
    pub command_ms: f64,
    /// Initial time of its clock, seconds since 1970-01-01. Default: the year 2000, or the present time if the program
    /// serves it.
    pub clock_unix_s: Option<u32>,
    /// Which headers it has for autozero and input impedance.
    pub headers: Headers,
}

/// Variants of the headers for autozero and input impedance; the headers of the other variant are undefined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
pub enum Headers {
    /// `VOLT:DC:ZERO:AUTO` and `VOLT:DC:IMP:AUTO`, as documented in its help.
    #[default]
    #[serde(rename = "34980A")]
    Documented,
    /// `ZERO:AUTO` and `INP:IMP:AUTO`, as documented in the 34970A's manual.
    #[serde(rename = "34970A")]
    Of34970A,
}

impl From<Headers> for keysight_34980a::HeaderForm {
    fn from(headers: Headers) -> Self {
        match headers {
            Headers::Documented => Self::Documented,
            Headers::Of34970A => Self::Of34970A,
        }
    }
}

impl Default for Mainframe {
    fn default() -> Self {
        Self {
            serial: "MY44001234".to_owned(),
            command_ms: 2.0,
            clock_unix_s: None,
            headers: Headers::default(),
        }
    }
}

/// Settings of the simulated multiplexer board.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Board {
    /// Serial number in `*IDN?`.
    pub serial: String,
    /// Time a message takes, ms.
    pub command_ms: f64,
}

impl Default for Board {
    fn default() -> Self {
        Self {
            serial: "0001".to_owned(),
            command_ms: 1.5,
        }
    }
}

/// Errors of profiles.
#[derive(Debug, thiserror::Error)]
pub enum ProfileError {
    /// The file cannot be read.
    #[error("profile {path} cannot be read; shipped ones are {}", shipped_names())]
    Unreadable {
        /// Its path, or the unknown name.
        path: String,
        /// The operating system's error.
        #[source]
        cause: std::io::Error,
    },
    /// The text is not a valid profile.
    #[error("{file}:{line}:{column}: {what}")]
    Text {
        /// File.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What is wrong.
        what: String,
    },
}

/// Names and texts of the shipped profiles.
const SHIPPED: [(&str, &str); 7] = [
    (
        "pairs-34924a",
        include_str!("../../profiles/pairs-34924a.toml"),
    ),
    (
        "pairs-34922a",
        include_str!("../../profiles/pairs-34922a.toml"),
    ),
    (
        "matrix-34932a",
        include_str!("../../profiles/matrix-34932a.toml"),
    ),
    (
        "matrix-34934a",
        include_str!("../../profiles/matrix-34934a.toml"),
    ),
    (
        "fast-34925a",
        include_str!("../../profiles/fast-34925a.toml"),
    ),
    ("gpio-board", include_str!("../../profiles/gpio-board.toml")),
    ("showcase", include_str!("../../profiles/showcase.toml")),
];

fn shipped_names() -> String {
    SHIPPED.map(|(name, _)| name).join(", ")
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    #[serde(default = "real")]
    time: toml::Spanned<String>,
    speed: Option<toml::Spanned<f64>>,
    #[serde(default = "default_line_hz")]
    line_hz: toml::Spanned<f64>,
    #[serde(default)]
    source: Source,
    #[serde(default)]
    mainframe: Mainframe,
    #[serde(default)]
    slots: BTreeMap<toml::Spanned<String>, toml::Spanned<String>>,
    board: Option<Board>,
    load: Option<toml::Spanned<String>>,
    #[serde(default)]
    fault: Vec<FaultText>,
}

/// An entry of the time line.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FaultText {
    at_s: toml::Spanned<f64>,
    for_s: Option<toml::Spanned<f64>>,
    what: toml::Spanned<String>,
}

fn real() -> toml::Spanned<String> {
    toml::Spanned::new(0..0, "real".to_owned())
}

fn default_line_hz() -> toml::Spanned<f64> {
    toml::Spanned::new(0..0, 50.0)
}

impl Default for Profile {
    /// The first shipped profile: pairs on a 34924A, in real time.
    fn default() -> Self {
        let (name, text) = SHIPPED[0];
        Self::parse(name, text).expect("a test reads every shipped profile")
    }
}

impl Profile {
    /// Names of the shipped profiles.
    pub fn names() -> impl Iterator<Item = &'static str> {
        SHIPPED.into_iter().map(|(name, _)| name)
    }

    /// Description of a shipped profile.
    pub(crate) fn what(name: &str) -> &'static str {
        let text = SHIPPED.into_iter().find(|(known, _)| *known == name);
        text.map_or("", |(_, text)| first_comment(text))
    }

    /// A shipped profile.
    pub fn shipped(name: &str) -> Option<Self> {
        let (name, text) = SHIPPED.into_iter().find(|(known, _)| *known == name)?;
        Some(Self::parse(name, text).expect("a test reads every shipped profile"))
    }

    /// A shipped profile by its name, otherwise a file by its path.
    ///
    /// # Errors
    /// A file that cannot be read, or an error in its text with line and column.
    pub fn load(name_or_path: &str) -> Result<Self, ProfileError> {
        if let Some(shipped) = Self::shipped(name_or_path) {
            return Ok(shipped);
        }
        let text = std::fs::read_to_string(Path::new(name_or_path)).map_err(|cause| {
            ProfileError::Unreadable {
                path: name_or_path.to_owned(),
                cause,
            }
        })?;
        Self::parse(name_or_path, &text)
    }

    /// Reads a profile; `file` is for messages.
    ///
    /// # Errors
    /// What is wrong, with line and column.
    pub fn parse(file: &str, text: &str) -> Result<Self, ProfileError> {
        let fault = |at: std::ops::Range<usize>, what: String| {
            let before = &text[..at.start.min(text.len())];
            let line_start = before.rfind('\n').map_or(0, |end| end + 1);
            ProfileError::Text {
                file: file.to_owned(),
                line: before.matches('\n').count() + 1,
                column: before[line_start..].chars().count() + 1,
                what,
            }
        };
        let document: Document = toml::from_str(text)
            .map_err(|error| fault(error.span().unwrap_or(0..0), error.message().to_owned()))?;
        let speed = match &document.speed {
            Some(speed) if !(*speed.get_ref() > 0.0 && speed.get_ref().is_finite()) => {
                return Err(fault(
                    speed.span(),
                    "speed must be a positive number".to_owned(),
                ));
            }
            Some(speed) => Some(*speed.get_ref()),
            None => None,
        };
        let pace = match (document.time.get_ref().as_str(), speed) {
            ("real", None) => Pace::Real,
            ("instant", None) => Pace::Instant,
            ("scaled", Some(speed)) => Pace::Scaled(speed),
            ("scaled", None) => {
                return Err(fault(
                    document.time.span(),
                    "scaled time needs a 'speed'".to_owned(),
                ));
            }
            ("real" | "instant", Some(_)) => {
                return Err(fault(
                    document.time.span(),
                    "'speed' goes with time = \"scaled\" only".to_owned(),
                ));
            }
            (other, _) => {
                return Err(fault(
                    document.time.span(),
                    format!("unknown time '{other}'; it is real, scaled or instant"),
                ));
            }
        };
        if ![50.0, 60.0].contains(document.line_hz.get_ref()) {
            return Err(fault(
                document.line_hz.span(),
                "line_hz is 50 or 60".to_owned(),
            ));
        }
        for (section, command_ms) in [
            ("source", document.source.command_ms),
            ("mainframe", document.mainframe.command_ms),
            (
                "board",
                document
                    .board
                    .as_ref()
                    .map_or(0.0, |board| board.command_ms),
            ),
        ] {
            // Well within the range of a Duration.
            if !(0.0..=60_000.0).contains(&command_ms) {
                let at = text.find("command_ms").unwrap_or(0);
                return Err(fault(
                    at..at,
                    format!("command_ms of [{section}] is 0 to 60000"),
                ));
            }
        }
        let hold = document.source.slot_hold_s;
        if !(0.0..=3600.0).contains(&hold) {
            let at = text.find("slot_hold_s").unwrap_or(0);
            return Err(fault(at..at, "slot_hold_s is 0 to 3600".to_owned()));
        }
        let moment = |seconds: &toml::Spanned<f64>| {
            Duration::try_from_secs_f64(*seconds.get_ref()).map_err(|_| {
                let wrong = format!("{} is not a time in seconds", seconds.get_ref());
                fault(seconds.span(), wrong)
            })
        };
        let load = match &document.load {
            Some(words) => words
                .get_ref()
                .parse()
                .map_err(|refusal: LoadNetworkError| fault(words.span(), refusal.to_string()))?,
            None => LoadNetwork::default(),
        };
        let mut faults = Vec::new();
        for entry in &document.fault {
            let at = moment(&entry.at_s)?;
            let lasts = entry.for_s.as_ref().map(&moment).transpose()?;
            let read = TimedFault::read(at, lasts, entry.what.get_ref());
            faults.extend(read.map_err(|refusal| fault(entry.what.span(), refusal.to_string()))?);
        }
        let mut slots = [None; 8];
        for (number, module) in &document.slots {
            let slot: usize = number
                .get_ref()
                .parse()
                .ok()
                .filter(|slot| (1..=8).contains(slot))
                .ok_or_else(|| fault(number.span(), "slots are 1 to 8".to_owned()))?;
            let module =
                module
                    .get_ref()
                    .parse()
                    .map_err(|error: keysight_34980a::ModuleError| {
                        fault(module.span(), error.to_string())
                    })?;
            slots[slot - 1] = Some(module);
        }
        Ok(Self {
            pace,
            line_hz: document.line_hz.into_inner(),
            source: document.source,
            mainframe: document.mainframe,
            slots,
            board: document.board,
            load,
            faults,
        })
    }

    /// The same instruments with another speed.
    #[must_use]
    pub fn at_pace(mut self, pace: Pace) -> Self {
        self.pace = pace;
        self
    }
}

/// Milliseconds of a profile as a duration; validated when the profile was read.
pub(crate) fn milliseconds(value: f64) -> Duration {
    Duration::try_from_secs_f64(value * 1e-3).unwrap_or_default()
}

/// The first line of a text, if it is a comment.
fn first_comment(text: &str) -> &str {
    let first = text.lines().next().unwrap_or_default();
    first.strip_prefix('#').unwrap_or_default().trim()
}

/// A slot and its module in the form of the command line and goldens: `1=34924A`.
///
/// # Errors
/// A text of another form, in words.
pub(crate) fn slot(text: &str) -> Result<(usize, Module), String> {
    let (number, module) = text
        .split_once('=')
        .ok_or("a slot is given as N=MODEL, such as 1=34924A")?;
    let number: usize = number
        .trim()
        .parse()
        .ok()
        .filter(|number| (1..=8).contains(number))
        .ok_or_else(|| format!("there is no slot '{number}', slots are 1 to 8"))?;
    let module = module
        .parse()
        .map_err(|fault: keysight_34980a::ModuleError| fault.to_string())?;
    Ok((number, module))
}
