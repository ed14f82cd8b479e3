//! Frames that were taken alike share what is the same about them, down to their clock's rate: a frame's own times are then
//! a few bytes.

use rusqlite::Connection;

use crate::row::{Seal, Stretch};
use crate::writer::rows::write_stretch;

/// Beyond so many microseconds a frame's times take more than three bytes: a clock has been set, or the rate is another.
const FAR: i64 = 1 << 23;
/// A stretch is worth a row of its own after so many frames.
const SHORTEST: i64 = 64;
/// How many are remembered: frames may alternate, with and without a map.
const MOST: usize = 8;

/// Cheap to copy: what it was before a transaction that fails is put back.
#[derive(Debug, Clone, Default)]
pub(super) struct Stretches {
    /// The last one used first.
    known: Vec<Stretch>,
    last_id: i64,
}

/// A frame as far as its stretch is concerned, microseconds.
pub(super) struct Standing {
    pub(super) sequence: i64,
    pub(super) monotonic: i64,
    pub(super) wall: i64,
    pub(super) settings: i64,
    pub(super) mapper: Option<i64>,
    pub(super) simulated: bool,
}

/// Where a frame stands: its stretch, its tick and its skew.
pub(super) struct Place {
    pub(super) stretch: i64,
    pub(super) tick: i64,
    pub(super) skew: i64,
}

impl Stretches {
    /// Numbers go on behind those in the file.
    pub(super) fn resume_after(&mut self, last_id: i64) {
        self.last_id = last_id;
    }

    /// The place of a frame, in a new stretch where no known one is like it.
    pub(super) fn place(
        &mut self,
        transaction: &Connection,
        seal: Seal,
        frame: &Standing,
    ) -> rusqlite::Result<Place> {
        let alike = self.known.iter().position(|known| {
            (known.settings, known.mapper, known.simulated)
                == (frame.settings, frame.mapper, frame.simulated)
        });
        let apart = |stretch: &Stretch| {
            let (tick, skew) = stretch.apart(frame.sequence, frame.monotonic, frame.wall);
            Place {
                stretch: stretch.id,
                tick,
                skew,
            }
        };
        if let Some(index) = alike {
            self.known[..=index].rotate_right(1);
            let known = &self.known[0];
            let place = apart(known);
            let near = place.tick.abs() < FAR && place.skew.abs() < FAR;
            if near || frame.sequence - known.sequence < SHORTEST {
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
        write_stretch(transaction, seal, &stretch)?;
        self.last_id = stretch.id;
        let place = apart(&stretch);
        if alike.is_some() {
            self.known.remove(0);
        }
        self.known.insert(0, stretch);
        self.known.truncate(MOST);
        Ok(place)
    }
}
