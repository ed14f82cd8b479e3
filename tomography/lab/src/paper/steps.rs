//! What is made by a command of `tactus-lab`, once.

use std::path::{Path, PathBuf};

use clap::Parser;
use eit::Case;

use crate::args::Arguments;
use crate::failure::{Failure, write};
use crate::geometry;

/// The folder that everything goes to.
pub(super) struct Workplace {
    folder: PathBuf,
}

impl Workplace {
    pub(super) fn new(folder: PathBuf) -> Result<Self, Failure> {
        for inner in ["models", "sets"] {
            let path = folder.join(inner);
            std::fs::create_dir_all(&path)
                .map_err(|cause| Failure::of(&format!("cannot make {}", path.display()), &cause))?;
        }
        Ok(Self { folder })
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    pub(super) fn write(&self, name: &str, value: &serde_json::Value) -> Result<(), Failure> {
        write(&self.path(name), format!("{value:#}\n"))
    }

    pub(super) fn write_bytes(&self, name: &str, bytes: &[u8]) -> Result<(), Failure> {
        let path = self.path(name);
        std::fs::write(&path, bytes)
            .map_err(|cause| Failure::of(&format!("cannot write {}", path.display()), &cause))
    }

    /// The paper's sheet as a case folder.
    pub(super) fn case(&self) -> Result<Case, Failure> {
        let folder = self.made("case", &["mesh", "--preset", "paper-sheet"])?;
        geometry::read(&folder)
    }

    /// A file or folder `name` that `words` make with `--out`: as it lies there if the same words made it, else new.
    pub(super) fn made(&self, name: &str, words: &[&str]) -> Result<PathBuf, Failure> {
        let path = self.path(name);
        let said = words.join(" ");
        let beside = beside(&path);
        let same = std::fs::read_to_string(&beside).is_ok_and(|text| text.trim_end() == said);
        if same && path.exists() {
            return Ok(path);
        }
        eprintln!("tactus-lab {said} --out {}", path.display());
        let out = path.display().to_string();
        let line = ["tactus-lab"]
            .into_iter()
            .chain(words.iter().copied())
            .chain(["--out", &out]);
        let parsed = Arguments::try_parse_from(line)
            .map_err(|fault| Failure::because(format!("{said}: {fault}")))?;
        crate::perform(&parsed.command)?;
        write(&beside, format!("{said}\n"))?;
        Ok(path)
    }
}

/// `models/dnn.safetensors` is told about in `models/dnn.safetensors.command`.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".command");
    PathBuf::from(name)
}
