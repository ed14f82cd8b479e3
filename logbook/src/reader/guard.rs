//! An end to every question: a file made to harm may lead SQLite round in circles.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rusqlite::Connection;

/// Steps of SQLite's machine after which it asks whether to go on.
const STEPS: i32 = 10_000;
/// Times that it may ask, whatever the size of the file.
const LEAST: u64 = 1000;
/// A page of 512 bytes has at most 14 rows, and no question takes 300 steps for each.
const PAGES_A_TIME: u64 = 2;

/// How much work is left for the present question. Counted in steps, not in seconds: a slow disk is no attack.
#[derive(Debug)]
pub(super) struct Guard {
    allowed: u64,
    left: Arc<AtomicU64>,
}

impl Guard {
    /// Stands over a connection from now on; before the size of the file is known it is strict.
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

    /// A file of so many pages takes longer.
    pub(super) fn allow_pages(&mut self, pages: u64) {
        self.allowed = LEAST + pages / PAGES_A_TIME;
        self.begin();
    }

    /// A question begins.
    pub(super) fn begin(&self) {
        self.left.store(self.allowed, Ordering::Relaxed);
    }
}
