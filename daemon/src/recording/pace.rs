//! Times of the frames of a session.

use std::time::Duration;

/// Times of frames, by the daemon's clock.
#[derive(Debug, Default)]
pub(crate) struct Pace {
    /// Time from which a frame is expected: the start, or the end of the last suspension.
    pub from: Duration,
    /// Frames of this daemon; a resumed session also has those of the daemon before.
    frames: u32,
    first: Option<Duration>,
    last: Option<Duration>,
}

impl Pace {
    /// No frame yet; one is expected from this time on.
    pub(crate) fn from(from: Duration) -> Self {
        Self {
            from,
            ..Self::default()
        }
    }

    /// Counts a frame that began at this time.
    pub(crate) fn count(&mut self, began: Duration) {
        self.frames = self.frames.saturating_add(1);
        self.first.get_or_insert(began);
        self.last = Some(began);
    }

    /// Mean time from frame to frame; `None` before the second frame.
    pub(crate) fn period(&self) -> Option<Duration> {
        let spanned = self.last?.saturating_sub(self.first?);
        spanned.checked_div(self.frames.saturating_sub(1))
    }
}
