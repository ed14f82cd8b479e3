//! No import cycle between sibling modules, and at most twelve files per folder.

use std::collections::BTreeMap;
use std::path::Path;

use super::cycles::{Cycle, cycles};
use super::module_tree::ModuleTree;
use super::{crates, folder, from_root, metadata, only_exceptions, rust_files};

/// Folders with more than twelve Rust files. A catalogue of similar items may stay.
const LARGE_FOLDERS: &[&str] = &[
    // the catalogue of effects, one file per effect
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
        // show imports only, because uses of the imported names would repeat them
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
    let found: Vec<String> = cycles_by_crate()
        .iter()
        .map(|(name, cycle)| describe(name, cycle))
        .collect();
    assert!(
        found.is_empty(),
        "sibling modules must not use each other in a cycle:\n{}",
        found.join("\n")
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
