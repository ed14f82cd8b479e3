//! The `cargo` commands in pages, comments and scripts name existing packages, tests, examples and programs.

use std::collections::BTreeMap;

use cargo_metadata::{MetadataCommand, Package, Target};

use super::pages::{self, Page, root};

/// Files with commands whose extensions are not those of pages or sources.
const SCRIPTS: &[&str] = &[
    ".cargo/config.toml",
    ".ci/run",
    ".ci/long",
    "justfile",
    "systemd/package",
];

/// The names in one command, each with its position.
#[derive(Default)]
struct Named {
    packages: Vec<String>,
    /// Kind of target, in cargo's terms, and its name.
    targets: Vec<(&'static str, String)>,
    /// Filters of test names.
    filters: Vec<String>,
}

/// The arguments of the `cargo` commands in a text, one entry per command.
fn commands(text: &str) -> impl Iterator<Item = (usize, Vec<&str>)> {
    text.lines().enumerate().flat_map(|(index, line)| {
        let alias = line
            .split_once(" = \"")
            .filter(|(name, _)| !name.contains(' '))
            .map(|(_, command)| command);
        let started = line
            .match_indices("cargo ")
            .map(|(at, found)| &line[at + found.len()..]);
        let ends = |letter: char| "`;|&)\"'".contains(letter);
        alias
            .into_iter()
            .chain(started)
            .map(move |rest| rest.split(ends).next().unwrap_or_default())
            .map(move |command| (index + 1, command.split_whitespace().collect::<Vec<_>>()))
            .filter(|(_, words)| {
                let command = words.iter().find(|word| !word.starts_with('-'));
                command.is_some_and(|command| {
                    ["run", "test", "build", "check", "deb", "package"].contains(command)
                })
            })
    })
}

fn named(words: &[&str]) -> Named {
    let mut named = Named::default();
    let is_test = words.contains(&"test");
    let mut words = words.iter().take_while(|word| **word != "--").skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().map(|word| (*word).to_owned());
        match *word {
            "-p" | "--package" => named.packages.extend(value()),
            "--test" => named.targets.extend(value().map(|name| ("test", name))),
            "--example" => named.targets.extend(value().map(|name| ("example", name))),
            "--bin" => named.targets.extend(value().map(|name| ("bin", name))),
            "--features" | "--target-dir" => drop(value()),
            filter if is_test && filter.starts_with(|letter: char| letter.is_ascii_lowercase()) => {
                named.filters.push(filter.to_owned());
            }
            _ => {}
        }
    }
    // placeholders in a page, such as NAME
    let is_name = |name: &String| {
        !name.starts_with(|letter: char| letter.is_ascii_uppercase() || letter == '$')
    };
    named.packages.retain(is_name);
    named.targets.retain(|(_, name)| is_name(name));
    named
}

/// Whether a function or a module in these sources has a name that contains the filter.
fn chooses(sources: &[Page], folders: &[String], filter: &str) -> bool {
    let part = filter
        .trim_end_matches("...")
        .rsplit("::")
        .find(|part| !part.is_empty());
    let Some(part) = part else {
        return true;
    };
    sources
        .iter()
        .filter(|source| folders.iter().any(|folder| source.path.starts_with(folder)))
        .any(|source| {
            source.path.contains(part)
                || source.text.lines().any(|line| {
                    line.split_once("fn ")
                        .or_else(|| line.split_once("mod "))
                        .is_some_and(|(_, name)| {
                            let end = name.find(['(', '<', ' ', ';']).unwrap_or(name.len());
                            name[..end].contains(part)
                        })
                })
        })
}

fn is_kind(target: &Target, kind: &str) -> bool {
    target.kind.iter().any(|found| found.to_string() == kind)
}

#[test]
fn cargo_commands_name_what_exists() {
    let metadata = MetadataCommand::new()
        .manifest_path(root().join("Cargo.toml"))
        .no_deps()
        .exec()
        .expect("cargo runs this test, so it can describe the workspace");
    let packages: BTreeMap<&str, &Package> = metadata
        .workspace_packages()
        .into_iter()
        .map(|package| (package.name.as_str(), package))
        .collect();
    let sources = pages::files("rs");
    let mut texts = pages::files("md");
    for script in SCRIPTS {
        texts.push(Page {
            path: (*script).to_owned(),
            text: std::fs::read_to_string(root().join(script))
                .unwrap_or_else(|error| panic!("{script}: {error}")),
        });
    }
    // its commands are those of old versions and of separate fuzz workspaces
    texts.retain(|page| page.path != "CHANGELOG.md");
    let mut checked = 0;
    let mut wrong = Vec::new();
    for page in texts.iter().chain(&sources) {
        for (line, words) in commands(&page.text) {
            let named = named(&words);
            let place = format!("{}:{line}: cargo {}", page.path, words.join(" "));
            checked += named.packages.len() + named.targets.len();
            let chosen: Vec<&&Package> = match named.packages.as_slice() {
                [] => packages.values().collect(),
                names => names
                    .iter()
                    .filter_map(|name| packages.get(name.as_str()))
                    .collect(),
            };
            for name in &named.packages {
                if !packages.contains_key(name.as_str()) {
                    wrong.push(format!("{place}\n    no package {name}"));
                }
            }
            let targets: Vec<&Target> =
                chosen.iter().flat_map(|package| &package.targets).collect();
            for (kind, name) in &named.targets {
                let exists = targets
                    .iter()
                    .any(|target| is_kind(target, kind) && target.name == *name);
                if !exists {
                    wrong.push(format!("{place}\n    no {kind} {name}"));
                }
            }
            let folders: Vec<String> = chosen
                .iter()
                .filter_map(|package| package.manifest_path.parent())
                .filter_map(|folder| folder.strip_prefix(&metadata.workspace_root).ok())
                .map(|folder| format!("{folder}/"))
                .collect();
            for filter in &named.filters {
                if !chooses(&sources, &folders, filter) {
                    wrong.push(format!("{place}\n    no test whose name has `{filter}`"));
                }
            }
        }
    }
    println!("{checked} names of packages and targets checked");
    assert!(checked > 100, "only {checked} names were found");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
