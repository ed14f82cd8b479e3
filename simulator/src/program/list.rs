//! `tactus-sim list`: available modules, profiles, scenes, loads and faults.

use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::{Profile, Scene};

/// Every module with every terminal that it may have, in the form of a slot.
const MODULES: [(&str, &str); 9] = [
    (
        "34921A",
        "40 two-wire armature channels in two banks, and four for current",
    ),
    ("34922A", "70 two-wire armature channels in two banks"),
    (
        "34923A",
        "40 two-wire reed channels in two banks, with in-rush resistors",
    ),
    (
        "34924A",
        "70 two-wire reed channels in two banks, with in-rush resistors",
    ),
    (
        "34925A",
        "40 two-wire FET channels in two banks, the fastest scan",
    ),
    ("34931A", "dual 4 x 8 armature matrix"),
    ("34932A", "dual 4 x 16 armature matrix"),
    ("34933A", "dual or quad 4 x 8 reed matrix"),
    (
        "34934A",
        "quad 4 x 32 reed matrix; terminals make it 4x128, 8x64 or 16x32",
    ),
];

/// The lists as JSON: modules, profiles, scenes, loads, faults.
pub(crate) fn json() -> Value {
    let modules: Vec<Value> = MODULES
        .iter()
        .map(|(model, what)| json!({ "model": model, "what": what }))
        .collect();
    let profiles: Vec<Value> = Profile::names()
        .filter_map(|name| {
            let profile = Profile::shipped(name)?;
            let slots: Vec<Value> = profile
                .slots
                .iter()
                .map(|slot| slot.map_or(Value::Null, |slot| slot.to_string().into()))
                .collect();
            Some(json!({
                "name": name,
                "what": Profile::what(name),
                "slots": slots,
                "board": profile.board.is_some(),
            }))
        })
        .collect();
    let scenes: Vec<Value> = Scene::shipped()
        .iter()
        .map(|(name, text)| json!({ "name": name, "what": Scene::what(text) }))
        .collect();
    let explained = |grammar: &str| -> Vec<Value> {
        grammar
            .lines()
            .filter_map(|line| line.split_once("  "))
            .map(|(words, what)| json!({ "words": words.trim(), "what": what.trim() }))
            .collect()
    };
    let loads = explained(crate::LoadNetwork::GRAMMAR);
    let faults = explained(&crate::instrument::fault::GRAMMAR);
    json!({ "modules": modules, "profiles": profiles, "scenes": scenes, "loads": loads, "faults": faults })
}

/// The lists as text.
pub(crate) fn text() -> String {
    let all = json();
    let mut text = String::new();
    for (section, head, key) in [
        ("modules", "Modules (--slot N=MODULE)", "model"),
        ("profiles", "Profiles (--profile NAME, or a file)", "name"),
        ("scenes", "Scenes (--scene NAME, or a file)", "name"),
        (
            "loads",
            "Loads other than the sheet (--load WORDS)",
            "words",
        ),
        ("faults", "Faults (tactus-sim fault WORDS)", "words"),
    ] {
        // Writing to a String cannot fail.
        writeln!(text, "{head}").ok();
        for entry in all[section].as_array().into_iter().flatten() {
            let (name, what) = (&entry[key], &entry["what"]);
            let (name, what) = (
                name.as_str().unwrap_or_default(),
                what.as_str().unwrap_or_default(),
            );
            writeln!(text, "  {name:<34} {what}").ok();
        }
        text.push('\n');
    }
    text.truncate(text.trim_end().len());
    text
}

#[cfg(test)]
mod tests {
    use keysight_34980a::Module;

    use crate::program::list::*;

    #[test]
    fn every_module_named_can_be_had() {
        for (model, _) in MODULES {
            assert!(model.parse::<Module>().is_ok(), "{model}");
        }
    }

    #[test]
    fn every_shipped_part_has_a_description() {
        let all = json();
        for section in ["modules", "profiles", "scenes", "loads", "faults"] {
            let entries = all[section].as_array().unwrap();
            assert!(!entries.is_empty());
            for entry in entries {
                assert!(!entry["what"].as_str().unwrap().is_empty(), "{entry}");
            }
        }
        assert!(text().contains("pairs-34924a"));
    }
}
