//! What is coded beside the differences, where a frame has any of it: flags, raw voltages, moved powers of ten. All rare,
//! so a learnt decision a reading costs next to nothing until it is taken.

use crate::codec::range::{Bit, Decoder, Encoder};

/// As if so many ordinary readings had been seen.
const RARE: Bit = Bit::seen(300, 0);
/// A power of ten moves by no more than `f64` has; beyond it the bits are damage.
const FURTHEST: i16 = 1000;

pub(super) struct Beside {
    /// Whether a reading is not ok, by whether the one before was not: flagged readings stand together.
    flagged: [Bit; 2],
    flag: [Bit; 2],
    before: usize,
    raw: [Bit; 2],
    raw_before: usize,
    moved: Bit,
    down: Bit,
    further: Bit,
}

impl Default for Beside {
    fn default() -> Self {
        Self {
            flagged: [Bit::seen(30, 0), Bit::default()],
            flag: [Bit::default(); 2],
            before: 0,
            raw: [Bit::seen(4, 0), Bit::default()],
            raw_before: 0,
            moved: RARE,
            down: Bit::default(),
            further: RARE,
        }
    }
}

impl Beside {
    pub(super) fn write_flag(&mut self, encoder: &mut Encoder, flag: u8) {
        encoder.learnt(flag != 0, &mut self.flagged[self.before]);
        self.before = usize::from(flag != 0);
        if flag != 0 {
            encoder.learnt(flag != 1, &mut self.flag[0]);
            if flag != 1 {
                encoder.learnt(flag != 2, &mut self.flag[1]);
            }
        }
    }

    pub(super) fn read_flag(&mut self, decoder: &mut Decoder<'_>) -> u8 {
        let flagged = decoder.learnt(&mut self.flagged[self.before]);
        self.before = usize::from(flagged);
        if !flagged {
            return 0;
        }
        match decoder.learnt(&mut self.flag[0]) {
            false => 1,
            true => 2 + u8::from(decoder.learnt(&mut self.flag[1])),
        }
    }

    pub(super) fn write_raw(&mut self, encoder: &mut Encoder, raw: bool) {
        encoder.learnt(raw, &mut self.raw[self.raw_before]);
        self.raw_before = usize::from(raw);
    }

    pub(super) fn read_raw(&mut self, decoder: &mut Decoder<'_>) -> bool {
        let raw = decoder.learnt(&mut self.raw[self.raw_before]);
        self.raw_before = usize::from(raw);
        raw
    }

    pub(super) fn write_moved(&mut self, encoder: &mut Encoder, moved: i16) {
        encoder.learnt(moved != 0, &mut self.moved);
        if moved == 0 {
            return;
        }
        encoder.learnt(moved < 0, &mut self.down);
        for _ in 1..moved.unsigned_abs() {
            encoder.learnt(true, &mut self.further);
        }
        encoder.learnt(false, &mut self.further);
    }

    /// `None` where the bits are none that [`Beside::write_moved`] makes.
    pub(super) fn read_moved(&mut self, decoder: &mut Decoder<'_>) -> Option<i16> {
        if !decoder.learnt(&mut self.moved) {
            return Some(0);
        }
        let down = decoder.learnt(&mut self.down);
        let mut by = 1;
        while decoder.learnt(&mut self.further) {
            by += 1;
            if by > FURTHEST {
                return None;
            }
        }
        Some(if down { -by } else { by })
    }
}
