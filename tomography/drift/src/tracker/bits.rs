//! Serializes numbers of a stored state as the hexadecimal digits of their bits, so that any text format restores them
//! exactly.

use serde::{Deserialize, Deserializer, Serializer, de::Error};

const DIGITS: usize = 16;

/// Writes the numbers.
///
/// # Errors
/// Those of the serializer.
pub fn serialize<S: Serializer>(values: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
    let mut text = String::with_capacity(DIGITS * values.len());
    for value in values {
        text += &format!("{:016x}", value.to_bits());
    }
    serializer.serialize_str(&text)
}

/// Reads the numbers.
///
/// # Errors
/// The text is not a sequence of such numbers.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let text = String::deserialize(deserializer)?;
    if !text.is_ascii() || text.len() % DIGITS != 0 {
        return Err(D::Error::custom(
            "the length is not a multiple of 16 hexadecimal digits",
        ));
    }
    (0..text.len() / DIGITS)
        .map(|k| {
            let digits = &text[DIGITS * k..DIGITS * (k + 1)];
            u64::from_str_radix(digits, 16)
                .map(f64::from_bits)
                .map_err(D::Error::custom)
        })
        .collect()
}

/// One number.
pub mod number {
    use serde::{Deserializer, Serializer, de::Error};

    /// Writes the number.
    ///
    /// # Errors
    /// Those of the serializer.
    pub fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        super::serialize(std::slice::from_ref(value), serializer)
    }

    /// Reads the number.
    ///
    /// # Errors
    /// The text has another length or contains other characters.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        match super::deserialize(deserializer)?.as_slice() {
            [value] => Ok(*value),
            _ => Err(D::Error::custom("one number has 16 hexadecimal digits")),
        }
    }
}

/// One optional number.
pub mod option {
    use serde::{Deserializer, Serializer, de::Error};

    /// Writes the number, if any.
    ///
    /// # Errors
    /// Those of the serializer.
    pub fn serialize<S: Serializer>(value: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
        super::serialize(value.as_slice(), serializer)
    }

    /// Reads the number, if any.
    ///
    /// # Errors
    /// The text has another length or contains other characters.
    pub fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<f64>, D::Error> {
        match super::deserialize(deserializer)?.as_slice() {
            [] => Ok(None),
            [value] => Ok(Some(*value)),
            _ => Err(D::Error::custom("more than one number")),
        }
    }
}
