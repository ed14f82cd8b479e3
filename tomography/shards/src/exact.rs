//! Results as JSON that come back to the bit. The JSON parser of this workspace rounds some numbers in their last
//! digit, so a number with a fraction is written as `{"f64": "0.1"}` and read by the parser of Rust, which is exact.

use serde_json::{Map, Value};

const KEY: &str = "f64";

pub(crate) fn encode(value: Value) -> Value {
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

pub(crate) fn decode(value: Value) -> Value {
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

#[cfg(test)]
mod tests {
    use super::*;

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
