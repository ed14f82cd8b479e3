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

/// The properties that assign a frame to a stretch; times in microseconds.
pub(super) struct StretchKey {
    pub(super) sequence: i64,
    pub(super) monotonic: i64,
    pub(super) wall: i64,
    pub(super) settings: i64,
    pub(super) mapper: Option<i64>,
    pub(super) simulated: bool,
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

    /// The position of a frame, in a new stretch if no known one matches.
    pub(super) fn place(
        &mut self,
        transaction: &Connection,
        header_checksum: HeaderChecksum,
        frame: &StretchKey,
    ) -> rusqlite::Result<StretchPosition> {
        let alike = self.known.iter().position(|known| {
            (known.settings, known.mapper, known.simulated)
                == (frame.settings, frame.mapper, frame.simulated)
        });
        let apart = |stretch: &Stretch| {
            let (tick, skew) = stretch.apart(frame.sequence, frame.monotonic, frame.wall);
            StretchPosition {
                stretch: stretch.id,
                tick,
                skew,
            }
        };
        if let Some(index) = alike {
            self.known[..=index].rotate_right(1);
            let known = &self.known[0];
            let place = apart(known);
            let near = place.tick.abs() < WIDE_US && place.skew.abs() < WIDE_US;
            if near || frame.sequence - known.sequence < MIN_FRAMES {
                return Ok(place);
            }
        }
        let period = self.known.first().map_or(0, |last| {
            let frames = frame.sequence - last.sequence;
            let since = frame.monotonic - last.monotonic;
            if frames > 0 && since >= 0 {
                since / frames
            } else {
                last.period
            }
        });
        let stretch = Stretch {
            id: self.last_id + 1,
            settings: frame.settings,
            mapper: frame.mapper,
            simulated: frame.simulated,
            sequence: frame.sequence,
            monotonic: frame.monotonic,
            wall: frame.wall,
            period,
        };
        write_stretch(transaction, header_checksum, &stretch)?;
        self.last_id = stretch.id;
        let place = apart(&stretch);
        if alike.is_some() {
            self.known.remove(0);
        }
        self.known.insert(0, stretch);
        self.known.truncate(REMEMBERED_STRETCHES);
        Ok(place)
    }
}
