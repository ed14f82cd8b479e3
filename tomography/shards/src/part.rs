//! The incomplete file of a shard. The process that writes it holds an exclusive lock, which the kernel releases when
//! the process ends for whatever reason.

use std::fs::{File, OpenOptions, TryLockError};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;

use crate::ShardError;

/// A part file, locked for this process.
#[derive(Debug)]
pub struct PartFile {
    /// The file, open for reading and writing.
    pub file: File,
    path: PathBuf,
}

impl PartFile {
    /// Opens or creates the file and locks it.
    ///
    /// # Errors
    /// [`ShardError::Held`] if another process has locked it; [`ShardError::Io`] if the file cannot be opened or is a
    /// link.
    pub fn lock(path: &Path) -> Result<Self, ShardError> {
        loop {
            let file = open(path)?;
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Err(ShardError::Held(path.to_owned())),
                Err(TryLockError::Error(cause)) => return Err(ShardError::io(path)(cause)),
            }
            // the process that held the lock may have renamed the file since it was opened here
            let locked = file.metadata().map_err(ShardError::io(path))?;
            match std::fs::symlink_metadata(path) {
                Ok(named) if (named.dev(), named.ino()) == (locked.dev(), locked.ino()) => {
                    return Ok(Self {
                        file,
                        path: path.to_owned(),
                    });
                }
                Ok(_) => {}
                Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => {}
                Err(cause) => return Err(ShardError::io(path)(cause)),
            }
        }
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Removes the file, if another process completed the shard before the lock was taken.
    ///
    /// # Errors
    /// [`ShardError::Io`].
    pub fn remove(self) -> Result<(), ShardError> {
        std::fs::remove_file(&self.path).map_err(ShardError::io(&self.path))
    }

    /// Syncs the file and renames it to `whole`.
    ///
    /// # Errors
    /// A disk error.
    pub fn finish(self, whole: &Path) -> Result<(), ShardError> {
        self.file.sync_all().map_err(ShardError::io(&self.path))?;
        std::fs::rename(&self.path, whole).map_err(ShardError::io(whole))?;
        // an error is ignored because not every file system can sync a folder; the file itself is on disk
        let _unsynced = whole
            .parent()
            .map(|folder| File::open(folder).and_then(|folder| folder.sync_all()));
        Ok(())
    }
}

/// Opens or creates a file for reading and writing; refuses a link. Child processes do not inherit the descriptor.
fn open(path: &Path) -> Result<File, ShardError> {
    OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .custom_flags((OFlags::NOFOLLOW | OFlags::CLOEXEC).bits() as i32)
        .open(path)
        .map_err(ShardError::io(path))
}

/// Waits until no other process has locked the file `path`, and locks it until the returned file is dropped. For work
/// that several shards need and only one of them does.
///
/// # Errors
/// The file cannot be created or locked.
pub fn wait_for(path: &Path) -> Result<File, ShardError> {
    let file = open(path)?;
    file.lock().map_err(ShardError::io(path))?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_held_part_is_refused_until_it_is_released() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("shard-0-of-1.part");
        let first = PartFile::lock(&path).unwrap();
        let refusal = PartFile::lock(&path).unwrap_err();
        assert!(matches!(&refusal, ShardError::Held(held) if *held == path));
        assert!(refusal.to_string().contains("shard-0-of-1.part"));
        drop(first);
        PartFile::lock(&path).unwrap();
    }

    #[test]
    fn a_link_in_place_of_a_part_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let other = folder.path().join("other");
        std::fs::write(&other, "precious").unwrap();
        let path = folder.path().join("shard-0-of-1.part");
        std::os::unix::fs::symlink(&other, &path).unwrap();
        assert!(PartFile::lock(&path).is_err());
        assert_eq!(std::fs::read(&other).unwrap(), b"precious");
    }
}
