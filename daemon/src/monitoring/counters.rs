//! Counters since the start of the daemon, over all sessions.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use chrono::{DateTime, Utc};
use rig::{Clock, SystemClock};

use crate::locked::locked;

/// Upper bounds of the reconstruction time histogram, s; the last bin has none.
pub(crate) const RECONSTRUCTION_S: [f64; 8] = [0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 10.0];

/// Monotonic counters, and the most recent values.
#[derive(Debug)]
pub(crate) struct Counters {
    clock: SystemClock,
    pub acquired: AtomicU64,
    pub durable: AtomicU64,
    pub failed: AtomicU64,
    pub dropped: AtomicU64,
    /// Readings over range.
    pub overloads: AtomicU64,
    last: Mutex<Last>,
}

#[derive(Debug, Default)]
struct Last {
    frame: Option<LastFrame>,
    gap: Option<Gap>,
    reconstruction: Reconstruction,
}

/// The most recent frame on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct LastFrame {
    pub session: String,
    pub sequence: u64,
    pub wall: DateTime<Utc>,
    /// When its last reading was taken, by the daemon's clock.
    pub taken: Duration,
}

/// A gap of the record: frames that are missing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Gap {
    pub at: DateTime<Utc>,
    pub text: String,
}

/// Histogram of reconstruction times.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Reconstruction {
    /// Count in each bin of [`RECONSTRUCTION_S`].
    pub within: [u64; RECONSTRUCTION_S.len()],
    pub count: u64,
    pub sum_s: f64,
}

impl Counters {
    pub(crate) fn new(clock: SystemClock) -> Self {
        Self {
            clock,
            acquired: AtomicU64::new(0),
            durable: AtomicU64::new(0),
            failed: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            overloads: AtomicU64::new(0),
            last: Mutex::default(),
        }
    }

    /// Time by the daemon's clock.
    pub(crate) fn now(&self) -> Duration {
        self.clock.monotonic()
    }

    pub(crate) fn count_acquired(&self) {
        self.acquired.fetch_add(1, Ordering::Relaxed);
    }

    /// Counts a frame on disk, with its readings over range.
    pub(crate) fn count_durable(&self, frame: LastFrame, overloads: u64) {
        self.durable.fetch_add(1, Ordering::Relaxed);
        self.overloads.fetch_add(overloads, Ordering::Relaxed);
        locked(&self.last).frame = Some(frame);
    }

    /// Counts a map, on time or late, and its computing time.
    pub(crate) fn count_map(&self, took: Duration) {
        let seconds = took.as_secs_f64();
        let mut last = locked(&self.last);
        last.reconstruction.count += 1;
        last.reconstruction.sum_s += seconds;
        let place = RECONSTRUCTION_S.iter().position(|most| seconds <= *most);
        if let Some(within) = place.and_then(|at| last.reconstruction.within.get_mut(at)) {
            *within += 1;
        }
    }

    /// Counts a frame that failed, with the time and the cause.
    pub(crate) fn count_failed(&self, at: DateTime<Utc>, cause: &str) {
        self.failed.fetch_add(1, Ordering::Relaxed);
        self.gap(at, &survey::printable(cause));
    }

    /// Counts frames that were due and could not be taken, or that could not be written to the disk.
    pub(crate) fn count_dropped(&self, frames: u64) {
        if frames == 0 {
            return;
        }
        self.dropped.fetch_add(frames, Ordering::Relaxed);
        let text = match frames {
            1 => "a frame was late, or the disk did not accept it".to_owned(),
            more => format!("{more} frames were late, or the disk did not accept them"),
        };
        self.gap(self.clock.wall(), &text);
    }

    /// Stores the time and the cause of the last gap.
    fn gap(&self, at: DateTime<Utc>, text: &str) {
        let text = text.to_owned();
        locked(&self.last).gap = Some(Gap { at, text });
    }

    pub(crate) fn last_frame(&self) -> Option<LastFrame> {
        locked(&self.last).frame.clone()
    }

    pub(crate) fn last_gap(&self) -> Option<Gap> {
        locked(&self.last).gap.clone()
    }

    pub(crate) fn reconstruction(&self) -> Reconstruction {
        locked(&self.last).reconstruction
    }
}

/// The value of a counter.
pub(crate) fn read(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}
