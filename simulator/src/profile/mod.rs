//! Reads a profile: the instruments of a simulated rig. The scene describes the sheet.

#[cfg(test)]
mod tests;

use std::path::Path;
use std::time::Duration;

use keysight_34980a::Module;
use serde::Deserialize;
use toml::de::DeTable;

use crate::circuit::load_network::{LoadNetwork, LoadNetworkError};
use crate::instrument::fault::TimedFault;
use crate::instrument::section::Section;
use crate::instrument::{Instrument, Pace, Profile};

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

/// The keys that belong to no instrument. The others are the sections of [`Instrument`].
#[derive(Deserialize)]
struct Document {
    #[serde(default = "real")]
    time: toml::Spanned<String>,
    speed: Option<toml::Spanned<f64>>,
    #[serde(default = "default_line_hz")]
    line_hz: toml::Spanned<f64>,
    load: Option<toml::Spanned<String>>,
    #[serde(default)]
    fault: Vec<FaultText>,
}

/// Every key of a profile, in the order in which errors name them.
fn keys() -> Vec<&'static str> {
    let mut keys = vec!["time", "speed", "line_hz"];
    keys.extend(sections().map(|section| section.name));
    keys.extend(["load", "fault"]);
    keys
}

fn sections() -> impl Iterator<Item = &'static Section> {
    let all = Instrument::ALL.into_iter();
    all.flat_map(|instrument| instrument.kind().sections)
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
            let (line, column) = survey::line_and_column(text, at.start);
            ProfileError::Text {
                file: file.to_owned(),
                line,
                column,
                what,
            }
        };
        let invalid = |error: toml::de::Error| {
            fault(error.span().unwrap_or(0..0), error.message().to_owned())
        };
        let mut table = DeTable::parse(text).map_err(invalid)?;
        let known = keys();
        let mut given = table.get_ref().keys();
        if let Some(key) = given.find(|key| !known.contains(&key.get_ref().as_ref())) {
            let known: Vec<String> = known.iter().map(|key| format!("`{key}`")).collect();
            let (span, key, known) = (key.span(), key.get_ref(), known.join(", "));
            let what = format!("unknown field `{key}`, expected one of {known}");
            return Err(fault(span, what));
        }
        let given: Vec<_> = sections()
            .filter_map(|section| Some((section, table.get_mut().remove(section.name)?)))
            .collect();
        let document = Document::deserialize(toml::Deserializer::from(table)).map_err(invalid)?;
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
        let line_hz = document.line_hz.into_inner();
        let mut profile = Self::without_sections(pace, line_hz, load, faults);
        for (section, value) in given.clone() {
            (section.read)(&mut profile, value).map_err(|error| fault(error.at, error.what))?;
        }
        for instrument in Instrument::ALL {
            (instrument.kind().check)(&profile).map_err(|wrong| {
                let mut sections = given.iter();
                let section = sections.find(|(section, _)| section.name == wrong.section);
                let keys = section.and_then(|(_, value)| value.get_ref().as_table());
                let key = keys.and_then(|keys| keys.get_key_value(wrong.key));
                fault(key.map_or(0..0, |(key, _)| key.span()), wrong.what)
            })?;
        }
        Ok(profile)
    }

    /// The same instruments with another speed.
    #[must_use]
    pub fn at_pace(mut self, pace: Pace) -> Self {
        self.pace = pace;
        self
    }
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

/// Puts the modules of the option `--slot` into their slots, instead of those there.
///
/// # Errors
/// A slot that is given twice, in words.
pub(crate) fn fill(
    slots: &mut [Option<Module>; 8],
    given: &[(usize, Module)],
) -> Result<(), String> {
    for (index, (number, module)) in given.iter().enumerate() {
        if given[..index].iter().any(|(other, _)| other == number) {
            return Err(format!("--slot gives slot {number} twice; leave one out"));
        }
        slots[number - 1] = Some(*module);
    }
    Ok(())
}
