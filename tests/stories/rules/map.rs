//! The map of ARCHITECTURE.md lists the folders of the tree.

use std::collections::BTreeSet;
use std::path::Path;

use super::{crates, folder, from_root, metadata, root, text};

/// The folders in the first column of the tables of a section, without their last `/`.
fn folders_in_map(page: &str, begin: &str, end: &str) -> BTreeSet<String> {
    let (_, section) = page
        .split_once(begin)
        .unwrap_or_else(|| panic!("ARCHITECTURE.md has no `{begin}`"));
    let (section, _) = section
        .split_once(end)
        .unwrap_or_else(|| panic!("ARCHITECTURE.md has no `{end}` after `{begin}`"));
    section
        .lines()
        .filter_map(|line| line.strip_prefix("| `")?.split_once("/` |"))
        .map(|(folder, _)| folder.to_owned())
        .collect()
}

/// The folders directly inside of one, except those ignored by git.
fn folders_in(folder: &Path) -> BTreeSet<String> {
    std::fs::read_dir(folder)
        .expect("a folder of the project can be read")
        .filter_map(|entry| {
            let path = entry.expect("a folder of the project can be read").path();
            let name = path.file_name()?.to_string_lossy().into_owned();
            let hidden = name.starts_with('.') || name == "target" || name == "shared";
            (path.is_dir() && !hidden).then_some(name)
        })
        .collect()
}

fn compare(map: &BTreeSet<String>, tree: &BTreeSet<String>) {
    let missing: Vec<_> = tree.difference(map).collect();
    let gone: Vec<_> = map.difference(tree).collect();
    assert!(
        missing.is_empty() && gone.is_empty(),
        "the map of ARCHITECTURE.md lacks {missing:?} and names {gone:?}, which the tree does not have"
    );
}

#[test]
fn map_has_every_crate_and_folder_at_the_top() {
    let page = text(&root().join("ARCHITECTURE.md"));
    let map = folders_in_map(&page, "## Map", "The daemon, by folder");
    let metadata = metadata();
    let mut tree: BTreeSet<String> = crates(&metadata)
        .values()
        .map(|package| from_root(folder(package)))
        .collect();
    // folders that only contain crates are not in the map
    let groups: BTreeSet<String> = tree
        .iter()
        .filter_map(|path| Some(path.split_once('/')?.0.to_owned()))
        .collect();
    tree.extend(
        folders_in(root())
            .into_iter()
            .filter(|name| !groups.contains(name)),
    );
    compare(&map, &tree);
}

#[test]
fn map_has_every_folder_of_the_daemon() {
    let page = text(&root().join("ARCHITECTURE.md"));
    let map = folders_in_map(&page, "The daemon, by folder", "## Dependency rules");
    compare(&map, &folders_in(&root().join("daemon/src")));
}
