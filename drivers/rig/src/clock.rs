//! Clocks, passed in by the caller.

use std::time::{Duration, Instant};

use chrono::{DateTime, Utc};

/// The two clocks that give the times of a frame.
pub trait Clock: Send + Sync {
    /// Time that never decreases, independent of changes of the wall clock.
    fn monotonic(&self) -> Duration;
    /// Calendar time.
    fn wall(&self) -> DateTime<Utc>;
}

/// The system clocks; monotonic time counts from the construction. Copies return the same time.
#[derive(Debug, Clone, Copy)]
pub struct SystemClock {
    start: Instant,
}

impl SystemClock {
    /// A clock whose monotonic time starts at 0 now.
    pub fn new() -> Self {
        Self {
            start: Instant::now(),
        }
    }
}

impl Default for SystemClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for SystemClock {
    fn monotonic(&self) -> Duration {
        self.start.elapsed()
    }
    fn wall(&self) -> DateTime<Utc> {
        Utc::now()
    }
}
