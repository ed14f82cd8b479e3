//! What is made by a command of `tactus-lab`, once.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use eit::Case;
use outfile::Existing;

use crate::failure::{Failure, write};

/// The program whose commands make the models and the judging data of a study.
pub trait Program {
    /// Checks that words, without the program's name, are a command.
    ///
    /// # Errors
    /// What is wrong with them.
    fn check(&self, words: &[OsString]) -> Result<(), String>;

    /// Runs a command, given without the program's name.
    ///
    /// # Errors
    /// The command's own.
    fn run(&self, words: &[OsString]) -> Result<(), Failure>;

    /// By how many bytes loading a model makes a process of its own larger; `None` where the system does not report it.
    fn resident_bytes(&self, model: &Path) -> Option<u64>;
}

/// Name of the file that says which command a folder belongs to.
const MADE_BY: &str = ".tactus-lab";

/// The folder that everything goes to.
pub(crate) struct ArtifactCache<'p> {
    folder: PathBuf,
    program: &'p dyn Program,
}

impl<'p> ArtifactCache<'p> {
    /// Makes the folder of a command, or goes on in one that the same command has made. What lies in it is its own and is
    /// replaced; so another folder is refused unless it is empty or `existing` says otherwise.
    pub(crate) fn new(
        folder: PathBuf,
        command: &str,
        existing: Existing,
        program: &'p dyn Program,
    ) -> Result<Self, Failure> {
        let made_by = folder.join(MADE_BY);
        let own = std::fs::read_to_string(&made_by).is_ok_and(|text| text.trim_end() == command);
        if !own {
            outfile::make_folder(&folder, existing)?;
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

    /// A file or folder `name` that `words` make with `--out`: as it lies there if the same words made it, else new.
    pub(crate) fn made(&self, name: &str, words: &[&str]) -> Result<PathBuf, Failure> {
        let path = self.path(name);
        let command = words.join(" ");
        let beside = beside(&path);
        if path.exists()
            && self
                .made_by(&beside, &path)?
                .is_some_and(|text| text == command)
        {
            return Ok(path);
        }
        eprintln!("tactus-lab {command} --out {}", path.display());
        let line = command_line(&command, &path);
        self.program
            .check(&line)
            .map_err(|fault| Failure::because(format!("{command}: {fault}")))?;
        self.program.run(&line)?;
        write(&beside, Existing::Replace, format!("{command}\n"))?;
        Ok(path)
    }

    /// The words of a file `.command`; `None` where it is absent.
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

    /// By how many bytes loading a model makes a process larger.
    pub(crate) fn resident_bytes(&self, model: &Path) -> Option<u64> {
        self.program.resident_bytes(model)
    }
}

fn command_line(command: &str, path: &Path) -> Vec<OsString> {
    let words = command.split(' ').map(OsString::from);
    words
        .chain(["--force".into(), "--out".into(), path.into()])
        .collect()
}

/// `models/dnn.safetensors` is described in `models/dnn.safetensors.command`.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".command");
    PathBuf::from(name)
}
