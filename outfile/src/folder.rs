//! A new folder of files that appears under its name complete, or not at all.

use std::fs::{File, Permissions};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::check::folder_of;
use crate::{Existing, OutFileError, check_folder};

/// A folder that is being filled under a temporary name next to its own. If it is dropped before [`NewFolder::finish`],
/// nothing remains.
#[derive(Debug)]
pub struct NewFolder {
    path: PathBuf,
    temporary: TempDir,
    files: Vec<String>,
}

impl NewFolder {
    /// # Errors
    /// The folder is not empty or is a file; its parent folder does not exist or cannot be written to.
    pub fn create(path: &Path) -> Result<Self, OutFileError> {
        check_folder(path, Existing::Refuse)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let prefix: String = std::iter::once('.').chain(name.chars().take(60)).collect();
        let temporary = tempfile::Builder::new()
            .prefix(&format!("{prefix}."))
            .suffix(".part")
            .rand_bytes(12)
            .permissions(Permissions::from_mode(0o777))
            .tempdir_in(folder_of(path));
        Ok(Self {
            path: path.to_owned(),
            temporary: temporary.map_err(OutFileError::io(path))?,
            files: Vec::new(),
        })
    }

    /// Writes a file of the folder.
    ///
    /// # Errors
    /// A disk error.
    pub fn put(&mut self, name: &str, bytes: &[u8]) -> Result<(), OutFileError> {
        let written = File::create_new(self.temporary.path().join(name)).and_then(|mut file| {
            file.write_all(bytes)?;
            file.sync_all()
        });
        written.map_err(OutFileError::io(&self.path.join(name)))?;
        self.files.push(name.to_owned());
        Ok(())
    }

    /// Gives the folder its name. If an empty folder of this name exists, the files are moved into it.
    ///
    /// # Errors
    /// A disk error, or the folder is not empty any more.
    pub fn finish(self) -> Result<PathBuf, OutFileError> {
        check_folder(&self.path, Existing::Refuse)?;
        let made = self.temporary.path();
        if self.path.is_dir() {
            for name in &self.files {
                let place = self.path.join(name);
                std::fs::rename(made.join(name), &place).map_err(OutFileError::io(&place))?;
            }
        } else {
            std::fs::rename(made, &self.path).map_err(OutFileError::io(&self.path))?;
        }
        // not every file system can sync a folder; the files themselves are on disk
        let _unsynced = File::open(folder_of(&self.path)).and_then(|folder| folder.sync_all());
        Ok(self.path)
    }
}
