//! Forbidden names and words.

use std::path::Path;

use proc_macro2::{TokenStream, TokenTree};

use super::{crates, folder, from_root, metadata, root, rust_files, text};

/// Instrument-independent crates: a model's name or limit belongs to its driver.
const WITHOUT_INSTRUMENTS: &[&str] = &["survey", "rig", "eit"];

const MODEL_NAMES: &[&str] = &[
    "6221", "34980", "34921", "34922", "34923", "34924", "34932", "4067", "keithley", "keysight",
    "agilent",
];

#[test]
fn survey_rig_and_eit_name_no_instrument_model() {
    let metadata = metadata();
    let crates = crates(&metadata);
    let mut found = Vec::new();
    for name in WITHOUT_INSTRUMENTS {
        for path in rust_files(&folder(crates[name]).join("src")) {
            let tokens: TokenStream = text(&path)
                .parse()
                .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            if names_model(tokens) {
                found.push(from_root(&path));
            }
        }
    }
    assert!(
        found.is_empty(),
        "an instrument's facts belong to its driver, but these name a model: {found:?}"
    );
}

/// Whether code or documentation names a model. Modules for tests are skipped.
fn names_model(tokens: TokenStream) -> bool {
    let mut tests = false;
    tokens.into_iter().any(|token| match token {
        TokenTree::Group(group) => {
            let inside = group.stream();
            if tests && group.delimiter() == proc_macro2::Delimiter::Brace {
                tests = false;
                return false;
            }
            tests |= inside.to_string() == "cfg (test)";
            names_model(inside)
        }
        TokenTree::Ident(_) | TokenTree::Literal(_) => {
            let word = token.to_string().to_lowercase();
            MODEL_NAMES.iter().any(|model| word.contains(model))
        }
        TokenTree::Punct(_) => false,
    })
}

/// Uninformative names of crates, modules and files.
const EMPTY_NAMES: &[&str] = &[
    "util", "utils", "common", "helpers", "core", "types", "manager", "misc",
];

#[test]
fn crates_and_files_have_telling_names() {
    let metadata = metadata();
    for (name, package) in crates(&metadata) {
        assert!(!EMPTY_NAMES.contains(&name), "package {name}");
        for path in rust_files(folder(package)) {
            for part in Path::new(&from_root(&path)).iter() {
                let part = part.to_string_lossy();
                let part = part.strip_suffix(".rs").unwrap_or(&part);
                assert!(
                    !EMPTY_NAMES.contains(&part),
                    "{}: '{part}' says nothing about what is inside",
                    path.display()
                );
            }
        }
    }
}

/// Words that must not be part of an identifier, each with its replacement.
const METAPHORS: &[(&str, &str)] = &[
    ("said", "message, text, reported"),
    ("unsaid", "unreported"),
    ("told", "reported, configured, sent"),
    ("untold", "unreported"),
    ("heard", "received"),
    ("unheard", "not received"),
    ("asked", "requested"),
    ("unasked", "unrequested"),
    ("room", "space, capacity, available"),
    ("wish", "request"),
    ("wished", "requested"),
    ("owed", "due, pending"),
    ("house", "runtime"),
    ("door", "listener"),
    ("keeper", "controller, guard"),
    ("herald", "broadcast"),
    ("aloud", "rate_limit"),
    ("mishap", "failed_frame"),
];

/// Names with these words in the formats of session files and scenes.
const STORED: &[&str] = &["asked", "room_c", "room_rh"];

#[test]
fn identifiers_use_standard_terms() {
    let metadata = metadata();
    let mut found = std::collections::BTreeSet::new();
    for package in crates(&metadata).values() {
        for path in rust_files(folder(package)) {
            let tokens: TokenStream = text(&path)
                .parse()
                .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            let file = from_root(&path);
            let module = path.file_stem().unwrap_or_default().to_string_lossy();
            for identifier in identifiers(tokens).into_iter().chain([module.into_owned()]) {
                if let Some((word, instead)) = metaphor(&identifier) {
                    found.insert(format!("{file}: {identifier}: {instead} instead of {word}"));
                }
            }
        }
    }
    assert!(found.is_empty(), "use standard terms: {found:#?}");
}

fn identifiers(tokens: TokenStream) -> Vec<String> {
    let mut all = Vec::new();
    for token in tokens {
        match token {
            TokenTree::Group(group) => all.extend(identifiers(group.stream())),
            TokenTree::Ident(identifier) => all.push(identifier.to_string()),
            TokenTree::Literal(_) | TokenTree::Punct(_) => {}
        }
    }
    all
}

/// The first word of an identifier that [`METAPHORS`] lists, in either case style.
fn metaphor(identifier: &str) -> Option<&'static (&'static str, &'static str)> {
    if STORED.contains(&identifier) {
        return None;
    }
    let mut spaced = String::new();
    let mut after_lower = false;
    for letter in identifier.chars() {
        if letter.is_uppercase() && after_lower {
            spaced.push('_');
        }
        after_lower = letter.is_lowercase();
        spaced.extend(letter.to_lowercase());
    }
    spaced
        .split('_')
        .find_map(|part| METAPHORS.iter().find(|(word, _)| *word == part))
}

#[test]
fn nothing_is_left_unfinished() {
    let metadata = metadata();
    // split so that this file does not contain them
    let words = [
        concat!("to", "do!("),
        concat!("unimplemented", "!("),
        concat!("#[ign", "ore"),
        concat!("#[should", "_panic"),
    ];
    for package in crates(&metadata).values() {
        for path in rust_files(folder(package)) {
            let text = text(&path);
            for word in words {
                assert!(!text.contains(word), "{}: has {word}", path.display());
            }
        }
    }
}

#[test]
fn no_file_names_the_machine_it_was_written_on() {
    let listed = std::process::Command::new("git")
        .args(["ls-files", "-z"])
        .current_dir(root())
        .output();
    let Ok(listed) = listed.map(|output| String::from_utf8_lossy(&output.stdout).into_owned())
    else {
        let why = "git is not installed, so the tracked files are not known";
        return needs::lacking("GIT", why);
    };
    let machine = [
        concat!("/ro", "ot/"),
        concat!("/ho", "me/"),
        concat!("/wo", "rk/"),
    ];
    for file in listed.split('\0').filter(|file| !file.is_empty()) {
        let Ok(text) = std::fs::read_to_string(root().join(file)) else {
            continue;
        };
        for path in machine {
            assert!(!text.contains(path), "{file} names {path}");
        }
    }
}
