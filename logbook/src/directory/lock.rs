//! Lock of a state directory: one process writes to it.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::LogbookError;

/// Name of the lock file in a state directory.
pub(crate) const LOCK_FILE: &str = "tactus.lock";

/// The lock, held until this value is dropped; the kernel also releases it when the process ends for any reason.
#[derive(Debug)]
pub struct StateLock {
    file: File,
    dir: PathBuf,
}

impl StateLock {
    /// The locked directory.
    pub fn dir(&self) -> &Path {
        &self.dir
    }
}

impl Drop for StateLock {
    fn drop(&mut self) {
        // An empty file names no stale owner; if this fails, the kernel still releases the lock.
        let _ = self.file.set_len(0);
    }
}

/// Locks a state directory for this process; creates the directory if needed.
///
/// # Errors
/// [`LogbookError::AlreadyRunning`] with the process number of the owner; or the directory cannot be created or
/// written.
pub fn lock(dir: impl AsRef<Path>) -> Result<StateLock, LogbookError> {
    let dir = dir.as_ref();
    std::fs::create_dir_all(dir)
        .map_err(|source| LogbookError::io(dir, "make the state directory", source))?;
    let mut file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(dir.join(LOCK_FILE))
        .map_err(|source| LogbookError::io(dir, "open the lock file in", source))?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            let mut owner = String::new();
            // The owner may not have written its number yet.
            let _ = file.read_to_string(&mut owner);
            return Err(LogbookError::AlreadyRunning {
                dir: dir.to_owned(),
                pid: owner.trim().parse().ok(),
            });
        }
        Err(TryLockError::Error(source)) => return Err(LogbookError::io(dir, "lock", source)),
    }
    // The number is only informative; a full disk that refuses it does not prevent the lock.
    let _ = file
        .set_len(0)
        .and_then(|()| file.seek(SeekFrom::Start(0)))
        .and_then(|_| writeln!(file, "{}", std::process::id()));
    Ok(StateLock {
        file,
        dir: dir.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use crate::directory::lock::*;

    #[test]
    fn second_owner_is_refused_with_the_first_named() {
        let dir = tempfile::tempdir().unwrap();
        let state = dir.path().join("state");
        let first = lock(&state).unwrap();
        let refusal = lock(&state).unwrap_err();
        assert!(
            matches!(refusal, LogbookError::AlreadyRunning { pid: Some(pid), .. } if pid == std::process::id()),
            "{refusal}"
        );
        assert!(refusal.to_string().contains("pid"), "{refusal}");
        drop(first);
        lock(&state).unwrap();
    }
}
