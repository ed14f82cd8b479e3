//! No import cycle between sibling modules, and at most twelve files side by side.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::cycles::{Cycle, cycles};
use super::module_tree::ModuleTree;
use super::{crates, folder, from_root, metadata, only_exceptions, rust_files};

/// Known cycles: the crate, the module in which the siblings lie, the siblings. A cycle may lose members; when it is
/// gone, its line goes too.
const KNOWN_CYCLES: &[(&str, &str, &[&str])] = &[(
    "phantom",
    "",
    &[
        "effects", "history", "law", "press", "preview", "scan", "scene", "sheet",
    ],
)];

/// Folders with more than twelve Rust files side by side. A catalogue of like things may stay.
const LARGE_FOLDERS: &[&str] = &[
    // the catalogue of effects, one file an effect
    "tomography/phantom/src/effects",
];

/// All cycles of the library and the programs of each crate.
fn cycles_by_crate() -> Vec<(String, Cycle)> {
    let metadata = metadata();
    let mut found = Vec::new();
    for (name, package) in crates(&metadata) {
        for target in &package.targets {
            if !(target.is_lib() || target.is_bin()) {
                continue;
            }
            let read = |path: &Path| std::fs::read_to_string(path).ok();
            let tree = ModuleTree::read(target.src_path.as_std_path(), &read)
                .unwrap_or_else(|error| panic!("{error}"));
            found.extend(
                cycles(&tree)
                    .into_iter()
                    .map(|cycle| (name.to_owned(), cycle)),
            );
        }
    }
    found
}

fn describe(name: &str, cycle: &Cycle) -> String {
    let members: Vec<String> = cycle
        .members
        .iter()
        .map(|name| format!("{name:?}"))
        .collect();
    let parent = cycle.parent.join("::");
    let mut text = format!("({name:?}, {parent:?}, &[{}]),\n", members.join(", "));
    for ((user, used), written) in &cycle.uses {
        text += &format!("    // {user} uses {used}:\n");
        // the imports; names that they bring into scope would repeat them
        let is_import = |path: &str| path.contains("crate::") || path.contains("super::");
        let imports = written.iter().filter(|path| is_import(path));
        let shown: Vec<&String> = match imports.count() {
            0 => written.iter().collect(),
            _ => written.iter().filter(|path| is_import(path)).collect(),
        };
        for path in shown {
            let (file, path) = path.split_once(": ").unwrap_or_default();
            text += &format!("    //   {}: {path}\n", from_root(Path::new(file)));
        }
    }
    text
}

#[test]
fn modules_have_no_import_cycles() {
    let found = cycles_by_crate();
    let mut remaining: BTreeSet<_> = KNOWN_CYCLES.iter().collect();
    let mut new = Vec::new();
    for (name, cycle) in &found {
        let known = KNOWN_CYCLES.iter().find(|(known, parent, members)| {
            known == name
                && *parent == cycle.parent.join("::")
                && cycle
                    .members
                    .iter()
                    .all(|member| members.contains(&member.as_str()))
        });
        match known {
            Some(known) => {
                remaining.remove(known);
            }
            None => new.push(describe(name, cycle)),
        }
    }
    println!("{} import cycles", found.len());
    assert!(
        new.is_empty(),
        "sibling modules must not use each other in a cycle; new:\n{}",
        new.join("\n")
    );
    assert!(
        remaining.is_empty(),
        "these cycles are gone, delete them from the list: {remaining:#?}"
    );
}

#[test]
fn folders_have_at_most_twelve_files() {
    let metadata = metadata();
    let mut sizes: BTreeMap<String, usize> = BTreeMap::new();
    for package in crates(&metadata).values() {
        for path in rust_files(folder(package)) {
            let folder = path.parent().expect("a file lies in a folder");
            *sizes.entry(from_root(folder)).or_default() += 1;
        }
    }
    let large = sizes.into_iter().filter(|(_, size)| *size > 12);
    only_exceptions(
        "a folder has at most twelve Rust files",
        large.map(|(folder, _)| folder),
        LARGE_FOLDERS.iter().map(ToString::to_string),
    );
}
