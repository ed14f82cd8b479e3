//! Limits the work of each query: a malicious file could make SQLite loop.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rusqlite::Connection;

/// Virtual-machine steps of SQLite between two calls of the progress handler.
const STEPS: i32 = 10_000;
/// Calls allowed for a file of any size.
const LEAST: u64 = 1000;
/// A page of 512 bytes has at most 14 rows, and no query takes 300 steps for each.
const PAGES_A_TIME: u64 = 2;

/// Remaining work of the current query. Counted in steps, not seconds, because a slow disk is not an attack.
#[derive(Debug)]
pub(super) struct Guard {
    allowed: u64,
    left: Arc<AtomicU64>,
}

impl Guard {
    /// Installs the limit on a connection; the limit is small until the size of the file is known.
    pub(super) fn over(connection: &mut Connection) -> rusqlite::Result<Self> {
        let left = Arc::new(AtomicU64::new(LEAST));
        let counter = Arc::clone(&left);
        let is_over = move || {
            let spent = counter.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| {
                left.checked_sub(1)
            });
            spent.is_err()
        };
        connection.progress_handler(STEPS, Some(is_over))?;
        Ok(Self {
            allowed: LEAST,
            left,
        })
    }

    /// Raises the limit for a file of this many pages.
    pub(super) fn allow_pages(&mut self, pages: u64) {
        self.allowed = LEAST + pages / PAGES_A_TIME;
        self.begin();
    }

    /// Starts a new query with the full limit.
    pub(super) fn begin(&self) {
        self.left.store(self.allowed, Ordering::Relaxed);
    }
}
