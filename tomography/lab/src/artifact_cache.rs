//! What is made by a command of `tactus-lab`, once.

use std::path::{Path, PathBuf};

use clap::Parser;
use eit::Case;
use outfile::Existing;

use crate::args::Arguments;
use crate::failure::{Failure, write};
use crate::geometry;

/// Name of the file that says which command a folder belongs to.
const MADE_BY: &str = ".tactus-lab";

/// The folder that everything goes to.
pub(crate) struct ArtifactCache {
    folder: PathBuf,
}

impl ArtifactCache {
    /// Makes the folder of a command, or goes on in one that the same command has made. What lies in it is its own and is
    /// replaced; so another folder is refused unless it is empty or `existing` says otherwise.
    pub(crate) fn new(folder: PathBuf, command: &str, existing: Existing) -> Result<Self, Failure> {
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
        Ok(Self { folder })
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
        geometry::read(&folder)
    }

    /// A file or folder `name` that `words` make with `--out`: as it lies there if the same words made it, else new.
    pub(crate) fn made(&self, name: &str, words: &[&str]) -> Result<PathBuf, Failure> {
        let path = self.path(name);
        let said = words.join(" ");
        let beside = beside(&path);
        if path.exists() && made_by(&beside, &path)?.is_some_and(|text| text == said) {
            return Ok(path);
        }
        eprintln!("tactus-lab {said} --out {}", path.display());
        let parsed =
            parsed(&said, &path).map_err(|fault| Failure::because(format!("{said}: {fault}")))?;
        crate::perform(&parsed.command)?;
        write(&beside, Existing::Replace, format!("{said}\n"))?;
        Ok(path)
    }
}

/// The words of a file `.command`; `None` where it is absent.
fn made_by(beside: &Path, path: &Path) -> Result<Option<String>, Failure> {
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
    let said = text.trim_end();
    if parsed(said, path).is_err() {
        return Err(damaged("its words are no command of tactus-lab"));
    }
    Ok(Some(said.to_owned()))
}

fn parsed(said: &str, path: &Path) -> Result<Arguments, clap::Error> {
    let words = ["tactus-lab"].into_iter().chain(said.split(' '));
    Arguments::try_parse_from(words.map(std::ffi::OsString::from).chain([
        "--force".into(),
        "--out".into(),
        path.into(),
    ]))
}

/// `models/dnn.safetensors` is told about in `models/dnn.safetensors.command`.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".command");
    PathBuf::from(name)
}
