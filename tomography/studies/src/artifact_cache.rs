//! Cache for the outputs of `tactus-lab` commands.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Instant;

use eit::Case;
use outfile::Existing;

use crate::failure::{Failure, write};

/// The program whose commands make the models and the test sets of a study.
pub trait Program {
    /// Checks that the arguments, without the program's name, are a valid command.
    ///
    /// # Errors
    /// What is wrong with them.
    fn check(&self, words: &[OsString]) -> Result<(), String>;

    /// Runs a command, given without the program's name.
    ///
    /// # Errors
    /// The command's error.
    fn run(&self, words: &[OsString]) -> Result<(), Failure>;

    /// By how much a new process grows at most while it loads a model, bytes; `None` if the system does not report it.
    fn resident_bytes(&self, model: &Path) -> Option<u64>;
}

/// Name of the file that contains the command that made a folder.
const MADE_BY: &str = ".tactus-lab";

/// The output folder of a study.
pub(crate) struct ArtifactCache<'p> {
    folder: PathBuf,
    program: &'p dyn Program,
}

impl<'p> ArtifactCache<'p> {
    /// Creates the output folder of a command, or reuses one made by the same command. Files in it are replaced, so
    /// another folder is refused unless it is empty or `existing` allows it.
    pub(crate) fn new(
        folder: PathBuf,
        command: &str,
        existing: Existing,
        program: &'p dyn Program,
    ) -> Result<Self, Failure> {
        let made_by = folder.join(MADE_BY);
        let own = || std::fs::read_to_string(&made_by).is_ok_and(|text| text.trim_end() == command);
        // again after a look into the folder: another shard may have just created it
        if !own() && !only_own_files(&folder) && !own() {
            outfile::check_folder(&folder, existing)?;
        }
        outfile::make_folder(&folder, Existing::Replace)?;
        let _held = shards::wait_for(&beside(&made_by, "lock"))?;
        if !own() {
            write(&made_by, existing, format!("{command}\n"))?;
        }
        for inner in ["models", "sets"] {
            let path = folder.join(inner);
            outfile::make_folder(&path, Existing::Replace)?;
        }
        Ok(Self { folder, program })
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    pub(crate) fn write(&self, name: &str, value: &serde_json::Value) -> Result<(), Failure> {
        self.write_bytes(name, format!("{value:#}\n").as_bytes())
    }

    pub(crate) fn write_bytes(&self, name: &str, bytes: &[u8]) -> Result<(), Failure> {
        Ok(outfile::write(&self.path(name), Existing::Replace, bytes)?)
    }

    /// The paper's sheet as a case folder.
    pub(crate) fn case(&self) -> Result<Case, Failure> {
        let folder = self.made("case", &["mesh", "--preset", "paper-sheet"])?;
        Case::read(&folder).map_err(|fault| Failure::of("cannot read the case", &fault))
    }

    /// A file or folder `name` made by `words` with `--out`: reused if the same words made it, otherwise made again.
    pub(crate) fn made(&self, name: &str, words: &[&str]) -> Result<PathBuf, Failure> {
        Ok(self.made_in(name, words)?.0)
    }

    /// As [`made`](Self::made), with the time that the command took, s, if it was run now. One process makes a thing;
    /// others that need it wait.
    pub(crate) fn made_in(
        &self,
        name: &str,
        words: &[&str],
    ) -> Result<(PathBuf, Option<f64>), Failure> {
        let path = self.path(name);
        let command = words.join(" ");
        let beside = beside(&path, "command");
        let known = || -> Result<bool, Failure> {
            let made_by = self.made_by(&beside, &path)?;
            Ok(path.exists() && made_by.is_some_and(|text| text == command))
        };
        if known()? {
            return Ok((path, None));
        }
        let _held = shards::wait_for(&self::beside(&path, "lock"))?;
        if known()? {
            return Ok((path, None));
        }
        let start = Instant::now();
        eprintln!("tactus-lab {command} --out {}", path.display());
        let line = command_line(&command, &path);
        self.program
            .check(&line)
            .map_err(|fault| Failure::because(format!("{command}: {fault}")))?;
        self.program.run(&line)?;
        write(&beside, Existing::Replace, format!("{command}\n"))?;
        Ok((path, Some(start.elapsed().as_secs_f64())))
    }

    /// The command in a file `.command`; `None` if it does not exist.
    fn made_by(&self, beside: &Path, path: &Path) -> Result<Option<String>, Failure> {
        let damaged = |why: &str| {
            Failure::because(format!(
                "{} is damaged ({why}): delete it, and {} is made again",
                beside.display(),
                path.display()
            ))
        };
        let bytes = match std::fs::read(beside) {
            Ok(bytes) => bytes,
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(cause) => return Err(Failure::of(&format!("{}", beside.display()), &cause)),
        };
        let text = String::from_utf8(bytes).map_err(|_| damaged("it is no text"))?;
        let command = text.trim_end();
        if self.program.check(&command_line(command, path)).is_err() {
            return Err(damaged("its words are no command of tactus-lab"));
        }
        Ok(Some(command.to_owned()))
    }

    /// Growth of a process by loading a model, bytes.
    pub(crate) fn resident_bytes(&self, model: &Path) -> Option<u64> {
        self.program.resident_bytes(model)
    }
}

/// Whether a folder is absent, or has no other files than those of [`ArtifactCache::new`], which another process may be
/// writing.
fn only_own_files(folder: &Path) -> bool {
    let Ok(mut entries) = std::fs::read_dir(folder) else {
        return true;
    };
    entries.all(|entry| {
        entry.is_ok_and(|entry| {
            let name = entry.file_name();
            name.to_string_lossy()
                .trim_start_matches('.')
                .starts_with("tactus-lab")
        })
    })
}

fn command_line(command: &str, path: &Path) -> Vec<OsString> {
    let words = command.split(' ').map(OsString::from);
    words
        .chain(["--force".into(), "--out".into(), path.into()])
        .collect()
}

/// The file of a path with another ending: `models/dnn.safetensors.command` for `models/dnn.safetensors`.
fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    PathBuf::from(name)
}
