//! Permitted dependencies between crates, checked by `cargo metadata`. Development dependencies follow the same table.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use cargo_metadata::{DependencyKind, Package};

use super::{crates, folder, from_root, metadata, only_exceptions, root, rust_files, short, text};

/// Stands for every driver of an instrument: a package of `drivers/` that has a simulator.
const DRIVER: &str = "driver of an instrument";

/// The table of ARCHITECTURE.md. A crate may use fewer crates, never more. `tests` may use anything.
const MAY_USE: &[(&str, &[&str])] = &[
    ("survey", &[]),
    ("alarms", &[]),
    ("scpi", &[]),
    ("vxi11", &[]),
    ("dbus", &[]),
    ("outfile", &[]),
    ("help-examples", &[]),
    ("what-tests-need", &[]),
    ("http-listener", &[]),
    ("render", &["outfile", "survey"]),
    ("logbook", &["outfile", "survey"]),
    ("eit", &["outfile", "survey"]),
    ("drift", &["eit", "survey"]),
    ("phantom", &["eit", "outfile", "survey"]),
    ("imaging", &["drift", "eit", "logbook", "outfile", "survey"]),
    ("shards", &["outfile"]),
    (
        "training",
        &["eit", "outfile", "phantom", "shards", "survey"],
    ),
    ("rig", &["outfile", "scpi", "survey"]),
    (DRIVER, &["rig", "scpi", "survey"]),
    ("self-test", &["eit", "rig", "survey"]),
    ("config", &["alarms", "imaging", "survey"]),
    (
        "simulator",
        &[
            DRIVER,
            "help-examples",
            "http-listener",
            "outfile",
            "phantom",
            "rig",
            "scpi",
            "survey",
            "vxi11",
        ],
    ),
    (
        "studies",
        &[
            "drift",
            "eit",
            "gpio-mux",
            "imaging",
            "keithley-6221",
            "keysight-34980a",
            "outfile",
            "phantom",
            "render",
            "shards",
            "simulator",
            "survey",
            "training",
        ],
    ),
    (
        "lab",
        &[
            "config",
            "eit",
            "gpio-mux",
            "help-examples",
            "imaging",
            "keithley-6221",
            "keysight-34980a",
            "logbook",
            "outfile",
            "phantom",
            "render",
            "shards",
            "simulator",
            "studies",
            "survey",
            "training",
        ],
    ),
    (
        "daemon",
        &[
            "alarms",
            "config",
            "dbus",
            DRIVER,
            "eit",
            "help-examples",
            "http-listener",
            "imaging",
            "logbook",
            "outfile",
            "rig",
            "self-test",
            "simulator",
            "survey",
            "vxi11",
        ],
    ),
    (
        "cli",
        &[
            "archive",
            "config",
            "dbus",
            "eit",
            "help-examples",
            "imaging",
            "logbook",
            "outfile",
            "render",
            "survey",
            "web",
        ],
    ),
    (
        "web",
        &[
            "archive", "config", "dbus", "eit", "imaging", "logbook", "outfile", "render", "survey",
        ],
    ),
    (
        "archive",
        &[
            "config",
            "dbus",
            "help-examples",
            "imaging",
            "logbook",
            "outfile",
            "survey",
        ],
    ),
    (
        "demo",
        &["cli", "daemon", "eit", "phantom", "render", "simulator"],
    ),
];

/// Dependencies beyond the table, as `crate -> crate`.
const EXCEPTIONS: &[&str] = &[
    "demo -> dbus",
    "demo -> logbook",
    "demo -> outfile",
    "demo -> survey",
];

fn used_by(package: &Package) -> BTreeSet<&str> {
    package
        .dependencies
        .iter()
        .map(|dependency| short(&dependency.name))
        .collect()
}

fn is_driver(package: &Package) -> bool {
    let simulated = package.features.contains_key("simulator");
    simulated && from_root(folder(package)).starts_with("drivers/")
}

/// Whether a package uses `what-tests-need` as a development dependency only.
fn only_for_tests(package: &Package) -> bool {
    package
        .dependencies
        .iter()
        .filter(|dependency| short(&dependency.name) == "what-tests-need")
        .all(|dependency| dependency.kind == DependencyKind::Development)
}

#[test]
fn crates_depend_only_on_those_in_the_table() {
    let metadata = metadata();
    let crates = crates(&metadata);
    let allowed: BTreeMap<_, _> = MAY_USE.iter().copied().collect();
    let mut found = Vec::new();
    for (name, package) in &crates {
        if *name == "tests" {
            continue;
        }
        let row = if is_driver(package) { DRIVER } else { name };
        let allowed = allowed
            .get(row)
            .unwrap_or_else(|| panic!("crate '{name}' has no row in the table of dependencies"));
        for used in used_by(package) {
            let Some(used_package) = crates.get(used) else {
                continue;
            };
            let tests_only = used == "what-tests-need" && only_for_tests(package);
            let driver = is_driver(used_package) && allowed.contains(&DRIVER);
            if used != *name && !allowed.contains(&used) && !driver && !tests_only {
                found.push(format!("{name} -> {used}"));
            }
        }
    }
    only_exceptions(
        "a crate depends only on those that the table of dependencies allows",
        found,
        EXCEPTIONS.iter().map(ToString::to_string),
    );
}

/// The Python package lies outside of the workspace.
#[test]
fn python_package_depends_only_on_its_five() {
    let manifest: toml::Table = text(&root().join("python/Cargo.toml"))
        .parse()
        .expect("a manifest is TOML");
    let dependencies = manifest["dependencies"].as_table().expect("a table");
    let ours: BTreeSet<&str> = dependencies
        .iter()
        .filter(|(_, how)| how.get("path").is_some())
        .map(|(name, _)| name.as_str())
        .collect();
    let allowed = ["dbus", "eit", "imaging", "logbook", "survey"];
    assert_eq!(ours, BTreeSet::from(allowed));
}

#[test]
fn service_links_neither_lab_nor_training_nor_studies() {
    let allowed: BTreeMap<_, _> = MAY_USE.iter().copied().collect();
    let mut reached = BTreeSet::new();
    let mut open = vec!["daemon", "cli", "web", "archive", "simulator"];
    while let Some(name) = open.pop() {
        if reached.insert(name) {
            open.extend(allowed.get(name).copied().unwrap_or_default());
        }
    }
    for offline in ["lab", "training", "studies", "shards"] {
        assert!(
            !reached.contains(offline),
            "the table lets the service link {offline}"
        );
    }
}

#[test]
fn mathematics_uses_no_clock_no_runtime_no_bus() {
    let metadata = metadata();
    let crates = crates(&metadata);
    let mathematics = [
        "survey", "scpi", "eit", "drift", "phantom", "render", "imaging", "training",
    ];
    for name in mathematics {
        let package = crates[name];
        let used = used_by(package);
        for service in ["tokio", "zbus", "tokio-serial", "mdns-sd"] {
            assert!(!used.contains(service), "{name} depends on {service}");
        }
        for path in rust_files(&folder(package).join("src")) {
            let text = text(&path);
            for clock in ["Instant::now", "SystemTime::now", "Utc::now", "Local::now"] {
                assert!(
                    !text.contains(clock),
                    "{}: reads a clock ({clock})",
                    path.display()
                );
            }
        }
    }
}

#[test]
fn nine_packages_named_by_the_user_are_used() {
    let metadata = metadata();
    let crates = crates(&metadata);
    // each with the crate that uses it, and a word from its use
    for (package, user, word) in [
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
        let depends = crates[user].dependencies.iter().any(|dependency| {
            short(&dependency.name) == package && dependency.kind == DependencyKind::Normal
        });
        assert!(depends, "{user} does not depend on {package}");
        let files = rust_files(&folder(crates[user]).join("src"));
        assert!(
            files.iter().any(|path| text(path).contains(word)),
            "{user} depends on {package} but never names '{word}'"
        );
    }
}

/// Crates that could be published: useful without the rest, for other instruments or phantoms.
const PUBLISHABLE: &[&str] = &[
    "dbus",
    "eit",
    "gpio-mux",
    "keithley-6221",
    "keysight-34980a",
    "outfile",
    "rig",
    "scpi",
    "survey",
];

#[test]
fn publishable_crates_are_complete_and_packaged() {
    let metadata = metadata();
    let check = text(&root().join(".ci/run"));
    for (name, package) in crates(&metadata) {
        let publishable = PUBLISHABLE.contains(&name);
        // `publish = false` is an empty list of registries
        assert_eq!(
            package.publish.is_none(),
            publishable,
            "{name}: `publish` in its manifest and the list of publishable crates disagree"
        );
        if !publishable {
            continue;
        }
        for (field, given) in [
            ("description", package.description.is_some()),
            ("license", package.license.is_some()),
            ("readme", package.readme.is_some()),
            ("keywords", !package.keywords.is_empty()),
            ("categories", !package.categories.is_empty()),
        ] {
            assert!(given, "{name}: its manifest has no {field}");
        }
        for dependency in &package.dependencies {
            let used = short(&dependency.name);
            let ours = dependency.path.is_some() && dependency.kind != DependencyKind::Development;
            assert!(
                !ours || PUBLISHABLE.contains(&used),
                "{name} depends on {used}, which could not be published"
            );
        }
        assert!(
            check.contains(&format!("-p {}", package.name)),
            ".ci/run does not package {}",
            package.name
        );
    }
}

/// Packages that their crate does not use, as `crate: package`: see [`nothing_of_the_tests_is_built_again`].
const UNUSED: &[&str] = &[
    "demo: cc",
    "demo: digest",
    "demo: futures_util",
    "demo: half",
    "demo: outfile",
    "demo: rand",
    "demo: regex_syntax",
    "demo: syn",
];

/// What `cargo test --workspace` selects.
const TESTS: [&str; 3] = ["--workspace", "--edges", "normal,build,dev"];

/// The packages that cargo builds for a selection, each with its sets of features: more than one if build scripts use
/// other features.
type Built = BTreeMap<String, BTreeSet<String>>;

/// Runs `cargo tree`; the error is that of cargo, for example for a package that was never downloaded.
fn built(selection: &[&str]) -> Result<Built, String> {
    let output = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .args(["tree", "--locked", "--offline", "--prefix", "none"])
        .args(["--format", "{p} with {f}", "--manifest-path"])
        .arg(root().join("Cargo.toml"))
        .args(selection)
        .output()
        .expect("cargo runs this test");
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned());
    }
    let mut built = Built::new();
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        // `(*)` marks a package whose dependencies have been listed before
        let line = line.trim_end_matches(" (*)");
        if let Some((package, features)) = line.split_once(" with ") {
            let known = built.entry(package.to_owned()).or_default();
            known.insert(features.to_owned());
        }
    }
    Ok(built)
}

/// Cargo builds a package with other features once more, and everything that uses it: this takes minutes for numerical
/// crates.
fn nothing_of_the_tests_is_built_again(by: &Built) {
    let tests = built(&TESTS).expect("cargo has built these tests");
    let again = by.iter().filter(|(package, features)| {
        let other = |known: &BTreeSet<String>| !features.is_subset(known);
        // tactus-cli differs intentionally: the demo has no archive, the tests have no Parquet
        tests.get(*package).is_some_and(other) && !package.starts_with("tactus-cli ")
    });
    let again: Vec<_> = again.collect();
    assert!(again.is_empty(), "features in demo/Cargo.toml: {again:#?}");
}

#[test]
fn demo_and_tests_build_their_dependencies_once() {
    let demo = built(&["--package", "tactus-demo", "--edges", "normal,build"]);
    nothing_of_the_tests_is_built_again(&demo.expect("a part of the workspace"));
}

#[test]
fn parquet_builds_no_dependency_of_the_tests_again() {
    match built(&[&TESTS[..], &["--features", "tactus-cli/parquet"]].concat()) {
        Ok(parquet) => nothing_of_the_tests_is_built_again(&parquet),
        Err(why) => needs::lacking(
            "PARQUET",
            &format!("cargo tree --workspace --features tactus-cli/parquet downloads it: {why}"),
        ),
    }
}

#[test]
fn every_dependency_is_named_in_its_crate() {
    let metadata = metadata();
    let mut unused = Vec::new();
    for (name, package) in crates(&metadata) {
        let source: String = rust_files(folder(package))
            .iter()
            .filter(|path| !path.components().any(|part| part.as_os_str() == "fuzz"))
            .map(|path| text(path))
            .collect();
        for dependency in &package.dependencies {
            let known_as = dependency.rename.as_ref().unwrap_or(&dependency.name);
            let library = short(known_as).replace('-', "_");
            // `zbus = { features = ["tokio"] }` needs no other use: the name in any path or macro call is enough
            let named = ["::", "!", " as ", ";", ","]
                .iter()
                .any(|after| contains_word(&source, &library, after));
            if !named {
                unused.push(format!("{name}: {library}"));
            }
        }
    }
    only_exceptions(
        "every dependency of a crate is used in it",
        unused,
        UNUSED.iter().map(ToString::to_string),
    );
}

/// Whether the text contains `word` at the beginning of a name, followed by `after`.
fn contains_word(text: &str, word: &str, after: &str) -> bool {
    text.match_indices(&format!("{word}{after}"))
        .any(|(at, _)| {
            !text[..at]
                .chars()
                .next_back()
                .is_some_and(|before| before.is_alphanumeric() || before == '_')
        })
}
