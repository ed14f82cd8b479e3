//! Attacks on every output of a program, for its tests: what exists at the path must survive each of them.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::Permissions;
use std::os::unix::fs::{PermissionsExt, lchown, symlink};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::builder::ValueParser;
use clap::{Arg, Command};

use crate::{OutPath, outputs_of};

const PRECIOUS: &[u8] = b"precious\n";
const SESSION: &[u8] = b"SQLite format 3\0 and the pages of a session";

/// The paths of a program.
pub struct Paths<'a> {
    /// A command line for each output, which is named as `export --out`, with `{}` for the path. The command must fail
    /// at the path, so other files that it names need not exist.
    pub outputs: &'a [(&'a str, &'a str)],
    /// Path arguments that are not outputs.
    pub inputs: &'a [&'a str],
}

/// Attacks every output of the program, and fails if an argument is listed neither as output nor as input.
///
/// # Panics
/// An attack succeeds, or the lists of paths do not agree with the command line.
pub fn attack_every_output(
    program: &Command,
    paths: &Paths<'_>,
    run: impl Fn(Vec<OsString>) -> ExitCode,
) {
    let mut outputs = Vec::new();
    let mut others = BTreeSet::new();
    collect(program, "", &mut outputs, &mut others);
    let known: BTreeSet<&str> = outputs.iter().map(|(name, ..)| name.as_str()).collect();
    let listed: BTreeSet<&str> = paths.outputs.iter().map(|(name, _)| *name).collect();
    assert_eq!(
        known, listed,
        "outputs of the program, and lines that attack them"
    );
    let inputs: BTreeSet<String> = paths.inputs.iter().map(|name| (*name).to_owned()).collect();
    assert_eq!(
        others, inputs,
        "paths that are no outputs: give an output the type OutPath"
    );
    for (name, kind, forced) in &outputs {
        let (_, line) = paths
            .outputs
            .iter()
            .find(|(listed, _)| listed == name)
            .expect("the names are the same");
        let attempt = |path: &Path, force: bool| {
            let force = (force && *forced).then(|| "--force".into());
            let words = line.split(' ').map(|word| match word {
                "{}" => path.into(),
                word => word.into(),
            });
            let words = std::iter::once(program.get_name().into())
                .chain(words)
                .chain(force);
            run(words.collect()) != ExitCode::SUCCESS
        };
        match kind {
            Kind::File => attack_file(name, attempt),
            Kind::Folder(new) => attack_folder(name, *new, attempt),
        }
    }
}

enum Kind {
    File,
    /// Whether it must be new or empty.
    Folder(bool),
}

fn collect(
    command: &Command,
    above: &str,
    outputs: &mut Vec<(String, Kind, bool)>,
    others: &mut BTreeSet<String>,
) {
    let name = |arg: &Arg| {
        let arg = match arg.get_long() {
            Some(long) => format!("--{long}"),
            None => arg.get_id().to_string(),
        };
        format!("{above} {arg}").trim().to_owned()
    };
    let path = clap::value_parser!(PathBuf).type_id();
    let file = ValueParser::from(clap::value_parser!(OutPath)).type_id();
    let folder = ValueParser::from(clap::value_parser!(crate::OutFolder)).type_id();
    let forced = command.get_arguments().any(|arg| arg.get_id() == "force");
    for arg in outputs_of(command) {
        let kind = match arg.get_value_parser().type_id() {
            kind if kind == file => Kind::File,
            kind => Kind::Folder(kind == folder),
        };
        outputs.push((name(arg), kind, forced));
    }
    for arg in command.get_arguments() {
        if arg.get_value_parser().type_id() == path {
            others.insert(name(arg));
        }
    }
    for inner in command.get_subcommands() {
        let above = format!("{above} {}", inner.get_name());
        collect(inner, above.trim(), outputs, others);
    }
}

fn attack_file(name: &str, refused: impl Fn(&Path, bool) -> bool) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let within = |file: &str| folder.path().join(file);
    let (old, session) = (within("old.csv"), within("session.csv"));
    std::fs::write(&old, PRECIOUS).expect("a small file");
    std::fs::write(&session, SESSION).expect("a small file");
    symlink("old.csv", within("link.csv")).expect("a link");
    symlink("nothing", within("dangling.csv")).expect("a link");
    std::fs::create_dir(within("folder.csv")).expect("a folder");
    let _socket = UnixListener::bind(within("socket")).expect("a socket");
    for (target, force) in [
        ("old.csv", false),
        ("session.csv", false),
        ("session.csv", true),
        ("new.tactus", true),
        ("new.tactus-wal", true),
        ("folder.csv", true),
        ("link.csv", false),
        ("dangling.csv", false),
        ("socket", true),
        ("missing/new.csv", true),
    ] {
        let before = listing(folder.path());
        assert!(refused(&within(target), force), "{name} {target} {force}");
        assert_eq!(listing(folder.path()), before, "{name} {target} {force}");
        assert_eq!(
            std::fs::read(&old).ok().as_deref(),
            Some(PRECIOUS),
            "{name} {target}"
        );
        assert_eq!(
            std::fs::read(&session).ok().as_deref(),
            Some(SESSION),
            "{name} {target}"
        );
    }
    // another user's link where everybody may write; only root can make one here
    let shared = within("shared");
    std::fs::create_dir(&shared).expect("a folder");
    std::fs::set_permissions(&shared, Permissions::from_mode(0o1777)).expect("own folder");
    for (link, target) in [("out.csv", "../new.csv"), ("out", "..")] {
        symlink(target, shared.join(link)).expect("a link");
        if lchown(shared.join(link), Some(65_534), Some(65_534)).is_err() {
            continue;
        }
        let path = if link == "out" {
            shared.join("out/new.csv")
        } else {
            shared.join(link)
        };
        assert!(refused(&path, true), "{name} {}", path.display());
        assert!(!within("new.csv").exists(), "{name} {}", path.display());
    }
}

fn attack_folder(name: &str, new: bool, refused: impl Fn(&Path, bool) -> bool) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("file");
    std::fs::write(&file, PRECIOUS).expect("a small file");
    let before = listing(folder.path());
    assert!(refused(&file, true), "{name}: a file as folder");
    if new {
        assert!(refused(folder.path(), false), "{name}: a folder with files");
    }
    assert_eq!(listing(folder.path()), before, "{name}");
    assert_eq!(
        std::fs::read(&file).ok().as_deref(),
        Some(PRECIOUS),
        "{name}"
    );
}

/// Names in a folder, and where links point.
fn listing(folder: &Path) -> Vec<(PathBuf, Option<PathBuf>)> {
    let entries = std::fs::read_dir(folder).expect("own folder");
    let mut names: Vec<_> = entries
        .map(|entry| entry.expect("own folder").path())
        .map(|path| (path.clone(), std::fs::read_link(path).ok()))
        .collect();
    names.sort();
    names
}
