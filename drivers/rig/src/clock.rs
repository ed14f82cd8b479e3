//! Time, handed in.

use std::time::{Duration, Instant};

use chrono::{DateTime, Utc};

/// Tells the two times a frame is stamped with.
pub trait Clock: Send + Sync {
    /// Never runs backwards, whatever happens to the wall clock.
    fn monotonic(&self) -> Duration;
    /// What a calendar shows.
    fn wall(&self) -> DateTime<Utc>;
}

impl<T: Clock + ?Sized> Clock for &T {
    fn monotonic(&self) -> Duration {
        (**self).monotonic()
    }
    fn wall(&self) -> DateTime<Utc> {
        (**self).wall()
    }
}

impl<T: Clock + ?Sized> Clock for std::sync::Arc<T> {
    fn monotonic(&self) -> Duration {
        (**self).monotonic()
    }
    fn wall(&self) -> DateTime<Utc> {
        (**self).wall()
    }
}

/// The machine's own clocks; monotonic time counts from its making. Copies tell the same time.
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
