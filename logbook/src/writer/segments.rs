//! Stretches: frames taken with the same settings share a row, which includes the rate of their clock, so that the
//! times of each frame take a few bytes.

use rusqlite::Connection;

use crate::row::{HeaderChecksum, Stretch};
use crate::writer::rows::write_stretch;

/// Beyond this many microseconds a frame's times take more than three bytes: a clock was set, or the rate changed.
const WIDE_US: i64 = 1 << 23;
/// Number of frames after which a new stretch is worth its row.
const MIN_FRAMES: i64 = 64;
/// Number of stretches remembered: frames with and without a map may alternate.
const REMEMBERED_STRETCHES: usize = 8;

/// Cheap to clone: the old value is restored if a transaction fails.
#[derive(Debug, Clone, Default)]
pub(super) struct Stretches {
    /// Most recently used first.
    known: Vec<Stretch>,
    last_id: i64,
}

/// A frame's stretch, tick and skew.
pub(super) struct StretchPosition {
    pub(super) stretch: i64,
    pub(super) tick: i64,
    pub(super) skew: i64,
}

impl Stretches {
    /// Continues the numbers after those in the file.
    pub(super) fn resume_after(&mut self, last_id: i64) {
        self.last_id = last_id;
    }

    /// The position of a frame. `new` is the stretch that begins with it if no known one matches; its id and period
    /// are set then.
    pub(super) fn place(
        &mut self,
        transaction: &Connection,
        header_checksum: HeaderChecksum,
        mut new: Stretch,
    ) -> rusqlite::Result<StretchPosition> {
        let alike = self.known.iter().position(|known| {
            (known.settings, known.mapper, known.simulated)
                == (new.settings, new.mapper, new.simulated)
        });
        if let Some(index) = alike {
            self.known[..=index].rotate_right(1);
            let known = &self.known[0];
            let (tick, skew) = known.apart(new.sequence, new.monotonic, new.wall);
            let near = tick.abs() < WIDE_US && skew.abs() < WIDE_US;
            if near || new.sequence - known.sequence < MIN_FRAMES {
                return Ok(StretchPosition {
                    stretch: known.id,
                    tick,
                    skew,
                });
            }
        }
        new.id = self.last_id + 1;
        new.period = self.known.first().map_or(0, |last| {
            let frames = new.sequence - last.sequence;
            let since = new.monotonic - last.monotonic;
            if frames > 0 && since >= 0 {
                since / frames
            } else {
                last.period
            }
        });
        write_stretch(transaction, header_checksum, &new)?;
        self.last_id = new.id;
        let place = StretchPosition {
            stretch: new.id,
            tick: 0,
            skew: 0,
        };
        if alike.is_some() {
            self.known.remove(0);
        }
        self.known.insert(0, new);
        self.known.truncate(REMEMBERED_STRETCHES);
        Ok(place)
    }
}
