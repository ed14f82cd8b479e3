//! Clocks, passed in by the caller.

use std::time::{Duration, Instant};

use chrono::{DateTime, Utc};

/// The two times that a frame is stamped with.
pub trait Clock: Send + Sync {
    /// Never decreases, whatever happens to the wall clock.
    fn monotonic(&self) -> Duration;
    /// Calendar time.
    fn wall(&self) -> DateTime<Utc>;
}

/// The system clocks; monotonic time counts from the construction. Copies show the same time.
#[derive(Debug, Clone, Copy)]
pub struct SystemClock {
    start: Instant,
}

impl SystemClock {
    /// Starts counting.
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
