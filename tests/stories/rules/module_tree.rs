//! The modules of a crate, as declared in its source text, and the modules that each of them uses.
//!
//! Paths are resolved like by the compiler, as far as a dependency rule needs: `crate::`, `self::`, `super::`, nested
//! `use` trees, renamed imports, re-exports, glob imports, inline modules, and modules in files of their own. Code
//! under `#[cfg(test)]` is ignored. Names of other crates are not resolved.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::source_reader::{self, Module, ModulePath};

/// The modules of one crate.
pub struct ModuleTree {
    modules: BTreeMap<ModulePath, Module>,
}

/// One reference from a module to another.
pub struct Use {
    pub from: ModulePath,
    pub to: ModulePath,
    /// The path in the source text.
    pub written: String,
}

impl ModuleTree {
    /// Reads the crate whose root is `root`; `read` returns the text of a file, or `None` if it does not exist.
    ///
    /// # Errors
    ///
    /// A file that is not Rust source, or a `mod name;` without a file.
    pub fn read(root: &Path, read: &dyn Fn(&Path) -> Option<String>) -> Result<Self, String> {
        Ok(Self {
            modules: source_reader::read(root, read)?,
        })
    }

    /// All references between modules of the crate, except those to the module itself.
    pub fn uses(&self) -> Vec<Use> {
        let mut uses = Vec::new();
        for (from, module) in &self.modules {
            let imported = module.imports.iter().map(|import| &import.path);
            for path in imported.chain(&module.paths) {
                let mut reached = BTreeSet::new();
                self.resolve(from, path, &mut reached, &mut BTreeSet::new());
                reached.remove(from);
                uses.extend(reached.into_iter().map(|to| Use {
                    from: from.clone(),
                    to,
                    written: path.join("::"),
                }));
            }
        }
        uses
    }

    /// The file of a module of this tree.
    pub fn file(&self, module: &ModulePath) -> &Path {
        &self.modules[module].file
    }

    /// Adds every module on the path `path`, as used in module `from`, including its end.
    fn resolve(
        &self,
        from: &ModulePath,
        path: &[String],
        reached: &mut BTreeSet<ModulePath>,
        seen: &mut BTreeSet<(ModulePath, Vec<String>)>,
    ) {
        let mut here = from.clone();
        let mut rest = path;
        while let Some((first, below)) = rest.split_first() {
            match first.as_str() {
                "crate" => here.clear(),
                "self" => {}
                "super" => {
                    here.pop();
                }
                _ => break,
            }
            rest = below;
        }
        self.descend(&here, rest, reached, seen);
    }

    fn descend(
        &self,
        here: &ModulePath,
        rest: &[String],
        reached: &mut BTreeSet<ModulePath>,
        seen: &mut BTreeSet<(ModulePath, Vec<String>)>,
    ) {
        if !seen.insert((here.clone(), rest.to_vec())) {
            return;
        }
        let module = &self.modules[here];
        reached.insert(here.clone());
        let Some((next, below)) = rest.split_first() else {
            return;
        };
        if module.children.contains(next) {
            let mut child = here.clone();
            child.push(next.clone());
            self.descend(&child, below, reached, seen);
            return;
        }
        if module.items.contains(next) {
            return;
        }
        let mut imported = false;
        for import in &module.imports {
            if import.name.as_ref() == Some(next) {
                imported = true;
                // `use name::name;`: the first of the two is another crate
                if import.path.first() != Some(next) {
                    let path = [&import.path[..], below].concat();
                    self.resolve(here, &path, reached, seen);
                }
            }
        }
        if imported {
            return;
        }
        for source in self.glob_sources(here, &mut BTreeSet::new()) {
            if self.declares(&source, next) {
                self.descend(&source, rest, reached, seen);
            }
        }
    }

    fn declares(&self, module: &ModulePath, name: &str) -> bool {
        let module = &self.modules[module];
        module.children.contains(name)
            || module.items.contains(name)
            || module
                .imports
                .iter()
                .any(|import| import.name.as_deref() == Some(name))
    }

    /// The modules whose names `module` imports by `*`, also through other globs.
    fn glob_sources(
        &self,
        module: &ModulePath,
        seen: &mut BTreeSet<ModulePath>,
    ) -> BTreeSet<ModulePath> {
        let mut sources = BTreeSet::new();
        if !seen.insert(module.clone()) {
            return sources;
        }
        for import in &self.modules[module].imports {
            if import.name.is_none()
                && let Some(source) = self.module_at(module, &import.path)
            {
                sources.extend(self.glob_sources(&source, seen));
                sources.insert(source);
            }
        }
        sources
    }

    /// The module named by a path, if it names one.
    fn module_at(&self, from: &ModulePath, path: &[String]) -> Option<ModulePath> {
        let mut here = from.clone();
        for name in path {
            match name.as_str() {
                "crate" => here.clear(),
                "self" => {}
                "super" => {
                    here.pop();
                }
                name if self.modules[&here].children.contains(name) => here.push(name.to_owned()),
                _ => return None,
            }
        }
        Some(here)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `from -> to` for every use in a crate of these files.
    fn uses(files: &[(&str, &str)]) -> BTreeSet<String> {
        let files: BTreeMap<&Path, &str> = files
            .iter()
            .map(|(path, text)| (Path::new(*path), *text))
            .collect();
        let read = |path: &Path| files.get(path).map(|text| (*text).to_owned());
        let tree = ModuleTree::read(Path::new("src/lib.rs"), &read).unwrap();
        tree.uses()
            .iter()
            .filter(|reference| !reference.to.is_empty())
            .map(|reference| {
                format!(
                    "{} -> {}",
                    reference.from.join("::"),
                    reference.to.join("::")
                )
            })
            .collect()
    }

    #[test]
    fn paths_lead_to_modules_in_every_spelling() {
        for written in [
            "use crate::b::X;",
            "use super::b::X;",
            "use super::{b::{self, X}, c};",
            "use super::b as other;",
            "fn f() { let x = crate::b::X::new(); }",
            "use super::*; fn f() { b::X; }",
            "fn f() { println!(\"{}\", super::b::X); }",
            "#[serde(with = \"super::b::seconds\")] struct S;",
            "pub(in crate::b) fn f() {}",
        ] {
            let found = uses(&[
                ("src/lib.rs", "mod a; mod b; mod c;"),
                ("src/a.rs", written),
                ("src/b.rs", "pub struct X;"),
                ("src/c/mod.rs", ""),
            ]);
            assert!(found.contains("a -> b"), "{written}: {found:?}");
        }
    }

    #[test]
    fn re_exports_lead_to_the_module_behind_them() {
        for root in [
            "pub use b::X;",
            "use b::X;",
            "pub use b::*;",
            "pub use b::Y as X;",
        ] {
            let root = format!("mod a; mod b; {root}");
            let found = uses(&[
                ("src/lib.rs", root.as_str()),
                ("src/a.rs", "fn f(x: super::X) {}"),
                ("src/b.rs", "pub struct X; pub struct Y;"),
            ]);
            assert!(found.contains("a -> b"), "{root}: {found:?}");
        }
    }

    #[test]
    fn what_names_no_module_is_no_use() {
        for written in [
            "use std::fmt; use other::b::X;",
            "use b::b; use b::b::X; use b;",
            "// super::b::X\n/// [`super::b::X`]\nstruct S;",
            "const TEXT: &str = \"super::b::X\";",
            "#[cfg(test)] mod tests { use super::super::b::X; }",
            "#[cfg(test)] use super::b::X; struct S;",
            "#[cfg(all(test, unix))] fn f() { super::b::X; } struct S;",
            "fn f(x: S) { x.b; x.b(); <S as T>::b; }",
        ] {
            let found = uses(&[
                ("src/lib.rs", "mod a; mod b;"),
                ("src/a.rs", written),
                ("src/b.rs", "pub struct X;"),
            ]);
            assert!(found.is_empty(), "{written}: {found:?}");
        }
    }

    #[test]
    fn inline_modules_and_files_below_them_are_read() {
        let found = uses(&[
            (
                "src/lib.rs",
                "mod a { mod inside; pub mod b { use super::inside::X; } }",
            ),
            ("src/a/inside.rs", "use super::super::a::b::Y;"),
        ]);
        assert!(found.contains("a::b -> a::inside"), "{found:?}");
        assert!(found.contains("a::inside -> a::b"), "{found:?}");
    }

    #[test]
    fn module_without_a_file_is_reported_with_its_name() {
        let read = |path: &Path| (path == Path::new("src/lib.rs")).then(|| "mod a;".to_owned());
        let error = ModuleTree::read(Path::new("src/lib.rs"), &read)
            .err()
            .unwrap();
        assert!(
            error.contains("src/lib.rs: mod a") && error.contains("src/a/mod.rs"),
            "{error}"
        );
    }
}
