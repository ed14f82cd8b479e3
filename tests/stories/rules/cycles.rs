//! Import cycles between sibling modules, at every level of a crate.

use std::collections::{BTreeMap, BTreeSet};

use super::module_tree::ModuleTree;
use super::source_reader::ModulePath;

/// Sibling modules that use each other, directly or indirectly.
pub struct Cycle {
    /// Their parent module; empty for the root of the crate.
    pub parent: ModulePath,
    pub members: BTreeSet<String>,
    /// For each pair (user, used): positions and texts of the uses.
    pub uses: BTreeMap<(String, String), BTreeSet<String>>,
}

/// All cycles of a crate. A reference from anywhere inside one sibling to anywhere inside another counts.
pub fn cycles(tree: &ModuleTree) -> Vec<Cycle> {
    type Uses = BTreeMap<(String, String), BTreeSet<String>>;
    let mut levels: BTreeMap<ModulePath, Uses> = BTreeMap::new();
    for reference in tree.uses() {
        let shared = reference
            .from
            .iter()
            .zip(&reference.to)
            .take_while(|(one, other)| one == other)
            .count();
        let (Some(user), Some(used)) = (reference.from.get(shared), reference.to.get(shared))
        else {
            continue;
        };
        let file = tree.file(&reference.from).display();
        levels
            .entry(reference.from[..shared].to_vec())
            .or_default()
            .entry((user.clone(), used.clone()))
            .or_default()
            .insert(format!("{file}: {}", reference.written));
    }
    let mut found = Vec::new();
    for (parent, uses) in levels {
        for members in components(uses.keys()) {
            let mut uses = uses.clone();
            uses.retain(|(user, used), _| members.contains(user) && members.contains(used));
            found.push(Cycle {
                parent: parent.clone(),
                members,
                uses,
            });
        }
    }
    found
}

/// Strongly connected components of more than one node.
fn components<'a>(edges: impl Iterator<Item = &'a (String, String)>) -> Vec<BTreeSet<String>> {
    let mut reach: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (from, to) in edges {
        reach.entry(from).or_default().insert(to);
    }
    loop {
        let mut grown = false;
        for node in reach.keys().copied().collect::<Vec<_>>() {
            let further: BTreeSet<&str> = reach[node]
                .iter()
                .filter_map(|next| reach.get(next))
                .flatten()
                .copied()
                .collect();
            if let Some(known) = reach.get_mut(node) {
                let before = known.len();
                known.extend(further);
                grown |= known.len() > before;
            }
        }
        if !grown {
            break;
        }
    }
    let mut found: Vec<BTreeSet<String>> = Vec::new();
    for (node, reached) in &reach {
        if !reached.contains(node) || found.iter().any(|members| members.contains(*node)) {
            continue;
        }
        let members = reached
            .iter()
            .filter(|other| reach.get(*other).is_some_and(|back| back.contains(node)))
            .map(ToString::to_string);
        found.push(members.collect());
    }
    found
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn cycles_of(files: &[(&str, &str)]) -> Vec<Cycle> {
        let read = |path: &Path| {
            files
                .iter()
                .find(|(name, _)| Path::new(name) == path)
                .map(|(_, text)| (*text).to_owned())
        };
        cycles(&ModuleTree::read(Path::new("src/lib.rs"), &read).unwrap())
    }

    #[test]
    fn cycle_of_three_files_is_found_with_its_uses() {
        let found = cycles_of(&[
            ("src/lib.rs", "mod a; mod b; mod c; mod d;"),
            ("src/a.rs", "use crate::b::f;"),
            ("src/b.rs", "mod inner;"),
            ("src/b/inner.rs", "use super::super::c;"),
            ("src/c.rs", "fn f() { crate::a::g() }"),
            ("src/d.rs", "use crate::a;"),
        ]);
        assert_eq!(found.len(), 1);
        assert!(found[0].parent.is_empty());
        assert_eq!(found[0].members, ["a", "b", "c"].map(str::to_owned).into());
        let uses = &found[0].uses[&("b".to_owned(), "c".to_owned())];
        assert!(uses.contains("src/b/inner.rs: super::super::c"), "{uses:?}");
    }

    #[test]
    fn cycle_below_the_root_is_found() {
        let found = cycles_of(&[
            ("src/lib.rs", "mod a;"),
            ("src/a/mod.rs", "mod one; mod two; pub use two::Two;"),
            ("src/a/one.rs", "use super::Two;"),
            ("src/a/two.rs", "use crate::a::one::One;"),
        ]);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].parent, ["a"]);
    }

    #[test]
    fn chain_without_return_is_no_cycle() {
        let found = cycles_of(&[
            ("src/lib.rs", "mod a; mod b; mod c;"),
            ("src/a.rs", "use crate::{b, c};"),
            ("src/b.rs", "use crate::c;"),
            ("src/c.rs", "fn f() { self::g() } fn g() {}"),
        ]);
        assert!(found.is_empty());
    }
}
