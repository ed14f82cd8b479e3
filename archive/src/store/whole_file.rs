//! Writes a file that appears under its name only when it is complete, and never replaces another file.

use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use logbook::sha256_of;
use rustix::fs::{Advice, fadvise};

/// End of the name of an incomplete file.
const UNFINISHED: &str = "unfinished";

/// Why a file was not written.
#[derive(Debug, thiserror::Error)]
pub enum WholeFileError {
    /// The content of the source has another hash.
    #[error("the content has SHA-256 {found}, not that of its name; nothing was kept")]
    Source {
        /// Hash of the content.
        found: String,
    },
    /// The hash of the file on the disk differs from that of the content written.
    #[error("{} was read back with SHA-256 {found}: the disk or the network altered it; nothing was kept", path.display())]
    ReadBack {
        /// The file.
        path: PathBuf,
        /// Hash of what was read.
        found: String,
    },
    /// A file of this name exists.
    #[error("{} exists already", .0.display())]
    Exists(PathBuf),
    /// An error of the system.
    #[error("cannot {attempt} {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was attempted.
        attempt: &'static str,
        /// Error of the system.
        #[source]
        source: Error,
    },
}

/// Writes a file with this SHA-256 and reads it back; returns its size, bytes. The folder must exist.
///
/// # Errors
/// A file of this name exists, the content has another hash, or an error of the system. Nothing is left in the folder
/// then.
pub fn write_whole(from: &mut dyn Read, path: &Path, sha256: &str) -> Result<u64, WholeFileError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let copy = path.with_file_name(format!("{}{}.{UNFINISHED}", beginning(&name), unique()));
    tidy(path);
    let written = write_copy(from, &copy, path, sha256);
    let _ = std::fs::remove_file(&copy);
    let bytes = written?;
    sync_folder_of(path)?;
    Ok(bytes)
}

fn write_copy(
    from: &mut dyn Read,
    copy: &Path,
    path: &Path,
    sha256: &str,
) -> Result<u64, WholeFileError> {
    let failed = |attempt| {
        move |source| WholeFileError::Io {
            path: path.to_owned(),
            attempt,
            source,
        }
    };
    let mut to = OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o440)
        .open(copy)
        .map_err(failed("create"))?;
    let mut tee = Tee {
        from,
        to: &mut to,
        refused: None,
    };
    let read = sha256_of(&mut tee);
    if let Some(refused) = tee.refused {
        return Err(failed("write")(refused));
    }
    let (found, _) = read.map_err(failed("read what is written to"))?;
    if found != sha256 {
        return Err(WholeFileError::Source { found });
    }
    to.sync_all().map_err(failed("sync"))?;
    drop(to);
    let bytes = read_back(copy, sha256)?;
    // a link never replaces a file, on network file systems too
    std::fs::hard_link(copy, path).map_err(|source| match source.kind() {
        ErrorKind::AlreadyExists => WholeFileError::Exists(path.to_owned()),
        _ => failed("name")(source),
    })?;
    Ok(bytes)
}

/// Compares the hash of a file with the expected one; reads from the disk and not from memory, as far as the system
/// allows it.
pub(super) fn read_back(path: &Path, sha256: &str) -> Result<u64, WholeFileError> {
    let failed = |source| WholeFileError::Io {
        path: path.to_owned(),
        attempt: "read back",
        source,
    };
    let file = File::open(path).map_err(failed)?;
    // only a hint; not all file systems support it
    let _ = fadvise(&file, 0, None, Advice::DontNeed);
    let (found, bytes) = sha256_of(file).map_err(failed)?;
    match found == sha256 {
        true => Ok(bytes),
        false => Err(WholeFileError::ReadBack {
            path: path.to_owned(),
            found,
        }),
    }
}

/// Syncs the folder of a file, so that the file's entry is on the disk.
pub(super) fn sync_folder_of(path: &Path) -> Result<(), WholeFileError> {
    let folder = logbook::folder_of(path);
    let synced = File::open(folder).and_then(|folder| folder.sync_all());
    synced.map_err(|source| WholeFileError::Io {
        path: folder.to_owned(),
        attempt: "sync",
        source,
    })
}

/// Part of the name of a temporary file that no other thread or process uses at the same time.
pub(crate) fn unique() -> String {
    static USED: AtomicU64 = AtomicU64::new(0);
    format!(
        "{}{}",
        of_this_process(),
        USED.fetch_add(1, Ordering::Relaxed)
    )
}

/// Beginning of each [`unique`] of this process. The process number alone returns: in a container it is always 1.
fn of_this_process() -> &'static str {
    static OWN: OnceLock<String> = OnceLock::new();
    OWN.get_or_init(|| {
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        let began_ns = since.unwrap_or_default().as_nanos();
        format!("{}-{began_ns}-", std::process::id())
    })
}

/// Removes the leftovers of interrupted copies of this file. A copy that another process is making at the same time
/// fails and is repeated later. Copies of this process are kept: another thread may be making one.
pub(super) fn tidy(path: &Path) {
    let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else {
        return;
    };
    let (begin, own) = (beginning(&name.to_string_lossy()), of_this_process());
    let Ok(entries) = std::fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let file = entry.file_name();
        let file = file.to_string_lossy();
        let made_by = file.strip_prefix(&begin);
        let is_foreign = made_by.is_some_and(|made_by| !made_by.starts_with(own));
        if is_foreign && file.ends_with(UNFINISHED) {
            // a file that cannot be removed only takes space
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// Beginning of the names of unfinished copies of a file.
fn beginning(name: &str) -> String {
    format!(".{name}.")
}

/// A reader that copies everything it reads to a file.
struct Tee<'a> {
    from: &'a mut dyn Read,
    to: &'a mut File,
    /// Why the file could not be written.
    refused: Option<Error>,
}

impl Read for Tee<'_> {
    fn read(&mut self, block: &mut [u8]) -> std::io::Result<usize> {
        let read = self.from.read(block)?;
        self.to.write_all(&block[..read]).map_err(|cause| {
            self.refused = Some(cause);
            Error::other("the copy could not be written")
        })?;
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Content during whose reading the same file is written once more, as by another thread.
    struct WrittenMeanwhile<'a> {
        content: &'a [u8],
        path: &'a Path,
        sha256: &'a str,
        other: Option<Result<u64, WholeFileError>>,
    }

    impl Read for WrittenMeanwhile<'_> {
        fn read(&mut self, block: &mut [u8]) -> std::io::Result<usize> {
            if self.other.is_none() {
                self.other = Some(write_whole(&mut &*self.content, self.path, self.sha256));
            }
            self.content.read(block)
        }
    }

    #[test]
    fn copies_of_one_file_at_the_same_time_do_not_collide() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m1.tactus");
        let (sha256, _) = sha256_of(&b"content"[..]).unwrap();
        let mut content = WrittenMeanwhile {
            content: b"content",
            path: &path,
            sha256: &sha256,
            other: None,
        };
        let first = write_whole(&mut content, &path, &sha256);
        assert!(matches!(content.other, Some(Ok(7))), "{:?}", content.other);
        assert!(matches!(first, Err(WholeFileError::Exists(_))), "{first:?}");
        assert_eq!(std::fs::read(&path).unwrap(), b"content");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn leftovers_of_a_process_of_the_same_number_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m1.tactus");
        let left = |count: u64| format!(".m1.tactus.{}-{count}.{UNFINISHED}", std::process::id());
        for count in 0..4 {
            std::fs::write(folder.path().join(left(count)), b"cont").unwrap();
        }
        let (sha256, _) = sha256_of(&b"content"[..]).unwrap();
        let written = write_whole(&mut &b"content"[..], &path, &sha256);
        assert!(matches!(written, Ok(7)), "{written:?}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
