//! Declarations, imports and names in the source text of each module of a crate.
//!
//! Text is parsed to tokens, so comments and strings are ignored. So is code under `#[cfg(test)]`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use proc_macro2::{Delimiter, TokenStream, TokenTree};

/// The path of a module from the root of its crate; empty for the root.
pub type ModulePath = Vec<String>;

/// Declarations and names in the text of one module.
#[derive(Default)]
pub struct Module {
    /// The module's file.
    pub file: PathBuf,
    pub children: BTreeSet<String>,
    pub items: BTreeSet<String>,
    pub imports: Vec<Import>,
    pub paths: BTreeSet<Vec<String>>,
}

/// One leaf of a `use` tree.
pub struct Import {
    pub path: Vec<String>,
    /// The name it brings into scope; `None` for `*`.
    pub name: Option<String>,
}

const ITEM_KEYWORDS: &[&str] = &[
    "fn", "struct", "enum", "union", "trait", "type", "const", "static",
];

/// Reads the crate whose root is the file `root`; `read` returns the text of a file, or `None` if it does not exist.
///
/// # Errors
///
/// A file that is not Rust source, or a `mod name;` without a file.
pub fn read(
    root: &Path,
    read: &dyn Fn(&Path) -> Option<String>,
) -> Result<BTreeMap<ModulePath, Module>, String> {
    let folder = root.parent().unwrap_or(Path::new("")).to_owned();
    let mut reader = Reader {
        read,
        modules: BTreeMap::new(),
    };
    reader.file(root, &folder, Vec::new())?;
    Ok(reader.modules)
}

struct Reader<'a> {
    read: &'a dyn Fn(&Path) -> Option<String>,
    modules: BTreeMap<ModulePath, Module>,
}

impl Reader<'_> {
    /// Reads the module `module` from `file`; its child modules are in `folder`.
    fn file(&mut self, file: &Path, folder: &Path, module: ModulePath) -> Result<(), String> {
        let text = (self.read)(file).ok_or(format!("{}: there is no such file", file.display()))?;
        let tokens: TokenStream = text
            .parse()
            .map_err(|error| format!("{}: {error}", file.display()))?;
        self.modules.insert(
            module.clone(),
            Module {
                file: file.to_owned(),
                ..Module::default()
            },
        );
        self.tokens(tokens, file, folder, &module, true)
    }

    /// Reads the tokens of a module; `top` if they are its items and not the inside of one.
    fn tokens(
        &mut self,
        tokens: TokenStream,
        file: &Path,
        folder: &Path,
        module: &ModulePath,
        top: bool,
    ) -> Result<(), String> {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let mut at = 0;
        while at < tokens.len() {
            match &tokens[at] {
                TokenTree::Punct(punct) if punct.as_char() == '#' => {
                    let after = at + 1 + usize::from(is_punct(tokens.get(at + 1), '!'));
                    let Some(attribute) = bracketed(tokens.get(after)) else {
                        at += 1;
                        continue;
                    };
                    at = after + 1;
                    if is_test_only(&attribute) {
                        at = end_of_item(&tokens, at);
                    } else {
                        for path in paths_in_strings(&attribute) {
                            self.module(module).paths.insert(path);
                        }
                    }
                }
                TokenTree::Ident(word) if word == "use" && !is_punct(tokens.get(at + 1), '<') => {
                    let end = (at..tokens.len())
                        .find(|&end| is_punct(tokens.get(end), ';'))
                        .unwrap_or(tokens.len());
                    let mut imports = Vec::new();
                    use_tree(&tokens[at + 1..end], Vec::new(), &mut imports);
                    self.module(module).imports.extend(imports);
                    at = end;
                }
                TokenTree::Ident(word) if word == "mod" => {
                    at = self.child(&tokens, at, file, folder, module)?;
                }
                TokenTree::Ident(word) => {
                    let word = word.to_string();
                    if top && ITEM_KEYWORDS.contains(&word.as_str()) {
                        if let Some(TokenTree::Ident(name)) = tokens.get(at + 1) {
                            self.module(module).items.insert(name.to_string());
                        }
                        at += 1;
                    } else if word == "macro_rules" && is_punct(tokens.get(at + 1), '!') {
                        if let Some(TokenTree::Ident(name)) = tokens.get(at + 2) {
                            self.module(module).items.insert(name.to_string());
                        }
                        at += 3;
                    } else {
                        let (path, end) = path_from(&tokens, at);
                        if is_path_head(&tokens, at) {
                            self.module(module).paths.insert(path);
                        }
                        at = end;
                    }
                }
                TokenTree::Group(group) => {
                    self.tokens(group.stream(), file, folder, module, false)?;
                    at += 1;
                }
                _ => at += 1,
            }
        }
        Ok(())
    }

    /// Reads `mod name;` or `mod name { .. }` at `at` and returns the position after it.
    fn child(
        &mut self,
        tokens: &[TokenTree],
        at: usize,
        file: &Path,
        folder: &Path,
        module: &ModulePath,
    ) -> Result<usize, String> {
        let Some(TokenTree::Ident(name)) = tokens.get(at + 1) else {
            return Ok(at + 1);
        };
        let name = name.to_string();
        let mut child = module.clone();
        child.push(name.clone());
        let below = folder.join(&name);
        match tokens.get(at + 2) {
            Some(TokenTree::Group(body)) if body.delimiter() == Delimiter::Brace => {
                self.module(module).children.insert(name);
                self.modules.insert(
                    child.clone(),
                    Module {
                        file: file.to_owned(),
                        ..Module::default()
                    },
                );
                self.tokens(body.stream(), file, &below, &child, true)?;
            }
            Some(TokenTree::Punct(end)) if end.as_char() == ';' => {
                self.module(module).children.insert(name.clone());
                let beside = folder.join(format!("{name}.rs"));
                let inside = below.join("mod.rs");
                let path = if (self.read)(&beside).is_some() {
                    beside
                } else {
                    inside
                };
                self.file(&path, &below, child)
                    .map_err(|error| format!("{}: mod {name}: {error}", file.display()))?;
            }
            _ => return Ok(at + 2),
        }
        Ok(at + 3)
    }

    fn module(&mut self, path: &ModulePath) -> &mut Module {
        self.modules.entry(path.clone()).or_default()
    }
}

fn is_punct(token: Option<&TokenTree>, wanted: char) -> bool {
    matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == wanted)
}

fn bracketed(token: Option<&TokenTree>) -> Option<Vec<TokenTree>> {
    match token {
        Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Bracket => {
            Some(group.stream().into_iter().collect())
        }
        _ => None,
    }
}

/// Whether an attribute is `cfg(test)`, or `cfg(all(.., test, ..))`.
fn is_test_only(attribute: &[TokenTree]) -> bool {
    fn requires_test(condition: TokenStream) -> bool {
        let tokens: Vec<TokenTree> = condition.into_iter().collect();
        tokens.iter().enumerate().any(|(at, token)| match token {
            TokenTree::Ident(word) => word == "test",
            TokenTree::Group(group) => {
                matches!(&tokens[..at], [.., TokenTree::Ident(word)] if word == "all")
                    && requires_test(group.stream())
            }
            _ => false,
        })
    }
    match attribute {
        [TokenTree::Ident(word), TokenTree::Group(condition)] if word == "cfg" => {
            requires_test(condition.stream())
        }
        _ => false,
    }
}

/// The position after the item (or field, statement, match arm) that begins at `at`.
fn end_of_item(tokens: &[TokenTree], mut at: usize) -> usize {
    while is_punct(tokens.get(at), '#') {
        at += 2;
    }
    let to_semicolon = tokens[at..]
        .iter()
        .find_map(|token| match token {
            TokenTree::Ident(word) if word != "pub" => Some(
                ["use", "static", "type", "let", "const"]
                    .iter()
                    .any(|keyword| word == keyword),
            ),
            _ => None,
        })
        .unwrap_or(false);
    let is_const_fn = tokens[at..]
        .iter()
        .take(4)
        .any(|token| matches!(token, TokenTree::Ident(word) if word == "fn"));
    while at < tokens.len() {
        let end = match &tokens[at] {
            TokenTree::Punct(punct) => punct.as_char() == ';' || punct.as_char() == ',',
            TokenTree::Group(group) => {
                group.delimiter() == Delimiter::Brace && (!to_semicolon || is_const_fn)
            }
            _ => false,
        };
        at += 1;
        if end {
            break;
        }
    }
    at
}

/// Paths in the strings of an attribute, such as `#[serde(with = "crate::seconds")]`, except documentation.
fn paths_in_strings(attribute: &[TokenTree]) -> Vec<Vec<String>> {
    if matches!(attribute.first(), Some(TokenTree::Ident(word)) if word == "doc") {
        return Vec::new();
    }
    let mut found = Vec::new();
    for token in attribute {
        match token {
            TokenTree::Group(group) => {
                let inside: Vec<TokenTree> = group.stream().into_iter().collect();
                found.extend(paths_in_strings(&inside));
            }
            TokenTree::Literal(literal) => {
                let text = literal.to_string();
                let text = text.trim_matches('"');
                let is_name = |name: &str| {
                    !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '_')
                };
                if text.contains("::") && text.split("::").all(is_name) {
                    found.push(text.split("::").map(str::to_owned).collect());
                }
            }
            _ => {}
        }
    }
    found
}

/// The path that begins with the word at `at`, and the position after it.
fn path_from(tokens: &[TokenTree], mut at: usize) -> (Vec<String>, usize) {
    let mut path = Vec::new();
    while let Some(TokenTree::Ident(word)) = tokens.get(at) {
        path.push(word.to_string());
        at += 1;
        let goes_on = is_punct(tokens.get(at), ':')
            && is_punct(tokens.get(at + 1), ':')
            && matches!(tokens.get(at + 2), Some(TokenTree::Ident(_)));
        if !goes_on {
            break;
        }
        at += 2;
    }
    (path, at)
}

/// Whether the word at `at` begins a path: it is not a field, method, or associated item.
fn is_path_head(tokens: &[TokenTree], at: usize) -> bool {
    let before = |back: usize, wanted| at >= back && is_punct(tokens.get(at - back), wanted);
    let is_field = before(1, '.') && !before(2, '.');
    let is_associated = before(1, ':') && before(2, ':');
    !is_field && !is_associated && !before(1, '\'')
}

/// The leaves of a `use` tree that begins with `prefix`.
fn use_tree(tokens: &[TokenTree], prefix: Vec<String>, imports: &mut Vec<Import>) {
    let is_comma = |token: &TokenTree| is_punct(Some(token), ',');
    for branch in tokens.split(is_comma) {
        let mut path = prefix.clone();
        let mut at = 0;
        while at < branch.len() {
            match &branch[at] {
                TokenTree::Ident(word) if word == "as" => {
                    let name = branch.get(at + 1).map(ToString::to_string);
                    imports.push(Import {
                        path: path.clone(),
                        name,
                    });
                    path.clear();
                    break;
                }
                TokenTree::Ident(word) => path.push(word.to_string()),
                TokenTree::Punct(punct) if punct.as_char() == '*' => {
                    imports.push(Import {
                        path: path.clone(),
                        name: None,
                    });
                    path.clear();
                    break;
                }
                TokenTree::Group(group) => {
                    let inside: Vec<TokenTree> = group.stream().into_iter().collect();
                    use_tree(&inside, path.clone(), imports);
                    path.clear();
                    break;
                }
                _ => {}
            }
            at += 1;
        }
        if path.len() > prefix.len() {
            // `use a::b::{self}` names `b`
            if path.len() > 1 && path.last().is_some_and(|last| last == "self") {
                path.pop();
            }
            let name = path.last().cloned();
            imports.push(Import { path, name });
        }
    }
}
