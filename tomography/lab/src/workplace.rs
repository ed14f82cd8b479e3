//! What is made by a command of `tactus-lab`, once.

use std::path::{Path, PathBuf};

use clap::Parser;
use eit::Case;

use crate::args::Arguments;
use crate::failure::{Failure, write};
use crate::geometry;

/// The folder that everything goes to.
pub(crate) struct Workplace {
    folder: PathBuf,
}

impl Workplace {
    pub(crate) fn new(folder: PathBuf) -> Result<Self, Failure> {
        for inner in ["models", "sets"] {
            let path = folder.join(inner);
            std::fs::create_dir_all(&path)
                .map_err(|cause| Failure::of(&format!("cannot make {}", path.display()), &cause))?;
        }
        Ok(Self { folder })
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    pub(crate) fn write(&self, name: &str, value: &serde_json::Value) -> Result<(), Failure> {
        write(&self.path(name), format!("{value:#}\n"))
    }

    pub(crate) fn write_bytes(&self, name: &str, bytes: &[u8]) -> Result<(), Failure> {
        let path = self.path(name);
        std::fs::write(&path, bytes)
            .map_err(|cause| Failure::of(&format!("cannot write {}", path.display()), &cause))
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
        // whole or not at all: who is stopped here finds no half of a command
        let part = beside.with_extension("part");
        write(&part, format!("{said}\n"))?;
        std::fs::rename(&part, &beside)
            .map_err(|cause| Failure::of(&format!("cannot write {}", beside.display()), &cause))?;
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
    Arguments::try_parse_from(
        words
            .map(std::ffi::OsString::from)
            .chain(["--out".into(), path.into()]),
    )
}

/// `models/dnn.safetensors` is told about in `models/dnn.safetensors.command`.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".command");
    PathBuf::from(name)
}
