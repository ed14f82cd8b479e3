//! Allowed values of options and arguments on D-Bus. They are checked only here, before anything is calculated with
//! them.

use dbus::{Fault, Options};
use serde::de::DeserializeOwned;
use survey::Bounds::{self, Above, Within};

use config::numbers::{allowed, too_long};

/// Number of frames of a baseline, which are all kept in memory until they are averaged.
pub(crate) const BASELINE_FRAMES: Bounds = Within(1.0, 1000.0);
/// Duration of a discovery, s.
pub(crate) const WITHIN_S: Bounds = Within(0.0, 60.0);
/// Records held for a slow reader of a stream.
pub(crate) const RING: Bounds = Within(1.0, 4096.0);
/// Frames of a transcript; larger numbers return all.
pub(crate) const TRANSCRIPT_FRAMES: Bounds = Within(0.0, 1e15);
/// Sessions of a list; larger numbers return all.
pub(crate) const LISTED: Bounds = Within(0.0, u64::MAX as f64);
/// A load on the simulated sheet, m.
pub(crate) const PLACE_M: Bounds = Within(-10.0, 10.0);
pub(crate) const SIZE_M: Bounds = Above(0.0, 10.0);
pub(crate) const LOSS: Bounds = Within(0.0, 1.0);

/// The bounds of an option of `StartSession`, `RecordBaseline` and `PlanWith`: those of the configuration key.
pub(crate) fn session_option(option: &str) -> Option<Bounds> {
    match option {
        "frames" => Some(BASELINE_FRAMES),
        // 0 means never; in a file the key is left out instead
        "zero_every" => Some(Within(0.0, 1e9)),
        _ => ["survey", "schedule", "recording"]
            .iter()
            .find_map(|section| allowed(&format!("{section}.{option}"))),
    }
}

/// Free-text options.
const FREE_WORDS: [&str; 6] = ["note", "sheet", "foam", "ink", "operator", "comment"];

/// Reads the options of a method; `bounds` returns the allowed values of a numeric option.
///
/// # Errors
/// [`Fault::InvalidOption`] with the name, the value and what is allowed.
pub(crate) fn read<T: DeserializeOwned>(
    options: &Options,
    bounds: impl Fn(&str) -> Option<Bounds>,
) -> Result<T, Fault> {
    let read = options.read().map_err(|mut error| {
        if let Some(bounds) = error.key.as_deref().and_then(&bounds) {
            error.text = format!("{}, {bounds}", error.text);
        }
        error
    })?;
    for key in options.0.keys() {
        if let Some((value, bounds)) = options.number(key).zip(bounds(key)) {
            checked(&format!("option '{key}'"), value, bounds)?;
        }
    }
    for key in FREE_WORDS {
        if let Some(why) = options.text(key).and_then(too_long) {
            return Err(Fault::InvalidOption(format!("option '{key}' {why}")));
        }
    }
    Ok(read)
}

/// A numeric argument.
///
/// # Errors
/// [`Fault::InvalidOption`] with the name, the value and what is allowed.
pub(crate) fn checked(what: &str, value: f64, bounds: Bounds) -> Result<f64, Fault> {
    bounds
        .check(value)
        .map_err(|error| Fault::InvalidOption(format!("{what}: {error}")))
}

#[cfg(test)]
mod tests {
    use config::numbers::LONGEST_TEXT;

    use crate::session::option_values::*;

    #[test]
    fn an_option_is_refused_with_name_value_and_range() {
        for value in [f64::INFINITY, f64::NEG_INFINITY, f64::NAN, 1e308, -1.0] {
            let options = Options::new().with("settle_ms", value);
            let refused = read::<dbus::SessionOptions>(&options, session_option);
            let text = refused.unwrap_err().to_string();
            let value = if value == 1e308 {
                "1e308".to_owned()
            } else {
                value.to_string()
            };
            assert!(
                text.contains("'settle_ms'")
                    && text.contains(&value)
                    && text.contains("from 0 to 60000"),
                "{text}"
            );
        }
        let huge = Options::new().with("averages", u64::MAX);
        let error = read::<dbus::SessionOptions>(&huge, session_option).unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains("'averages'") && text.contains("from 1 to 1000"),
            "{text}"
        );
        let long = Options::new().with("note", "n".repeat(LONGEST_TEXT + 1));
        let error = read::<dbus::SessionOptions>(&long, session_option).unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains("'note' has 4097 bytes") && text.contains("4096"),
            "{text}"
        );
        let longest = Options::new().with("note", "n".repeat(LONGEST_TEXT));
        assert!(read::<dbus::SessionOptions>(&longest, session_option).is_ok());
    }
}
