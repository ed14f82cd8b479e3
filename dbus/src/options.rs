//! Options: the final `a{sv}` argument of methods. Parsed to a struct; unknown keys and invalid values are errors that
//! name the key.

use std::collections::HashMap;

use serde::de::value::MapDeserializer;
use serde::de::{self, DeserializeOwned, IntoDeserializer, Visitor};
use serde::{Deserialize, Serialize, forward_to_deserialize_any};
use zbus::{OwnedVariant, SerializeDict, Str, Type, Variant};

use crate::Fault;

/// Structs whose fields are the options of a method, and a constant with their names.
macro_rules! options {
    ($($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $key:ident: $type:ty,)* })*) => {$(
        $(#[$meta])*
        #[derive(Debug, Clone, Default, PartialEq, Deserialize, SerializeDict, Type)]
        #[zbus(signature = "a{sv}")]
        #[serde(default, deny_unknown_fields)]
        pub struct $name {
            $($(#[$doc])* pub $key: Option<$type>,)*
        }
    )*};
}

/// Options of `StartSession` only.
pub const SESSION_OPTIONS: [&str; 8] = [
    "every_s", "count", "for_s", "baseline", "model", "speed", "step", "note",
];

/// Options of `StartSession` and `RecordBaseline` for a lab's own records: free text, by default as configured.
pub const ABOUT_OPTIONS: [&str; 4] = ["sheet", "foam", "ink", "operator"];

/// Options of `StartSession`, `RecordBaseline` and `PlanWith` for the measuring settings of a session, by default as
/// configured.
pub const MEASURING_OPTIONS: [&str; 10] = [
    "nplc",
    "averages",
    "autozero",
    "settle_ms",
    "channel_delay_ms",
    "reversal",
    "zero_every",
    "ranges",
    "skip",
    "half",
];

options! {
    /// Options of `StartSession` ([`SESSION_OPTIONS`], [`ABOUT_OPTIONS`], [`MEASURING_OPTIONS`]), of `RecordBaseline`
    /// (`frames`, `note`, [`ABOUT_OPTIONS`], [`MEASURING_OPTIONS`]) and of `PlanWith` ([`MEASURING_OPTIONS`]).
    SessionOptions {
        /// Time from the start of one frame to the start of the next, s; 0 without pause.
        every_s: f64,
        /// Frames of a measurement.
        count: u64,
        /// Duration, s.
        for_s: f64,
        /// Id of the baseline; by default the current one.
        baseline: String,
        /// Absolute path of a model file, or `one-step`; by default the configured one.
        model: String,
        /// Speed of a recording: 1 the recorded rate, 10 ten times faster, 0 as fast as possible.
        speed: f64,
        /// Take frames only when `Session1.Step` is called.
        step: bool,
        /// Free text.
        note: String,
        /// Frames of a baseline, 10 by default.
        frames: u64,
        /// The sheet.
        sheet: String,
        /// The foam, with its batch.
        foam: String,
        /// The ink, with its batch.
        ink: String,
        /// Name of the operator.
        operator: String,
        /// Integration time, power-line cycles.
        nplc: f64,
        /// Readings averaged to one.
        averages: u64,
        /// A zero reading after every reading.
        autozero: bool,
        /// Wait after a change of the current, ms.
        settle_ms: f64,
        /// Wait before each scanned channel, ms.
        channel_delay_ms: f64,
        /// Measure every injection with both polarities of the current.
        reversal: bool,
        /// Take a frame at 0 A before the first and after every n-th; 0: never.
        zero_every: u64,
        /// `fixed` or `planned`.
        ranges: String,
        /// Electrodes between the two of a pair; 0: neighbours.
        skip: u64,
        /// Take only one of two reciprocal readings.
        half: bool,
    }

    /// Options of `ListSessions`.
    ListOptions {
        /// Largest number of sessions.
        count: u64,
        /// The list continues after the session with this id.
        before: String,
    }

    /// Options of `Discover`.
    DiscoverOptions {
        /// Search time, s; 3 by default.
        within_s: f64,
        /// Whether to search by mDNS.
        mdns: bool,
        /// Whether to search by VXI-11 broadcast.
        broadcast: bool,
    }

    /// Options of `Transcript`.
    TranscriptOptions {
        /// Number of most recent frames, 1 by default.
        frames: u64,
    }

    /// Options of `Alarms1.Shelve`; the other methods of `Alarms1` have only `comment`.
    ShelveOptions {
        /// Time for which the alarm is shelved, s; if absent, until the alarm ends.
        for_s: f64,
        /// Free text.
        comment: String,
    }

    /// Options of `Session1.OpenStream`.
    StreamOptions {
        /// Frames, true by default.
        frames: bool,
        /// Maps, true by default.
        maps: bool,
        /// Pressure, false by default.
        pressure: bool,
        /// Records of the quality of maps, of the result of the tracked baseline, and of quantities.
        quality: bool,
        /// Records of the load after every injection, false by default.
        injections: bool,
        /// Records of the standard deviation of maps, false by default.
        deviations: bool,
        /// Records held for a slow reader, 64 by default.
        ring: u64,
    }
}

/// Named values (`a{sv}`) of any type, before they are parsed.
///
/// ```
/// let sent = dbus::Options::new().with("every_s", 1_u64).with("note", "first");
/// let options: dbus::SessionOptions = sent.read()?;
/// assert_eq!((options.every_s, options.note.as_deref()), (Some(1.0), Some("first")));
/// let error = dbus::Options::new().with("averages", "four").read::<dbus::SessionOptions>().unwrap_err();
/// assert_eq!(error.to_string(), "option 'averages' must be a whole number, 0 or more (t)");
/// assert!(sent.only(&["every_s"]).unwrap_err().to_string().contains("note"));
/// # Ok::<(), dbus::InvalidOption>(())
/// ```
#[derive(Debug, Default, Serialize, Deserialize, Type)]
#[serde(transparent)]
pub struct Options(pub HashMap<String, OwnedVariant>);

/// Why options are invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct InvalidOption {
    /// The option with the invalid value; `None` for an unknown option.
    pub key: Option<String>,
    /// Message with the option, the value, and the allowed values.
    pub text: String,
}

impl From<InvalidOption> for Fault {
    fn from(error: InvalidOption) -> Self {
        Self::InvalidOption(error.text)
    }
}

impl de::Error for InvalidOption {
    fn custom<T: std::fmt::Display>(text: T) -> Self {
        Self {
            key: None,
            text: text.to_string(),
        }
    }

    fn unknown_field(key: &str, known: &'static [&'static str]) -> Self {
        unknown(key, known)
    }
}

fn unknown(key: &str, known: &[&str]) -> InvalidOption {
    let known = match known {
        [] => "none".to_owned(),
        known => known.join(", "),
    };
    de::Error::custom(format!("there is no option '{key}'; known are: {known}"))
}

impl Options {
    /// No options.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a value.
    #[must_use]
    pub fn with(mut self, key: &str, value: impl Into<Plain>) -> Self {
        self.0.insert(key.to_owned(), value.into().0);
        self
    }

    /// Rejects keys other than these.
    ///
    /// # Errors
    /// The first unknown key, with the known ones.
    pub fn only(&self, known: &[&str]) -> Result<(), InvalidOption> {
        match self.0.keys().find(|key| !known.contains(&key.as_str())) {
            None => Ok(()),
            Some(key) => Err(unknown(key, known)),
        }
    }

    /// Parses the options to a struct. A numeric field accepts every numeric type, a text field also an object path.
    ///
    /// # Errors
    /// A key that the struct does not have, a value of another type, a number that is not finite, or a negative number
    /// where none is allowed.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, InvalidOption> {
        let values = self
            .0
            .iter()
            .map(|(key, value)| (key.as_str(), Value { key, value }));
        T::deserialize(MapDeserializer::new(values))
    }

    /// The value of a numeric option; `None` if it is missing or not a number.
    pub fn number(&self, key: &str) -> Option<f64> {
        let (key, value) = self.0.get_key_value(key)?;
        Value { key, value }.number().ok()
    }

    /// The value of a text option; `None` if it is missing or not a text.
    pub fn text(&self, key: &str) -> Option<&str> {
        match &**self.0.get(key)? {
            Variant::Str(text) => Some(text),
            _ => None,
        }
    }
}

/// One value, and its key for error messages.
#[derive(Clone, Copy)]
struct Value<'a> {
    key: &'a str,
    value: &'a Variant<'a>,
}

impl Value<'_> {
    fn invalid(self, text: &str) -> InvalidOption {
        InvalidOption {
            key: Some(self.key.to_owned()),
            text: format!("option '{}' {text}", self.key),
        }
    }

    fn number(self) -> Result<f64, InvalidOption> {
        let number = match *self.value {
            Variant::F64(number) => number,
            Variant::U64(number) => number as f64,
            Variant::I64(number) => number as f64,
            Variant::U8(number) => number.into(),
            Variant::U16(number) => number.into(),
            Variant::I16(number) => number.into(),
            Variant::U32(number) => number.into(),
            Variant::I32(number) => number.into(),
            _ => return Err(self.invalid("must be a number (d)")),
        };
        match number.is_finite() {
            true => Ok(number),
            false => Err(self.invalid(&format!("is {number}; it must be a finite number"))),
        }
    }

    fn whole(self) -> Result<u64, InvalidOption> {
        let whole = match *self.value {
            Variant::U64(number) => Some(number),
            Variant::I64(number) => u64::try_from(number).ok(),
            Variant::U8(number) => Some(number.into()),
            Variant::U16(number) => Some(number.into()),
            Variant::I16(number) => u64::try_from(number).ok(),
            Variant::U32(number) => Some(number.into()),
            Variant::I32(number) => u64::try_from(number).ok(),
            _ => None,
        };
        whole.ok_or_else(|| self.invalid("must be a whole number, 0 or more (t)"))
    }
}

impl<'de> IntoDeserializer<'de, InvalidOption> for Value<'_> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

impl<'de> de::Deserializer<'de> for Value<'_> {
    type Error = InvalidOption;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, InvalidOption> {
        match self.value {
            Variant::Bool(flag) => visitor.visit_bool(*flag),
            Variant::Str(text) => visitor.visit_str(text),
            Variant::ObjectPath(path) => visitor.visit_str(path),
            _ => match self.whole() {
                Ok(whole) => visitor.visit_u64(whole),
                Err(_) => visitor.visit_f64(self.number()?),
            },
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, InvalidOption> {
        visitor.visit_some(self)
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, InvalidOption> {
        visitor.visit_f64(self.number()?)
    }

    fn deserialize_u64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, InvalidOption> {
        visitor.visit_u64(self.whole()?)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, InvalidOption> {
        match self.value {
            Variant::Bool(flag) => visitor.visit_bool(*flag),
            _ => Err(self.invalid("must be true or false (b)")),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, InvalidOption> {
        match self.value {
            Variant::Str(text) => visitor.visit_str(text),
            Variant::ObjectPath(path) => visitor.visit_str(path),
            _ => Err(self.invalid("must be a text (s)")),
        }
    }

    forward_to_deserialize_any! {
        i8 i16 i32 i64 i128 u8 u16 u32 u128 f32 char str bytes byte_buf unit unit_struct newtype_struct seq tuple
        tuple_struct map struct enum identifier ignored_any
    }
}

/// A value whose conversion to a variant cannot fail.
#[derive(Debug)]
pub struct Plain(OwnedVariant);

macro_rules! plain {
    ($($from:ty),*) => {$(
        impl From<$from> for Plain {
            fn from(value: $from) -> Self {
                Self(OwnedVariant::from(value))
            }
        }
    )*};
}
plain!(bool, u32, u64, i64, f64);

impl From<&str> for Plain {
    fn from(value: &str) -> Self {
        Self(OwnedVariant::from(Str::from(value.to_owned())))
    }
}

impl From<String> for Plain {
    fn from(value: String) -> Self {
        Self(OwnedVariant::from(Str::from(value)))
    }
}

#[cfg(test)]
mod tests {
    use crate::options::*;

    #[test]
    fn every_listed_option_is_a_field_and_every_field_is_listed() {
        let listed = [
            &SESSION_OPTIONS[..],
            &["frames"],
            &ABOUT_OPTIONS,
            &MEASURING_OPTIONS,
        ]
        .concat();
        let unknown = Options::new().with("no_option", true);
        let error = unknown.read::<SessionOptions>().unwrap_err();
        assert_eq!(
            error.text,
            format!(
                "there is no option 'no_option'; known are: {}",
                listed.join(", ")
            )
        );
    }

    #[test]
    fn a_wrong_type_names_the_option_and_the_type() {
        for (options, wanted) in [
            (
                Options::new().with("step", 1_u64),
                "option 'step' must be true or false (b)",
            ),
            (
                Options::new().with("note", true),
                "option 'note' must be a text (s)",
            ),
            (
                Options::new().with("count", -1_i64),
                "option 'count' must be a whole number, 0 or more (t)",
            ),
            (
                Options::new().with("every_s", "x"),
                "option 'every_s' must be a number (d)",
            ),
            (
                Options::new().with("every_s", f64::NAN),
                "option 'every_s' is NaN; it must be a finite number",
            ),
        ] {
            let error = options.read::<SessionOptions>().unwrap_err();
            assert_eq!(error.text, wanted);
            assert!(error.key.is_some());
        }
    }
}
