//! The last argument of every method that may grow: named, typed, and refused by name.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};
use zbus::{OwnedVariant, Str, Type, Variant};

use crate::Fault;

/// Named values (`a{sv}`).
///
/// ```
/// let options = dbus::Options::new().with("every_s", 0.5).with("note", "first");
/// assert_eq!(options.number("every_s")?, Some(0.5));
/// assert!(options.whole("note").is_err());
/// assert!(options.only(&["every_s"]).unwrap_err().to_string().contains("note"));
/// let told = dbus::Options::new().with_texts("troubles", &["one".to_owned()]);
/// assert_eq!(told.texts("troubles")?, Some(vec!["one"]));
/// # Ok::<(), dbus::Fault>(())
/// ```
#[derive(Debug, Default, Serialize, Deserialize, Type)]
#[serde(transparent)]
pub struct Options(pub HashMap<String, OwnedVariant>);

impl Options {
    /// None.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a value.
    #[must_use]
    pub fn with(mut self, key: &str, value: impl Into<Plain>) -> Self {
        self.0.insert(key.to_owned(), value.into().0);
        self
    }

    /// Adds a value if there is one.
    #[must_use]
    pub fn with_some(self, key: &str, value: Option<impl Into<Plain>>) -> Self {
        match value {
            Some(value) => self.with(key, value),
            None => self,
        }
    }

    /// Adds texts.
    #[must_use]
    pub fn with_texts(mut self, key: &str, texts: &[String]) -> Self {
        let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
        // refused are only descriptors, and texts are none
        if let Ok(value) = OwnedVariant::try_from(Variant::from(texts)) {
            self.0.insert(key.to_owned(), value);
        }
        self
    }

    /// Refuses keys other than these.
    ///
    /// # Errors
    /// [`Fault::InvalidOption`] naming the key and those that exist.
    pub fn only(&self, known: &[&str]) -> Result<(), Fault> {
        match self.0.keys().find(|key| !known.contains(&key.as_str())) {
            None => Ok(()),
            Some(key) => Err(Fault::InvalidOption(format!(
                "there is no option '{key}'; known are: {}",
                if known.is_empty() {
                    "none".to_owned()
                } else {
                    known.join(", ")
                }
            ))),
        }
    }

    /// A number (`d`, or any integer type).
    ///
    /// # Errors
    /// [`Fault::InvalidOption`] for another type, or a number that is not finite.
    pub fn number(&self, key: &str) -> Result<Option<f64>, Fault> {
        let Some(value) = self.0.get(key) else {
            return Ok(None);
        };
        let number = match &**value {
            Variant::F64(number) => *number,
            Variant::U8(number) => f64::from(*number),
            Variant::U16(number) => f64::from(*number),
            Variant::I16(number) => f64::from(*number),
            Variant::U32(number) => f64::from(*number),
            Variant::I32(number) => f64::from(*number),
            Variant::U64(number) => *number as f64,
            Variant::I64(number) => *number as f64,
            _ => return Err(wrong_type(key, "a number (d)")),
        };
        if !number.is_finite() {
            return Err(Fault::InvalidOption(format!(
                "option '{key}' is {number}; it must be a finite number"
            )));
        }
        Ok(Some(number))
    }

    /// A whole number that is not negative (any integer type).
    ///
    /// # Errors
    /// [`Fault::InvalidOption`] for another type or a negative number.
    pub fn whole(&self, key: &str) -> Result<Option<u64>, Fault> {
        let Some(value) = self.0.get(key) else {
            return Ok(None);
        };
        let whole = match &**value {
            Variant::U8(number) => Some(u64::from(*number)),
            Variant::U16(number) => Some(u64::from(*number)),
            Variant::U32(number) => Some(u64::from(*number)),
            Variant::U64(number) => Some(*number),
            Variant::I16(number) => u64::try_from(*number).ok(),
            Variant::I32(number) => u64::try_from(*number).ok(),
            Variant::I64(number) => u64::try_from(*number).ok(),
            _ => None,
        };
        whole
            .map(Some)
            .ok_or_else(|| wrong_type(key, "a whole number, 0 or more (t)"))
    }

    /// A text (`s`, or an object path).
    ///
    /// # Errors
    /// [`Fault::InvalidOption`] for another type.
    pub fn text(&self, key: &str) -> Result<Option<&str>, Fault> {
        match self.0.get(key).map(|value| &**value) {
            None => Ok(None),
            Some(Variant::Str(text)) => Ok(Some(text.as_str())),
            Some(Variant::ObjectPath(path)) => Ok(Some(path.as_str())),
            Some(_) => Err(wrong_type(key, "a text (s)")),
        }
    }

    /// Texts (`as`).
    ///
    /// # Errors
    /// [`Fault::InvalidOption`] for another type.
    pub fn texts(&self, key: &str) -> Result<Option<Vec<&str>>, Fault> {
        let Some(value) = self.0.get(key) else {
            return Ok(None);
        };
        let wrong = || wrong_type(key, "texts (as)");
        let Variant::Array(array) = &**value else {
            return Err(wrong());
        };
        let each = array.iter().map(|text| match text {
            Variant::Str(text) => Ok(text.as_str()),
            _ => Err(wrong()),
        });
        each.collect::<Result<_, _>>().map(Some)
    }

    /// A truth value (`b`).
    ///
    /// # Errors
    /// [`Fault::InvalidOption`] for another type.
    pub fn flag(&self, key: &str) -> Result<Option<bool>, Fault> {
        match self.0.get(key).map(|value| &**value) {
            None => Ok(None),
            Some(Variant::Bool(flag)) => Ok(Some(*flag)),
            Some(_) => Err(wrong_type(key, "true or false (b)")),
        }
    }
}

fn wrong_type(key: &str, wanted: &str) -> Fault {
    Fault::InvalidOption(format!("option '{key}' must be {wanted}"))
}

/// A value that cannot fail to become a variant.
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
