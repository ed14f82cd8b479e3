//! The sections of a profile that belong to an instrument: how they are read and checked.

use std::ops::Range;
use std::time::Duration;

use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeValue, ValueDeserializer};

use crate::instrument::Profile;

/// A section of a profile.
pub(crate) struct Section {
    /// Its name.
    pub(crate) name: &'static str,
    /// Enters it into the profile.
    pub(crate) read: fn(&mut Profile, Spanned<DeValue<'_>>) -> Result<(), SectionError>,
}

/// Text that is not a valid section.
pub(crate) struct SectionError {
    /// Its place in the text of the profile.
    pub(crate) at: Range<usize>,
    /// What is wrong.
    pub(crate) what: String,
}

/// The settings of a section.
pub(super) fn settings<'de, T: Deserialize<'de>>(
    value: Spanned<DeValue<'de>>,
) -> Result<T, SectionError> {
    let at = value.span();
    T::deserialize(ValueDeserializer::from(value)).map_err(|error| SectionError {
        at: error.span().unwrap_or(at),
        what: error.message().to_owned(),
    })
}

/// A number outside its range.
pub(crate) struct OutOfRange {
    /// The section of its key.
    pub(crate) section: &'static str,
    /// Its key.
    pub(crate) key: &'static str,
    /// The permitted range.
    pub(crate) what: String,
}

/// Checks the time that a message takes.
pub(super) fn check_command_ms(section: &'static str, command_ms: f64) -> Result<(), OutOfRange> {
    // Well within the range of a Duration.
    match (0.0..=60_000.0).contains(&command_ms) {
        true => Ok(()),
        false => Err(OutOfRange {
            section,
            key: "command_ms",
            what: format!("command_ms of [{section}] is 0 to 60000"),
        }),
    }
}

/// Milliseconds of a profile as a duration; validated when the profile was read.
pub(super) fn milliseconds(value: f64) -> Duration {
    Duration::try_from_secs_f64(value * 1e-3).unwrap_or_default()
}
