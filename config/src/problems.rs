//! Reads a configuration and collects all problems with their positions.

use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::Config;

/// A problem of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// The file.
    pub file: PathBuf,
    /// Line and column from 1; `None` for the whole file.
    pub place: Option<(usize, usize)>,
    /// What is wrong, and what to do.
    pub text: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        if let Some((line, column)) = self.place {
            write!(f, ":{line}:{column}")?;
        }
        write!(f, ": {}", self.text)
    }
}

/// A configuration file, kept so that later problems can be located.
#[derive(Debug)]
pub struct Source {
    file: PathBuf,
    text: String,
}

impl Source {
    /// The file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// The text of a file.
    pub fn new(file: &Path, text: String) -> Self {
        Self {
            file: file.to_owned(),
            text,
        }
    }

    /// Parses; every unknown key and every value of the wrong type is a separate problem. If only numbers are out of
    /// bounds, a configuration with their defaults is returned too, so that the rest can be checked.
    pub fn read(&self) -> (Option<Config>, Vec<Problem>) {
        let (mut table, faults) = DeTable::parse_recoverable(&self.text);
        if !faults.is_empty() {
            let problems = faults
                .iter()
                .map(|fault| self.at(fault.span(), self.syntax(table.get_ref(), fault)))
                .collect();
            return (None, problems);
        }
        let mut problems: Vec<Problem> = crate::numbers::take_out(table.get_mut())
            .into_iter()
            .map(|(span, text)| self.at(Some(span), text))
            .collect();
        let of_bounds = problems.len();
        loop {
            let fault = match Config::deserialize(toml::Deserializer::from(table.clone())) {
                Ok(config) => return ((problems.len() == of_bounds).then_some(config), problems),
                Err(fault) => fault,
            };
            let span = fault.span();
            let key = span
                .as_ref()
                .and_then(|span| path(table.get_ref(), span.start));
            problems.push(self.at(span.clone(), explain(fault.message(), key.as_deref())));
            // the faulty entry is removed, so that the next problem is found
            let removed = span.is_some_and(|span| remove(table.get_mut(), &span));
            if !removed {
                return (None, problems);
            }
        }
    }

    /// The entries of `[[section]]` without a fault, each with its index, and whether these are all entries. They can
    /// be checked although other entries have faults.
    pub fn sound<T: DeserializeOwned>(&self, section: &str) -> (Vec<(usize, T)>, bool) {
        let (mut table, faults) = DeTable::parse_recoverable(&self.text);
        let entries = match table.get_ref().get(section).map(Spanned::get_ref) {
            Some(DeValue::Array(entries)) if faults.is_empty() => entries.clone(),
            other => return (Vec::new(), other.is_none()),
        };
        let of_bounds = crate::numbers::take_out(table.get_mut());
        let read = |entry: &Spanned<DeValue<'_>>| {
            let DeValue::Table(inner) = entry.get_ref() else {
                return None;
            };
            if of_bounds.iter().any(|(span, _)| holds(entry, span.start)) {
                return None;
            }
            let inner = Spanned::new(entry.span(), inner.clone());
            T::deserialize(toml::Deserializer::from(inner)).ok()
        };
        let each = entries.iter().enumerate();
        let sound: Vec<_> = each
            .filter_map(|(index, entry)| Some((index, read(entry)?)))
            .collect();
        let all = sound.len() == entries.len();
        (sound, all)
    }

    /// The configuration without regions, rules and settings of quantities, if it has no fault elsewhere.
    pub fn without_rules(&self) -> Option<Config> {
        let (mut table, faults) = DeTable::parse_recoverable(&self.text);
        for section in ["region", "alarm", "quantities"] {
            table.get_mut().remove(section);
        }
        let is_bad = !faults.is_empty() || !crate::numbers::take_out(table.get_mut()).is_empty();
        let read = || Config::deserialize(toml::Deserializer::from(table)).ok();
        (!is_bad).then(read).flatten()
    }

    /// A problem at the position of a dotted key (`survey.electrodes`; `region.0.name` in the first `[[region]]`), or
    /// of its nearest parent in the file.
    pub fn problem(&self, key: &str, text: impl Into<String>) -> Problem {
        let (table, _) = DeTable::parse_recoverable(&self.text);
        let mut span = None;
        let mut level = table.get_ref();
        let mut parts = key.split('.');
        while let Some(part) = parts.next() {
            let Some((name, value)) = level.iter().find(|(name, _)| name.get_ref() == part) else {
                break;
            };
            span = Some(match value.get_ref() {
                DeValue::Table(_) => name.span(),
                _ => value.span(),
            });
            let inner = match value.get_ref() {
                DeValue::Array(entries) => {
                    let index = parts.next().and_then(|index| index.parse().ok());
                    let entry = index.and_then(|index: usize| entries.get(index));
                    span = entry.map(|entry| entry.span()).or(span);
                    entry.map(|entry| entry.get_ref())
                }
                other => Some(other),
            };
            match inner {
                Some(DeValue::Table(inner)) => level = inner,
                _ => break,
            }
        }
        // a missing section is reported on the first line
        self.at(span.or(Some(0..0)), format!("{key}: {}", text.into()))
    }

    /// Describes a syntax error. For a duplicate key, the text names the key and the line of the other one.
    fn syntax(&self, table: &DeTable<'_>, fault: &toml::de::Error) -> String {
        let message = fault.message();
        let Some(span) = fault.span().filter(|_| message == "duplicate key") else {
            return message.to_owned();
        };
        let name = self.text.get(span.clone()).unwrap_or_default();
        let other = latest(table, name.trim_matches(['"', '\'']), span.start);
        let line = other.map_or(String::new(), |other| {
            format!(" (line {})", survey::line_and_column(&self.text, other).0)
        });
        format!("the key '{name}' is there twice{line}; delete one of them")
    }

    fn at(&self, span: Option<Range<usize>>, text: String) -> Problem {
        Problem {
            file: self.file.clone(),
            place: span.map(|span| survey::line_and_column(&self.text, span.start)),
            text,
        }
    }
}

/// Removes the entry whose key or value the problem points at. In an array of tables, only an unknown key is removed
/// alone; for any other fault the whole table is removed, because a table without one of its values would be reported
/// with problems that it does not have.
fn remove(table: &mut DeTable<'_>, fault: &Range<usize>) -> bool {
    let points_at = |span: Range<usize>| {
        span.start <= fault.start && fault.start < span.end.max(span.start + 1)
    };
    let found = table.iter().find_map(|(key, value)| {
        let plain = !matches!(value.get_ref(), DeValue::Table(_) | DeValue::Array(_));
        let hit = key.span() == *fault || (plain && points_at(value.span()));
        hit.then(|| key.clone())
    });
    if let Some(key) = found {
        return table.remove(&key).is_some();
    }
    let below = |value: &mut DeValue<'_>| match value {
        DeValue::Table(inner) => remove(inner, fault),
        _ => false,
    };
    if table.iter_mut().any(|(_, value)| below(value.get_mut())) {
        return true;
    }
    let mut faulty = None;
    for (key, value) in table.iter_mut() {
        let here = points_at(value.span());
        let DeValue::Array(entries) = value.get_mut() else {
            continue;
        };
        for entry in entries.iter_mut() {
            if let DeValue::Table(inner) = entry.get_mut() {
                let unknown = inner.iter().find(|(key, _)| key.span() == *fault);
                if let Some(key) = unknown.map(|(key, _)| key.clone()) {
                    return inner.remove(&key).is_some();
                }
            }
        }
        let hit = |entry: &Spanned<DeValue<'_>>| holds(entry, fault.start);
        if entries.iter().any(hit) {
            let kept = entries.iter().filter(|entry| !hit(entry)).cloned();
            *entries = kept.collect();
            return true;
        }
        if here {
            faulty = Some(key.clone());
        }
    }
    faulty.is_some_and(|key| table.remove(&key).is_some())
}

/// Whether a position lies in a value; a table in an array is spanned by its header only.
fn holds(value: &Spanned<DeValue<'_>>, at: usize) -> bool {
    let span = value.span();
    let inside = span.start <= at && at < span.end.max(span.start + 1);
    let below = match value.get_ref() {
        DeValue::Table(inner) => inner.iter().any(|(_, value)| holds(value, at)),
        DeValue::Array(entries) => entries.iter().any(|entry| holds(entry, at)),
        _ => false,
    };
    inside || below
}

/// Renamed keys: the former and the present name.
const RENAMED: [(&str, &str); 1] = [("care", "relay_wear")];

/// The start of the last key of this name before a position.
fn latest(table: &DeTable<'_>, name: &str, before: usize) -> Option<usize> {
    let below = |value: &Spanned<DeValue<'_>>| match value.get_ref() {
        DeValue::Table(inner) => latest(inner, name, before),
        _ => None,
    };
    let each = table.iter().flat_map(|(key, value)| {
        let at = Some(key.span().start).filter(|at| key.get_ref() == name && *at < before);
        let inner = match value.get_ref() {
            DeValue::Array(entries) => entries.iter().filter_map(below).max(),
            _ => below(value),
        };
        at.into_iter().chain(inner)
    });
    each.max()
}

/// The dotted key (`survey.nplc`, `alarm.0.above`) whose name or value is at a position.
fn path(table: &DeTable<'_>, at: usize) -> Option<String> {
    table.iter().find_map(|(name, value)| {
        let key = name.get_ref();
        let below = match value.get_ref() {
            DeValue::Table(inner) => path(inner, at),
            DeValue::Array(entries) => entries.iter().enumerate().find_map(|(index, entry)| {
                let below = match entry.get_ref() {
                    DeValue::Table(inner) => path(inner, at),
                    _ => None,
                };
                let here = entry.span().contains(&at).then(|| index.to_string());
                below.map(|below| format!("{index}.{below}")).or(here)
            }),
            _ => None,
        };
        let here = name.span().contains(&at) || value.span().contains(&at);
        match below {
            Some(below) => Some(format!("{key}.{below}")),
            None => here.then(|| key.to_string()),
        }
    })
}

/// Describes the problem of a key: the type and unit expected instead, the new name of a renamed key, or the key most
/// similar to an unknown one.
fn explain(message: &str, key: Option<&str>) -> String {
    let message = message.lines().next().unwrap_or(message);
    let Some(rest) = message.strip_prefix("unknown field `") else {
        let Some(key) = key else {
            return message.to_owned();
        };
        let of_type = message.strip_prefix("invalid type: ");
        let text = of_type.and_then(|rest| rest.rsplit_once(", expected "));
        return match text {
            Some((found, expected)) => format!("{key}: {}", wrong_type(key, found, expected)),
            None => format!("{key}: {message}"),
        };
    };
    let mut names = rest.split('`').step_by(2);
    let Some(unknown) = names.next() else {
        return message.to_owned();
    };
    if let Some((_, renamed)) = RENAMED.iter().find(|(old, _)| *old == unknown) {
        return format!("unknown key '{unknown}'; it is '{renamed}' now");
    }
    let known: Vec<&str> = names.filter(|name| !name.is_empty()).collect();
    match survey::nearest(unknown, known.iter().copied()) {
        Some(nearest) => format!("unknown key '{unknown}'; did you mean '{nearest}'?"),
        None => format!("unknown key '{unknown}'; known here: {}", known.join(", ")),
    }
}

/// Units at the end of a key's name, in words.
const UNITS: [(&str, &str); 15] = [
    ("ms", "milliseconds"),
    ("s", "seconds"),
    ("h", "hours"),
    ("days", "days"),
    ("mm", "millimetres"),
    ("cm2", "square centimetres"),
    ("ua", "microamperes"),
    ("uv", "microvolts"),
    ("v", "volts"),
    ("ohm", "ohms"),
    ("hz", "hertz"),
    ("deg", "degrees"),
    ("kpa", "kilopascals"),
    ("percent", "percent"),
    ("mb", "megabytes"),
];

/// Describes the expected type of a value in plain words; serde would name Rust types.
fn wrong_type(key: &str, found: &str, expected: &str) -> String {
    // a float such as 5e-324 has 326 digits
    let found = &*survey::printable_within(found, 100);
    let name = key.rsplit('.').next().unwrap_or(key);
    let ending = name.rsplit('_').next();
    let unit = UNITS.iter().find(|(unit, _)| ending == Some(unit));
    let number = match expected {
        "f64" => "a number",
        "u8" | "u16" | "u32" | "u64" | "usize" | "i64" => "a whole number",
        "a boolean" => return format!("true or false is expected, and not the {found}"),
        "a string" | "path string" => {
            return format!("a text in quotes is expected, and not the {found}");
        }
        other => return format!("{other} is expected, and not the {found}"),
    };
    let unit_word = unit.map_or(String::new(), |(_, word)| format!(" of {word}"));
    let text = found
        .strip_prefix("string \"")
        .and_then(|text| text.strip_suffix('"'));
    let advice = text.map_or(String::new(), |text| {
        let end = text
            .find(|letter: char| letter.is_alphabetic())
            .unwrap_or(text.len());
        let (value, rest) = (text[..end].trim(), text[end..].trim().to_lowercase());
        let same_unit = rest.is_empty() || unit.is_some_and(|(unit, _)| rest == *unit);
        match same_unit && value.parse::<f64>().is_ok() {
            true => format!("; write {name} = {value}"),
            false => "; write it without quotes and unit".to_owned(),
        }
    });
    format!("{number}{unit_word} is expected, and not the {found}{advice}")
}

#[cfg(test)]
mod tests {
    use crate::problems::*;

    fn problems(text: &str) -> Vec<String> {
        let (_, problems) = Source::new(Path::new("c.toml"), text.to_owned()).read();
        problems.iter().map(Problem::to_string).collect()
    }

    #[test]
    fn every_unknown_key_and_wrong_value_is_named_with_its_place() {
        let text = "[rig]\nkind = \"simulted\"\n[survey]\nsettle_us = 3\n  nplc = \"one\"\n[wirring]\nslot = 1\n";
        let found = problems(text);
        assert_eq!(found.len(), 4, "{found:#?}");
        let joined = found.join("\n");
        assert!(
            joined.contains("c.toml:2:8: rig.kind: unknown variant `simulted`"),
            "{joined}"
        );
        assert!(
            joined.contains("c.toml:4:1: unknown key 'settle_us'; did you mean 'settle_ms'?"),
            "{joined}"
        );
        let text = "c.toml:5:10: survey.nplc: a number is expected, and not the string \"one\"; write it without quotes and unit";
        assert!(joined.contains(text), "{joined}");
        assert!(
            joined.contains("c.toml:6:2: unknown key 'wirring'; did you mean 'wiring'?"),
            "{joined}"
        );
    }

    #[test]
    fn a_value_of_the_wrong_type_names_key_type_and_unit() {
        for (line, wanted) in [
            (
                "settle_ms = \"2ms\"",
                "15: survey.settle_ms: a number of milliseconds is expected, and not the string \"2ms\"; write settle_ms = 2",
            ),
            (
                "settle_ms = \"2s\"",
                "15: survey.settle_ms: a number of milliseconds is expected, and not the string \"2s\"; write it without quotes and unit",
            ),
            (
                "averages = 1.5",
                "14: survey.averages: a whole number is expected, and not the floating point `1.5`",
            ),
            (
                "reversal = 1",
                "14: survey.reversal: true or false is expected, and not the integer `1`",
            ),
        ] {
            let found = problems(&format!("[survey]\n  {line}\n"));
            assert_eq!(found, [format!("c.toml:2:{wanted}")]);
        }
        let found = problems("[record]\ndirectory = 1\n[[region]]\nname = 3\n").join("\n");
        for wanted in [
            "c.toml:2:13: record.directory: a text in quotes",
            "c.toml:4:8: region.0.name: a text",
        ] {
            assert!(found.contains(wanted), "{wanted}\n{found}");
        }
    }

    #[test]
    fn a_key_that_is_there_twice_is_named_with_both_lines() {
        for (text, wanted) in [
            (
                "[survey]\nnplc = 1\n[rig]\n[wiring]\nslot = 1\nslot = 2\n",
                "6:1: the key 'slot' is there twice (line 5); delete one of them",
            ),
            (
                "[[alarm]]\nname = \"a\"\n[[alarm]]\nname = \"b\"\nname = \"c\"\n",
                "5:1: the key 'name' is there twice (line 4); delete one of them",
            ),
            (
                "[rig]\n[survey]\n[rig]\n",
                "3:2: the key 'rig' is there twice; delete one of them",
            ),
        ] {
            assert_eq!(problems(text), [format!("c.toml:{wanted}")]);
        }
    }

    #[test]
    fn a_renamed_key_is_answered_with_its_new_name() {
        let found = problems("[care]\nrelay_life_cycles = 1000\n");
        let expected = "c.toml:1:2: unknown key 'care'; it is 'relay_wear' now";
        assert_eq!(found, [expected]);
    }

    #[test]
    fn problems_inside_an_array_of_tables_are_all_found() {
        let text = "[[alarm]]\nname = \"a\"\nquantity = \"pii\"\n[[alarm]]\nname = \"b\"\nquantity = \"ppi\"\nfor_s = -1.0\nabov = 3\n";
        let found = problems(text).join("\n");
        for wanted in [
            "c.toml:3:12: alarm.0.quantity: unknown quantity 'pii'; did you mean 'ppi'?",
            "c.toml:7:9: alarm.for_s: -1",
            "c.toml:8:1: unknown key 'abov'; did you mean 'above'?",
        ] {
            assert!(found.contains(wanted), "{wanted}\n{found}");
        }
    }

    #[test]
    fn invalid_toml_is_reported_with_line_and_column() {
        assert!(problems("[rig\n")[0].starts_with("c.toml:1:"));
    }

    #[test]
    fn a_later_problem_is_placed_at_its_key_or_its_section() {
        let source = Source::new(Path::new("c.toml"), "[survey]\ncurrent_ua = 1\n".to_owned());
        assert_eq!(
            source.problem("survey.current_ua", "x").place,
            Some((2, 14))
        );
        assert_eq!(source.problem("survey.nplc", "x").place, Some((1, 2)));
        assert_eq!(source.problem("model.file", "x").place, Some((1, 1)));
        let text = "[[region]]\nname = \"a\"\n[[region]]\nname = \"b\"\n";
        let source = Source::new(Path::new("c.toml"), text.to_owned());
        assert_eq!(source.problem("region.1.name", "x").place, Some((4, 8)));
        assert_eq!(
            source.problem("region.1.polygon_mm", "x").place,
            Some((3, 1))
        );
    }
}
