//! Reads a configuration and collects all problems with their positions.

use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Deserialize;
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
                .map(|fault| self.at(fault.span(), fault.message().to_owned()))
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
            problems.push(self.at(span.clone(), explain(fault.message())));
            // the faulty entry is removed, so that the next problem is found
            let removed = span.is_some_and(|span| remove(table.get_mut(), &span));
            if !removed {
                return (None, problems);
            }
        }
    }

    /// Locates a problem at a dotted key (`survey.electrodes`; `region.0.name` in the first `[[region]]`), or at its nearest
    /// parent in the file.
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

    fn at(&self, span: Option<Range<usize>>, text: String) -> Problem {
        Problem {
            file: self.file.clone(),
            place: span.map(|span| place(&self.text, span.start)),
            text,
        }
    }
}

/// Line and column, from 1, of a byte offset.
fn place(text: &str, at: usize) -> (usize, usize) {
    let before = text.get(..at).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before
        .rsplit('\n')
        .next()
        .map_or(0, |line| line.chars().count())
        + 1;
    (line, column)
}

/// Removes the entry whose key or value the problem points at. A table in an array goes whole, unless only a key of it is
/// unknown: without one of its values, further problems would be reported that are none.
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
        let hit = |entry: &toml::Spanned<DeValue<'_>>| holds(entry, fault.start);
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
fn holds(value: &toml::Spanned<DeValue<'_>>, at: usize) -> bool {
    let span = value.span();
    let inside = span.start <= at && at < span.end.max(span.start + 1);
    let below = match value.get_ref() {
        DeValue::Table(inner) => inner.iter().any(|(_, value)| holds(value, at)),
        DeValue::Array(entries) => entries.iter().any(|entry| holds(entry, at)),
        _ => false,
    };
    inside || below
}

/// Keys that had another name, with the present one.
const RENAMED: [(&str, &str); 1] = [("care", "relay_wear")];

/// Adds the new name of a renamed key, or the most similar key to an unknown one.
fn explain(message: &str) -> String {
    let message = message.lines().next().unwrap_or(message);
    let Some(rest) = message.strip_prefix("unknown field `") else {
        return message.to_owned();
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
            joined.contains("c.toml:2:8: unknown variant `simulted`"),
            "{joined}"
        );
        assert!(
            joined.contains("c.toml:4:1: unknown key 'settle_us'; did you mean 'settle_ms'?"),
            "{joined}"
        );
        assert!(joined.contains("c.toml:5:10: invalid type"), "{joined}");
        assert!(
            joined.contains("c.toml:6:2: unknown key 'wirring'; did you mean 'wiring'?"),
            "{joined}"
        );
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
            "c.toml:3:12: unknown quantity 'pii'; did you mean 'ppi'?",
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
