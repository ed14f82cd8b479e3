//! Every numeric key of the configuration has bounds; any value is accepted, or refused with the name of its key.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use crate::numbers::*;
use crate::problems::Source;
use crate::{AlarmSettings, Config};

/// Lists the keys of a deserialised type and the kind of value that each requests.
mod schema {
    use std::collections::BTreeMap;

    use serde::de::value::{Error, StrDeserializer};
    use serde::de::{
        DeserializeSeed, Deserializer, EnumAccess, IntoDeserializer, MapAccess, VariantAccess,
        Visitor,
    };

    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub(super) enum Kind {
        Whole,
        Real,
    }

    /// Deserialiser that provides a value for every field of every section, and records which are numbers.
    pub(super) struct Recorder<'a> {
        pub path: String,
        pub numbers: &'a mut BTreeMap<String, Kind>,
    }

    impl Recorder<'_> {
        fn note(self, kind: Kind) {
            self.numbers.insert(self.path, kind);
        }
    }

    macro_rules! numbers {
        ($kind:expr, $visit:ident: $($name:ident)*) => {$(
            fn $name<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
                self.note($kind);
                visitor.$visit(1)
            }
        )*};
    }

    macro_rules! texts {
        ($($name:ident)*) => {$(
            fn $name<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
                // every text key accepts this text: it is the name of a quantity
                visitor.visit_str("ppi")
            }
        )*};
    }

    impl<'de> Deserializer<'de> for Recorder<'_> {
        type Error = Error;

        numbers!(Kind::Whole, visit_u8: deserialize_u8 deserialize_u16 deserialize_u32 deserialize_u64
                 deserialize_i8 deserialize_i16 deserialize_i32 deserialize_i64);
        texts!(deserialize_str deserialize_string deserialize_char deserialize_bytes deserialize_byte_buf
               deserialize_identifier);

        fn deserialize_f32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            self.note(Kind::Real);
            visitor.visit_f32(1.0)
        }
        fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            self.note(Kind::Real);
            visitor.visit_f64(1.0)
        }
        fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            visitor.visit_bool(false)
        }
        fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            visitor.visit_some(self)
        }
        fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            let none: [u8; 0] = [];
            visitor.visit_seq(serde::de::value::SeqDeserializer::new(none.into_iter()))
        }
        fn deserialize_struct<V: Visitor<'de>>(
            self,
            _: &'static str,
            fields: &'static [&'static str],
            visitor: V,
        ) -> Result<V::Value, Error> {
            visitor.visit_map(Fields {
                above: self,
                left: fields,
            })
        }
        fn deserialize_newtype_struct<V: Visitor<'de>>(
            self,
            _: &'static str,
            visitor: V,
        ) -> Result<V::Value, Error> {
            visitor.visit_newtype_struct(self)
        }
        fn deserialize_enum<V: Visitor<'de>>(
            self,
            _: &'static str,
            variants: &'static [&'static str],
            visitor: V,
        ) -> Result<V::Value, Error> {
            visitor.visit_enum(First(variants[0]))
        }
        // numbers in such a value would not be found: fail instead of omitting one silently
        fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Error> {
            panic!("{} asks for anything", self.path)
        }
        fn deserialize_map<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Error> {
            panic!("{} asks for a map", self.path)
        }
        fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            visitor.visit_unit()
        }
        serde::forward_to_deserialize_any! { unit unit_struct tuple tuple_struct }
    }

    struct Fields<'a> {
        above: Recorder<'a>,
        left: &'static [&'static str],
    }

    impl<'de> MapAccess<'de> for Fields<'_> {
        type Error = Error;

        fn next_key_seed<K: DeserializeSeed<'de>>(
            &mut self,
            seed: K,
        ) -> Result<Option<K::Value>, Error> {
            let Some(name) = self.left.first() else {
                return Ok(None);
            };
            let name: StrDeserializer<'_, Error> = (*name).into_deserializer();
            seed.deserialize(name).map(Some)
        }

        fn next_value_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<T::Value, Error> {
            let (name, left) = self.left.split_first().unwrap();
            self.left = left;
            let dot = if self.above.path.is_empty() { "" } else { "." };
            seed.deserialize(Recorder {
                path: format!("{}{dot}{name}", self.above.path),
                numbers: self.above.numbers,
            })
        }
    }

    struct First(&'static str);

    impl<'de> EnumAccess<'de> for First {
        type Error = Error;
        type Variant = Self;

        fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Self), Error> {
            let name: StrDeserializer<'_, Error> = self.0.into_deserializer();
            Ok((seed.deserialize(name)?, self))
        }
    }

    impl<'de> VariantAccess<'de> for First {
        type Error = Error;

        fn unit_variant(self) -> Result<(), Error> {
            Ok(())
        }
        fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, _: T) -> Result<T::Value, Error> {
            panic!("{} has a content", self.0)
        }
        fn tuple_variant<V: Visitor<'de>>(self, _: usize, _: V) -> Result<V::Value, Error> {
            panic!("{} has a content", self.0)
        }
        fn struct_variant<V: Visitor<'de>>(
            self,
            _: &'static [&'static str],
            _: V,
        ) -> Result<V::Value, Error> {
            panic!("{} has a content", self.0)
        }
    }
}

/// Every numeric key that the configuration's types have.
fn numeric_keys() -> BTreeMap<String, schema::Kind> {
    let mut numbers = BTreeMap::new();
    Config::deserialize(schema::Recorder {
        path: String::new(),
        numbers: &mut numbers,
    })
    .unwrap();
    // deserialize_seq gives empty lists, so the elements of `alarm` are examined here
    AlarmSettings::deserialize(schema::Recorder {
        path: "alarm".to_owned(),
        numbers: &mut numbers,
    })
    .unwrap();
    numbers
}

#[test]
fn every_numeric_key_has_bounds() {
    let numeric: Vec<String> = numeric_keys().into_keys().collect();
    let mut bounded: Vec<String> = keys().map(|(key, _)| key.to_owned()).collect();
    bounded.sort();
    assert_eq!(numeric, bounded);
}

#[test]
fn defaults_are_within_their_bounds() {
    let config: Config = toml::from_str("[geometry.paper-sheet]\n[geometry.disc-tank]\n").unwrap();
    assert!(config.geometry.paper_sheet.is_some() && config.geometry.disc_tank.is_some());
    let text = toml::to_string(&config).unwrap();
    let source = Source::new(Path::new("c.toml"), text);
    assert_eq!(source.read(), (Some(config), Vec::new()));
}

/// A configuration that sets one key only.
fn with(key: &str, value: &str) -> String {
    let (section, name) = key.rsplit_once('.').unwrap();
    if section == "alarm" {
        return format!("[[alarm]]\nname = \"a\"\nquantity = \"ppi\"\n{name} = {value}\n");
    }
    format!("[{section}]\n{name} = {value}\n")
}

const EXTREMES: [&str; 14] = [
    "inf",
    "-inf",
    "nan",
    "-nan",
    "1e308",
    "-1e308",
    "1e999",
    "-1",
    "-0.0",
    "0",
    "5e-324",
    "9223372036854775807",
    "18446744073709551615",
    "340282366920938463463374607431768211456",
];

#[test]
fn an_extreme_is_refused_by_key_value_and_range() {
    let bounds: BTreeMap<&str, Bounds> = keys().collect();
    let mut refused = 0;
    for (key, kind) in numeric_keys() {
        for value in EXTREMES {
            let text = with(&key, value);
            let (_, problems) = Source::new(Path::new("c.toml"), text).read();
            if problems.is_empty() {
                // accepted: it is within the bounds
                let number: f64 = value.parse().unwrap();
                assert!(
                    bounds[key.as_str()].check(number).is_ok(),
                    "{key} = {value}"
                );
                continue;
            }
            let message: Vec<String> = problems.iter().map(ToString::to_string).collect();
            let message = message.join("\n");
            refused += 1;
            let allowed = bounds[key.as_str()].to_string();
            let range = allowed.replacen("one of", "none of", 1);
            let named = message.contains(&key) && message.contains(&range);
            // refused by type: a fraction for a whole number within the bounds, or a number that TOML cannot represent
            let by_type = kind == schema::Kind::Whole && message.contains("a whole number");
            let no_toml = value == "1e999" || value.len() > 19;
            assert!(named || by_type || no_toml, "{key} = {value}: {message}");
            assert!(message.len() < 400, "{message}");
        }
    }
    assert!(refused > 500, "{refused}");
}
