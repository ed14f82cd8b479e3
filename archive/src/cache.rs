//! The cache of sessions fetched for reading: a folder `SITE/DAQ/SESSION` for each. If their total size exceeds the
//! limit, the least recently read sessions are removed, except those that a program is reading.

use std::fs::{DirBuilder, File};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use crate::catalogue::SessionName;

/// Keeps a session in the cache as long as it or a clone of it exists.
#[derive(Debug, Clone)]
pub struct InUse {
    // a shared lock on the folder
    _folder: Arc<File>,
}

/// The folder of a session in the cache, which is created if it is missing and kept while in use.
///
/// # Errors
/// The cache cannot be written.
pub(crate) fn enter(cache: &Path, name: &SessionName) -> io::Result<(PathBuf, InUse)> {
    let path = cache.join(&name.site).join(&name.daq).join(&name.session);
    loop {
        DirBuilder::new()
            .recursive(true)
            .mode(0o700)
            .create(&path)?;
        let folder = File::open(&path)?;
        folder.lock_shared()?;
        if is_at(&folder, &path) {
            folder.set_modified(SystemTime::now())?;
            let in_use = InUse {
                _folder: Arc::new(folder),
            };
            return Ok((path, in_use));
        }
    }
}

/// A session in the cache.
struct Kept {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

impl Kept {
    fn at(path: PathBuf) -> io::Result<Self> {
        let used = std::fs::metadata(&path)?.modified()?;
        let mut bytes = 0;
        for entry in std::fs::read_dir(&path)? {
            bytes += still_there(entry?.metadata())?.map_or(0, |file| file.len());
        }
        Ok(Self { path, bytes, used })
    }
}

/// Removes the least recently read sessions until the others have at most this number of bytes. Sessions in use are
/// kept. Returns the number of bytes removed. Another program may do the same at the same time.
///
/// # Errors
/// The cache cannot be read, or a file in it cannot be removed.
pub(crate) fn prune(cache: &Path, most_bytes: u64) -> io::Result<u64> {
    remove_oldest(&sessions(cache)?, most_bytes)
}

/// The sessions in the cache, the least recently read first.
fn sessions(cache: &Path) -> io::Result<Vec<Kept>> {
    let mut sessions = Vec::new();
    for site in folders(cache)? {
        for daq in folders(&site)? {
            for path in folders(&daq)? {
                sessions.extend(still_there(Kept::at(path))?);
            }
        }
    }
    sessions.sort_by(|a, b| (a.used, &a.path).cmp(&(b.used, &b.path)));
    Ok(sessions)
}

fn remove_oldest(sessions: &[Kept], most_bytes: u64) -> io::Result<u64> {
    let mut all: u64 = sessions.iter().map(|session| session.bytes).sum();
    let mut removed = 0;
    for session in sessions {
        if all <= most_bytes {
            break;
        }
        let Some(folder) = still_there(File::open(&session.path))? else {
            all -= session.bytes;
            continue;
        };
        if folder.try_lock().is_err() {
            continue;
        }
        all -= session.bytes;
        if is_at(&folder, &session.path) {
            std::fs::remove_dir_all(&session.path)?;
            removed += session.bytes;
        }
    }
    Ok(removed)
}

/// Whether an open folder is still the one at its path: another program may have removed it before the lock was
/// taken.
fn is_at(folder: &File, path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|there| {
        folder
            .metadata()
            .is_ok_and(|held| (there.dev(), there.ino()) == (held.dev(), held.ino()))
    })
}

/// `None` if another program has removed it since it was listed.
fn still_there<T>(found: io::Result<T>) -> io::Result<Option<T>> {
    match found {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        found => found.map(Some),
    }
}

/// The folders in a folder; links are not followed.
fn folders(within: &Path) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(within)? {
        let entry = entry?;
        if still_there(entry.file_type())?.is_some_and(|kind| kind.is_dir()) {
            found.push(entry.path());
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn name(session: &str) -> SessionName {
        SessionName {
            site: "berlin".to_owned(),
            daq: "bed3".to_owned(),
            session: session.to_owned(),
        }
    }

    /// A session of 1,000 bytes, last read at `used_s` (s since 1970).
    fn kept(cache: &Path, session: &str, used_s: u64) -> (PathBuf, InUse) {
        let (path, in_use) = enter(cache, &name(session)).unwrap();
        std::fs::write(path.join("part.tactus"), [0; 1000]).unwrap();
        let used = SystemTime::UNIX_EPOCH + Duration::from_secs(used_s);
        File::open(&path).unwrap().set_modified(used).unwrap();
        (path, in_use)
    }

    #[test]
    fn sessions_read_longest_ago_go_first_and_none_in_use() {
        let cache = tempfile::tempdir().unwrap();
        let (oldest, in_use) = kept(cache.path(), "m1", 10);
        let (second, _) = kept(cache.path(), "m2", 20);
        let (third, _) = kept(cache.path(), "m3", 30);
        assert_eq!(prune(cache.path(), 3000).unwrap(), 0);
        assert_eq!(prune(cache.path(), 2999).unwrap(), 1000);
        assert!(oldest.exists() && !second.exists() && third.exists());
        assert_eq!(prune(cache.path(), 0).unwrap(), 1000, "one is in use");
        assert!(oldest.exists() && !third.exists());
        let clone = in_use.clone();
        drop(in_use);
        assert_eq!(prune(cache.path(), 0).unwrap(), 0, "a clone is in use");
        drop(clone);
        assert_eq!(prune(cache.path(), 0).unwrap(), 1000);
        assert!(!oldest.exists());
    }

    #[test]
    fn session_that_is_read_again_is_the_newest() {
        let cache = tempfile::tempdir().unwrap();
        let (first, _) = kept(cache.path(), "m1", 10);
        let (second, _) = kept(cache.path(), "m2", 20);
        drop(enter(cache.path(), &name("m1")).unwrap());
        prune(cache.path(), 1000).unwrap();
        assert!(first.exists() && !second.exists());
    }

    #[test]
    fn session_that_another_program_removed_is_skipped() {
        let cache = tempfile::tempdir().unwrap();
        let (first, _) = kept(cache.path(), "m1", 10);
        let (second, _) = kept(cache.path(), "m2", 20);
        let listed = sessions(cache.path()).unwrap();
        std::fs::remove_dir_all(&first).unwrap();
        assert!(still_there(Kept::at(first)).unwrap().is_none());
        assert_eq!(remove_oldest(&listed, 1000).unwrap(), 0);
        assert!(second.exists(), "the removed one leaves it enough space");
        assert_eq!(remove_oldest(&listed, 0).unwrap(), 1000);
        assert!(!second.exists());
    }

    #[test]
    fn folder_behind_a_link_is_not_removed() {
        let cache = tempfile::tempdir().unwrap();
        let elsewhere = tempfile::tempdir().unwrap();
        std::fs::write(elsewhere.path().join("mine"), [0; 1000]).unwrap();
        let (path, in_use) = kept(cache.path(), "m1", 10);
        drop(in_use);
        std::os::unix::fs::symlink(elsewhere.path(), path.with_file_name("m0")).unwrap();
        prune(cache.path(), 0).unwrap();
        assert!(elsewhere.path().join("mine").exists() && !path.exists());
    }
}
