//! The files that this process is writing.
//!
//! POSIX locks belong to the process: closing any descriptor of a file drops the locks that SQLite holds on it through
//! another descriptor, and another process would then treat the session as unused. So only SQLite opens a file in this
//! list, and other code inspects a file only under the list's lock.

use std::collections::BTreeMap;
use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Device and inode, which stay the same when a file is renamed.
pub(crate) type Inode = (u64, u64);

/// Number of writers of each file; briefly two while a session is resumed.
static WRITTEN: Mutex<BTreeMap<Inode, u32>> = Mutex::new(BTreeMap::new());

fn written() -> MutexGuard<'static, BTreeMap<Inode, u32>> {
    WRITTEN.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(crate) fn inode(of: &Metadata) -> Inode {
    (of.dev(), of.ino())
}

/// Keeps a file in the list; dropped after the connection that writes it.
#[derive(Debug)]
pub(crate) struct WriterGuard(Inode);

impl WriterGuard {
    /// Adds a file that is about to be opened for writing.
    pub(crate) fn new(path: &Path) -> std::io::Result<Self> {
        let mut list = written();
        let inode = inode(&std::fs::metadata(path)?);
        *list.entry(inode).or_default() += 1;
        Ok(Self(inode))
    }
}

impl Drop for WriterGuard {
    fn drop(&mut self) {
        let mut list = written();
        if let Some(writers) = list.get_mut(&self.0) {
            *writers -= 1;
            if *writers == 0 {
                list.remove(&self.0);
            }
        }
    }
}

/// Runs `look` on a file unless this process writes it (then `None`). No writer of this process starts meanwhile.
pub(crate) fn unless_being_written<T>(of: &Metadata, look: impl FnOnce() -> T) -> Option<T> {
    let list = written();
    (!list.contains_key(&inode(of))).then(look)
}
