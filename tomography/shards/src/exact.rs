//! Results as JSON that are read back bit for bit. The JSON parser of this workspace rounds some numbers in their last
//! digit, so a number with a fraction is written as `{"f64": "0.1"}` and read by the parser of Rust, which is exact.

use serde_json::{Map, Value};

const KEY: &str = "f64";

/// The value with each number with a fraction as an object, which [`decode`] reads back bit for bit.
pub fn encode(value: Value) -> Value {
    match value {
        Value::Number(number) if number.is_f64() => {
            let mut exact = Map::new();
            exact.insert(KEY.to_owned(), number.to_string().into());
            Value::Object(exact)
        }
        Value::Array(values) => values.into_iter().map(encode).collect(),
        Value::Object(values) => values
            .into_iter()
            .map(|(key, value)| (key, encode(value)))
            .collect(),
        other => other,
    }
}

/// The value that [`encode`] was given.
pub fn decode(value: Value) -> Value {
    match value {
        Value::Object(values) => match values.get(KEY) {
            Some(Value::String(text)) if values.len() == 1 => {
                text.parse::<f64>().map_or(Value::Null, Value::from)
            }
            _ => values
                .into_iter()
                .map(|(key, value)| (key, decode(value)))
                .collect(),
        },
        Value::Array(values) => values.into_iter().map(decode).collect(),
        other => other,
    }
}

/// For `#[serde(with)]`: a number that may be NaN or infinite, which JSON cannot represent.
pub mod any_f64 {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Serialize, Deserialize)]
    #[serde(untagged)]
    enum Either {
        Number(f64),
        Text(String),
    }

    /// # Errors
    /// Errors of the serializer.
    pub fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        let either = match value.is_finite() {
            true => Either::Number(*value),
            false => Either::Text(value.to_string()),
        };
        either.serialize(serializer)
    }

    /// # Errors
    /// Not a number.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        match Either::deserialize(deserializer)? {
            Either::Number(value) => Ok(value),
            Either::Text(text) => text.parse().map_err(D::Error::custom),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_json_lacks_come_back() {
        #[derive(serde::Serialize, serde::Deserialize)]
        struct One(#[serde(with = "any_f64")] f64);
        for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.1] {
            let text = encode(serde_json::to_value(One(number)).unwrap()).to_string();
            let back = decode(serde_json::from_str(&text).unwrap());
            let One(found) = serde_json::from_value(back).unwrap();
            assert!(
                found == number || (found.is_nan() && number.is_nan()),
                "{text}"
            );
        }
    }

    #[test]
    fn a_hundred_thousand_numbers_come_back_to_the_bit() {
        let mut state = 1_u64;
        let mut numbers = vec![0.0, -0.0, 5e-324, f64::MAX, 0.1];
        while numbers.len() < 100_000 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let number = f64::from_bits(state);
            numbers.extend(number.is_finite().then_some(number));
        }
        let text = encode(serde_json::json!({ "a": numbers, "n": 3 })).to_string();
        let back = decode(serde_json::from_str(&text).unwrap());
        assert_eq!(back["n"], 3);
        for (found, number) in back["a"].as_array().unwrap().iter().zip(&numbers) {
            assert_eq!(found.as_f64().unwrap().to_bits(), number.to_bits());
        }
    }
}
