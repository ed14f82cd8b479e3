//! Rules of ARCHITECTURE.md that the compiler does not check: permitted dependencies, no import cycles, small folders,
//! descriptive names. Code that violated a rule when it was written is listed as an exception; a list may only shrink.
//!
//! - **dependencies**: the table of dependencies, and packages that no crate or no workspace member may name
//! - **modules**: import cycles and folder sizes; `source_reader`, `module_tree` and `cycles` find them
//! - **map**: ARCHITECTURE.md's map lists the folders of the tree
//! - **test_names**: names of tests have at most 60 characters
//! - **words**: model names, forbidden names, unfinished code, paths of a machine

mod cycles;
mod dependencies;
mod map;
mod module_tree;
mod modules;
mod source_reader;
mod test_names;
mod words;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use cargo_metadata::{Metadata, MetadataCommand, Package};

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

fn metadata() -> Metadata {
    MetadataCommand::new()
        .manifest_path(root().join("Cargo.toml"))
        .no_deps()
        .exec()
        .expect("cargo runs this test, so it can describe the workspace")
}

/// A package's name without the common prefix of the workspace.
fn short(package: &str) -> &str {
    package.strip_prefix("tactus-").unwrap_or(package)
}

/// The packages of the workspace by their short names.
fn crates(metadata: &Metadata) -> BTreeMap<&str, &Package> {
    metadata
        .workspace_packages()
        .into_iter()
        .map(|package| (short(&package.name), package))
        .collect()
}

fn folder(package: &Package) -> &Path {
    package
        .manifest_path
        .parent()
        .expect("a manifest lies in a folder")
        .as_std_path()
}

/// Every Rust file below a folder, except `target`.
fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let Ok(entries) = std::fs::read_dir(folder) else {
        return found;
    };
    for path in entries.filter_map(|entry| entry.ok().map(|entry| entry.path())) {
        if path.is_dir() && !path.ends_with("target") {
            found.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
    found.sort();
    found
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path)
        .unwrap_or_else(|error| panic!("{}: cannot be read: {error}", path.display()))
}

/// A path relative to the root of the workspace, with `/` as separator.
fn from_root(path: &Path) -> String {
    let root = root().canonicalize().expect("the workspace has a folder");
    let path = path.canonicalize().expect("the file was just listed");
    path.strip_prefix(&root)
        .unwrap_or(&path)
        .display()
        .to_string()
}

/// Compares violations of a rule with the listed exceptions: both must be equal.
fn only_exceptions<T: Ord + std::fmt::Debug>(
    rule: &str,
    found: impl IntoIterator<Item = T>,
    exceptions: impl IntoIterator<Item = T>,
) {
    let found: std::collections::BTreeSet<T> = found.into_iter().collect();
    let exceptions: std::collections::BTreeSet<T> = exceptions.into_iter().collect();
    let new: Vec<_> = found.difference(&exceptions).collect();
    let gone: Vec<_> = exceptions.difference(&found).collect();
    assert!(new.is_empty(), "{rule}; these are new: {new:#?}");
    assert!(
        gone.is_empty(),
        "{rule}; these exceptions hold no longer, delete them from the list: {gone:#?}"
    );
}
