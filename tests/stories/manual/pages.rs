//! The Markdown pages of the repository, and what the tests read in them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};

/// The folder of the workspace.
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// A page, by its path from the root.
pub struct Page {
    pub path: String,
    pub text: String,
}

/// A fenced block of a page.
pub struct Block {
    /// The words of its info string, such as `console` and `norun`.
    pub info: Vec<String>,
    /// Line of the page on which its first line stands.
    pub line: usize,
    pub text: String,
}

/// A command line of a block.
pub struct CommandLine {
    /// `page:line`
    pub place: String,
    pub words: Vec<String>,
}

/// Every file of the repository with this extension, by its path from the root.
pub fn files(extension: &str) -> Vec<Page> {
    let mut found = Vec::new();
    walk(root(), extension, &mut found);
    found.sort_by(|one, other| one.path.cmp(&other.path));
    found
}

/// Every Markdown page of the repository.
pub fn all() -> Vec<Page> {
    let pages = files("md");
    assert!(pages.len() > 50, "only {} pages were found", pages.len());
    pages
}

/// README and manual: the pages whose commands must be right today.
pub fn manual() -> Vec<Page> {
    let mut pages = all();
    pages.retain(|page| page.path == "README.md" || page.path.starts_with("docs/"));
    pages
}

fn walk(folder: &Path, extension: &str, found: &mut Vec<Page>) {
    let entries = std::fs::read_dir(folder).expect("a folder of the project can be read");
    for entry in entries {
        let path = entry.expect("a folder of the project can be read").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_dir() {
            if !name.starts_with('.') && name != "target" {
                walk(&path, extension, found);
            }
        } else if path.extension().is_some_and(|found| found == extension) {
            let text = std::fs::read_to_string(&path).expect("a page of the project is text");
            let path = path
                .strip_prefix(root())
                .expect("it was found below the root");
            found.push(Page {
                path: path.display().to_string(),
                text,
            });
        }
    }
}

impl Page {
    /// The folder in which it lies.
    pub fn folder(&self) -> PathBuf {
        let parent = Path::new(&self.path).parent();
        root().join(parent.expect("a page lies in a folder"))
    }

    fn events(&self) -> impl Iterator<Item = (Event<'_>, usize)> {
        Parser::new_ext(&self.text, Options::ENABLE_TABLES)
            .into_offset_iter()
            .map(|(event, range)| (event, self.line(range.start)))
    }

    fn line(&self, offset: usize) -> usize {
        self.text[..offset].matches('\n').count() + 1
    }

    /// Where its links and pictures lead, with their lines.
    pub fn links(&self) -> Vec<(String, usize)> {
        self.events()
            .filter_map(|(event, line)| match event {
                Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                    Some((dest_url.into_string(), line))
                }
                _ => None,
            })
            .collect()
    }

    /// Its inline code, with its lines.
    pub fn code(&self) -> Vec<(String, usize)> {
        self.events()
            .filter_map(|(event, line)| match event {
                Event::Code(text) => Some((text.replace('\n', " "), line)),
                _ => None,
            })
            .collect()
    }

    /// The anchors of its headings, as GitHub and mdBook make them.
    pub fn anchors(&self) -> Vec<String> {
        let mut anchors = Vec::new();
        let mut seen = BTreeMap::new();
        let mut heading: Option<String> = None;
        for (event, _) in self.events() {
            match event {
                Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
                Event::Text(text) | Event::Code(text) => {
                    if let Some(heading) = &mut heading {
                        heading.push_str(&text);
                    }
                }
                Event::End(TagEnd::Heading(_)) => {
                    let anchor = anchor(&heading.take().unwrap_or_default());
                    let count = seen.entry(anchor.clone()).or_insert(0);
                    anchors.push(match *count {
                        0 => anchor,
                        count => format!("{anchor}-{count}"),
                    });
                    *count += 1;
                }
                _ => {}
            }
        }
        anchors
    }

    /// Its fenced blocks.
    pub fn blocks(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        let mut open: Option<Block> = None;
        for (event, line) in self.events() {
            match event {
                Event::Start(Tag::CodeBlock(CodeBlockKind::Fenced(info))) => {
                    open = Some(Block {
                        info: info.split(',').map(|word| word.trim().to_owned()).collect(),
                        line: line + 1,
                        text: String::new(),
                    });
                }
                Event::Text(text) => {
                    if let Some(block) = &mut open {
                        block.text.push_str(&text);
                    }
                }
                Event::End(TagEnd::CodeBlock) => blocks.extend(open.take()),
                _ => {}
            }
        }
        blocks
    }
}

impl Block {
    /// Whether its info string has this word.
    pub fn is(&self, word: &str) -> bool {
        self.info.iter().any(|found| found == word)
    }

    /// Whether it holds lines for a shell.
    pub fn is_shell(&self) -> bool {
        self.is("console") || self.is("sh")
    }

    /// Its command lines, without comments and the shell's own words.
    pub fn commands(&self, page: &Page) -> Vec<CommandLine> {
        let lines = self.text.lines().enumerate();
        lines
            .filter_map(|(index, line)| {
                let place = format!("{}:{}", page.path, self.line + index);
                let mut words = shlex::split(line)
                    .unwrap_or_else(|| panic!("{place}: a quote is left open: {line}"));
                words.retain(|word| word != "&");
                if words.first().is_some_and(|word| word == "sudo") {
                    words.remove(0);
                }
                (!words.is_empty()).then_some(CommandLine { place, words })
            })
            .collect()
    }
}

fn anchor(heading: &str) -> String {
    heading
        .trim()
        .to_lowercase()
        .chars()
        .filter_map(|letter| match letter {
            ' ' => Some('-'),
            '-' | '_' => Some(letter),
            _ => letter.is_alphanumeric().then_some(letter),
        })
        .collect()
}
