//! The walls of the house, over `cargo metadata`: who may know whom, and what must never be there.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, Package};

/// Arrows of design.md. A room may know fewer, never more; development dependencies are held to the same.
const MAY_KNOW: &[(&str, &[&str])] = &[
    ("survey", &[]),
    ("outfile", &[]),
    ("scpi", &[]),
    ("dbus", &[]),
    ("render", &["survey"]),
    ("logbook", &["outfile", "survey"]),
    ("eit", &["outfile", "survey"]),
    ("rig", &["outfile", "survey"]),
    ("phantom", &["eit", "survey"]),
    ("keithley-6221", &["rig", "scpi", "survey"]),
    ("keysight-34980a", &["rig", "scpi", "survey"]),
    ("gpio-mux", &["rig", "scpi", "survey"]),
    (
        "simulator",
        &[
            "outfile",
            "phantom",
            "keithley-6221",
            "keysight-34980a",
            "gpio-mux",
            "rig",
            "scpi",
            "survey",
        ],
    ),
    (
        "lab",
        &[
            "simulator",
            "phantom",
            "eit",
            "render",
            "logbook",
            "outfile",
            "survey",
        ],
    ),
    (
        "daemon",
        &[
            "dbus",
            "logbook",
            "simulator",
            "eit",
            "outfile",
            "render",
            "keithley-6221",
            "keysight-34980a",
            "gpio-mux",
            "rig",
            "survey",
        ],
    ),
    (
        "cli",
        &["dbus", "logbook", "eit", "outfile", "render", "survey"],
    ),
    (
        "demo",
        &[
            "simulator",
            "daemon",
            "cli",
            "dbus",
            "logbook",
            "eit",
            "phantom",
            "render",
            "survey",
        ],
    ),
];

fn metadata() -> Metadata {
    MetadataCommand::new()
        .manifest_path(concat!(env!("CARGO_MANIFEST_DIR"), "/../Cargo.toml"))
        .no_deps()
        .exec()
        .expect("cargo itself runs this test, so it can tell its metadata")
}

/// A crate's name without the prefix that all packages of the workspace share.
fn short(package: &str) -> String {
    package
        .strip_prefix("tactus-")
        .unwrap_or(package)
        .to_owned()
}

fn rooms(metadata: &Metadata) -> BTreeMap<String, &Package> {
    metadata
        .workspace_packages()
        .into_iter()
        .map(|package| (short(&package.name), package))
        .collect()
}

fn knows(package: &Package) -> BTreeSet<String> {
    package
        .dependencies
        .iter()
        .map(|dependency| short(&dependency.name))
        .collect()
}

#[test]
fn a_room_knows_only_whom_it_may() {
    let metadata = metadata();
    let rooms = rooms(&metadata);
    let allowed: BTreeMap<_, _> = MAY_KNOW.iter().copied().collect();
    for (name, package) in &rooms {
        if name == "tests" {
            continue;
        }
        let allowed = allowed
            .get(name.as_str())
            .unwrap_or_else(|| panic!("room '{name}' has no place in the house"));
        for known in knows(package)
            .iter()
            .filter(|known| rooms.contains_key(*known))
        {
            assert!(
                allowed.contains(&known.as_str()),
                "{name} must not know {known}"
            );
        }
    }
    for (name, _) in MAY_KNOW {
        assert!(rooms.contains_key(*name), "room '{name}' is missing");
    }
}

#[test]
fn mathematics_knows_no_clock_no_runtime_no_bus() {
    let metadata = metadata();
    let rooms = rooms(&metadata);
    for room in ["survey", "scpi", "eit", "phantom", "render"] {
        let known = knows(rooms[room]);
        for stranger in ["tokio", "zbus", "tokio-serial", "mdns-sd"] {
            assert!(!known.contains(stranger), "{room} must not know {stranger}");
        }
    }
    let source = |room: &str| {
        rooms[room]
            .manifest_path
            .parent()
            .expect("a manifest lies in a folder")
            .join("src")
    };
    for room in ["survey", "scpi", "eit", "phantom"] {
        for (path, text) in rust_files(source(room).as_std_path()) {
            for clock in ["Instant::now", "SystemTime::now", "Utc::now", "Local::now"] {
                assert!(!text.contains(clock), "{path} asks a clock ({clock})");
            }
        }
    }
}

#[test]
fn the_nine_packages_that_the_user_named_are_used() {
    let metadata = metadata();
    let rooms = rooms(&metadata);
    let uses = |room: &str, package: &str| {
        rooms[room].dependencies.iter().any(|dependency| {
            short(&dependency.name) == package && dependency.kind == DependencyKind::Normal
        })
    };
    // each with the room in which it serves its purpose, and a word that shows it at work there
    for (package, room, word) in [
        ("tokio", "rig", "AsyncRead"),
        ("tokio-serial", "rig", "tokio_serial"),
        ("scpi", "keithley-6221", "scpi::"),
        ("mdns-sd", "simulator", "mdns_sd"),
        ("zbus", "dbus", "zbus"),
        ("serde", "survey", "serde"),
        ("toml", "daemon", "toml"),
        ("nalgebra", "eit", "DMatrix"),
        ("chrono", "survey", "chrono"),
    ] {
        assert!(uses(room, package), "{room} does not depend on {package}");
        let folder = rooms[room]
            .manifest_path
            .parent()
            .expect("a manifest lies in a folder")
            .join("src");
        assert!(
            rust_files(folder.as_std_path())
                .iter()
                .any(|(_, text)| text.contains(word)),
            "{room} depends on {package} but never says '{word}'"
        );
    }
}

#[test]
fn no_room_is_called_by_a_name_that_says_nothing() {
    let metadata = metadata();
    for package in metadata.workspace_packages() {
        let folder = package
            .manifest_path
            .parent()
            .expect("a manifest lies in a folder");
        assert!(
            !SAYS_NOTHING.contains(&short(&package.name).as_str()),
            "package {}",
            package.name
        );
        for (path, _) in rust_files(folder.as_std_path()) {
            let name = Path::new(&path)
                .file_stem()
                .and_then(|name| name.to_str())
                .unwrap_or_default()
                .to_owned();
            assert!(!SAYS_NOTHING.contains(&name.as_str()), "{path}");
        }
    }
}

const SAYS_NOTHING: &[&str] = &[
    "util", "utils", "common", "helpers", "core", "types", "manager", "misc",
];

#[test]
fn nothing_is_left_undone() {
    let metadata = metadata();
    // spelled apart so that this file does not find itself
    let words = [
        concat!("to", "do!("),
        concat!("unimplemented", "!("),
        concat!("#[ign", "ore"),
        concat!("#[should", "_panic"),
    ];
    for package in metadata.workspace_packages() {
        let folder = package
            .manifest_path
            .parent()
            .expect("a manifest lies in a folder");
        for (path, text) in rust_files(folder.as_std_path()) {
            for word in words {
                assert!(!text.contains(word), "{path} has {word}");
            }
        }
    }
}

#[test]
fn no_file_knows_the_machine_it_was_written_on() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let listed = std::process::Command::new("git")
        .args(["ls-files", "-z"])
        .current_dir(root)
        .output();
    let Ok(listed) = listed.map(|output| String::from_utf8_lossy(&output.stdout).into_owned())
    else {
        eprintln!("skipped: git is not installed, so the tracked files are not known");
        return;
    };
    let strangers = [
        concat!("/ro", "ot/"),
        concat!("/ho", "me/"),
        concat!("/wo", "rk/"),
    ];
    for file in listed.split('\0').filter(|file| !file.is_empty()) {
        let Ok(text) = std::fs::read_to_string(root.join(file)) else {
            continue;
        };
        for stranger in strangers {
            assert!(!text.contains(stranger), "{file} names {stranger}");
        }
    }
}

fn rust_files(folder: &Path) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let Ok(entries) = std::fs::read_dir(folder) else {
        return found;
    };
    for path in entries.filter_map(|entry| entry.ok().map(|entry| entry.path())) {
        if path.is_dir() && !path.ends_with("target") {
            found.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = std::fs::read_to_string(&path)
                .expect("a source file of the project is readable text");
            found.push((path.display().to_string(), text));
        }
    }
    found
}
