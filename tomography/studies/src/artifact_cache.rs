//! Cache for the outputs of `tactus-lab` commands.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Instant;

use eit::Case;
use outfile::Existing;

use crate::failure::{Attempt, Failure, write};

/// The program whose commands create the models and the test sets of a study.
pub trait Program {
    /// Checks that the arguments, without the program's name, are a valid command.
    ///
    /// # Errors
    /// What is wrong with the arguments.
    fn check(&self, words: &[OsString]) -> Result<(), String>;

    /// Runs a command; `words` are its arguments without the program's name.
    ///
    /// # Errors
    /// The error of the command.
    fn run(&self, words: &[OsString]) -> Result<(), Failure>;

    /// Largest growth of the memory of a new process while it loads a model, bytes; `None` if the system does not
    /// report it.
    fn resident_bytes(&self, model: &Path) -> Option<u64>;
}

/// Placeholder in a command for the cache's folder, at the start of a path: the folder's name may contain spaces, and
/// commands are split at spaces.
pub(crate) const FOLDER: &str = "{folder}";

/// Name of the file in a folder that contains the command which created the folder.
const MADE_BY: &str = ".tactus-lab";

/// The output folder of a study.
pub(crate) struct ArtifactCache<'p> {
    folder: PathBuf,
    program: &'p dyn Program,
}

impl<'p> ArtifactCache<'p> {
    /// Creates the output folder of a command, or reuses one created by the same command. Files in it are replaced, so
    /// any other folder is refused unless it is empty or `existing` allows it.
    pub(crate) fn new(
        folder: PathBuf,
        command: &str,
        existing: Existing,
        program: &'p dyn Program,
    ) -> Result<Self, Failure> {
        let made_by = folder.join(MADE_BY);
        let own = || std::fs::read_to_string(&made_by).is_ok_and(|text| text.trim_end() == command);
        // `own` is checked again because another shard may have created the file in the meantime
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
        let folder = self.made("case", "mesh --preset paper-sheet")?;
        Case::read(&folder).attempt("cannot read the case")
    }

    /// The path of a file or folder `name` created by `command` with `--out`. It is reused if the same command created
    /// it, otherwise created again. One process creates it; others that need it wait.
    pub(crate) fn made(&self, name: &str, command: &str) -> Result<PathBuf, Failure> {
        self.make(name, command, false)
    }

    /// As [`made`](Self::made), with the time that the command took, s. If that time is missing, the command is run
    /// again.
    pub(crate) fn made_timed(&self, name: &str, command: &str) -> Result<(PathBuf, f64), Failure> {
        let path = self.make(name, command, true)?;
        match seconds(&path) {
            Some(seconds) => Ok((path, seconds)),
            None => Err(Failure::because(format!(
                "{}: the time is missing",
                beside(&path, "seconds").display()
            ))),
        }
    }

    fn make(&self, name: &str, command: &str, timed: bool) -> Result<PathBuf, Failure> {
        let path = self.path(name);
        let beside = beside(&path, "command");
        let known = || -> Result<bool, Failure> {
            let made_by = self.made_by(&beside, &path)?;
            Ok(path.exists()
                && made_by.is_some_and(|text| text == command)
                && (!timed || seconds(&path).is_some()))
        };
        if known()? {
            return Ok(path);
        }
        let _held = shards::wait_for(&self::beside(&path, "lock"))?;
        if known()? {
            return Ok(path);
        }
        let start = Instant::now();
        let shown = command.replace(FOLDER, &self.folder.display().to_string());
        eprintln!("tactus-lab {shown} --out {}", path.display());
        let line = self.command_line(command, &path);
        self.program
            .check(&line)
            .map_err(|fault| Failure::because(format!("{shown}: {fault}")))?;
        self.program.run(&line)?;
        if timed {
            let took = start.elapsed().as_secs_f64();
            let file = self::beside(&path, "seconds");
            write(&file, Existing::Replace, format!("{took}\n"))?;
        }
        write(&beside, Existing::Replace, format!("{command}\n"))?;
        Ok(path)
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
        let line = self.command_line(command, path);
        if self.program.check(&line).is_err() {
            return Err(damaged("its text is not a command of tactus-lab"));
        }
        Ok(Some(command.to_owned()))
    }

    /// The arguments of a command that creates `path`.
    fn command_line(&self, command: &str, path: &Path) -> Vec<OsString> {
        let word = |word: &str| match word.strip_prefix(FOLDER) {
            Some(inner) => self.path(inner.trim_start_matches('/')).into_os_string(),
            None => OsString::from(word),
        };
        command
            .split(' ')
            .map(word)
            .chain(["--force".into(), "--out".into(), path.into()])
            .collect()
    }

    /// Growth of a process by loading a model, bytes; see [`Program::resident_bytes`].
    pub(crate) fn resident_bytes(&self, model: &Path) -> Option<u64> {
        self.program.resident_bytes(model)
    }
}

/// Whether a folder does not exist, or contains only the files of [`ArtifactCache::new`], which another process may be
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

/// The time of the command that created a path, s; `None` if it is unknown.
fn seconds(path: &Path) -> Option<f64> {
    let text = std::fs::read_to_string(beside(path, "seconds")).ok()?;
    text.trim().parse().ok()
}

/// A path with an additional extension: `models/dnn.safetensors.command` for `models/dnn.safetensors`.
fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    PathBuf::from(name)
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;

    /// Records the command lines that it receives, and writes their outputs.
    #[derive(Default)]
    struct Recorder(RefCell<Vec<Vec<OsString>>>);

    impl Program for Recorder {
        fn check(&self, _words: &[OsString]) -> Result<(), String> {
            Ok(())
        }

        fn run(&self, words: &[OsString]) -> Result<(), Failure> {
            self.0.borrow_mut().push(words.to_vec());
            let out = Path::new(words.last().expect("a path"));
            write(out, Existing::Replace, String::new())
        }

        fn resident_bytes(&self, _model: &Path) -> Option<u64> {
            None
        }
    }

    #[test]
    fn folder_with_a_space_is_one_word_of_a_command() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("my runs");
        let program = Recorder::default();
        let cache = ArtifactCache::new(out.clone(), "paper", Existing::Refuse, &program).unwrap();
        let command = format!("train rbf --case {FOLDER}/sets/one --yes");
        let file = cache.made("models/rbf", &command).unwrap();
        let expected: Vec<OsString> = vec![
            "train".into(),
            "rbf".into(),
            "--case".into(),
            out.join("sets/one").into(),
            "--yes".into(),
            "--force".into(),
            "--out".into(),
            file.into(),
        ];
        assert_eq!(*program.0.borrow(), [expected]);
        cache.made("models/rbf", &command).unwrap();
        assert_eq!(program.0.borrow().len(), 1, "reused");
    }

    #[test]
    fn model_is_made_again_if_its_time_was_lost() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("runs");
        let program = Recorder::default();
        let cache = ArtifactCache::new(out, "tradeoff", Existing::Refuse, &program).unwrap();
        let made = || cache.made_timed("models/linear", "train linear").unwrap();
        let (file, first) = made();
        assert_eq!(made(), (file.clone(), first), "reused");
        assert_eq!(program.0.borrow().len(), 1);
        std::fs::remove_file(beside(&file, "seconds")).unwrap();
        assert!(made().1.is_finite());
        assert_eq!(program.0.borrow().len(), 2);
    }
}
