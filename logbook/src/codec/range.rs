//! A binary range coder whose probabilities are learnt on the way: integers only, so that every machine reads what
//! any machine wrote.
//!
//! The carry is kept back as in LZMA's coder. A blob's last bytes are those that cannot be left out: the decoder reads
//! zeros behind the end.

/// Chance of a 0 from what was seen so far, by the rule of Krichevsky and Trofimov: (zeros + 1/2) / (all + 1).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Bit {
    zeros: u16,
    ones: u16,
}

impl Bit {
    /// As if so many of each had been seen.
    pub(super) const fn seen(zeros: u16, ones: u16) -> Self {
        Self { zeros, ones }
    }

    /// Counts are halved here, far beyond what a frame of a few hundred readings reaches.
    const MOST: u16 = 1 << 14;

    /// In 1/65536, never 0 and never 1.
    fn zero(self) -> u32 {
        let (zeros, ones) = (u32::from(self.zeros), u32::from(self.ones));
        (((2 * zeros + 1) << 16) / (2 * (zeros + ones) + 2)).clamp(1, 0xffff)
    }

    fn learn(&mut self, bit: bool) {
        let count = if bit { &mut self.ones } else { &mut self.zeros };
        *count += 1;
        if *count == Self::MOST {
            self.zeros /= 2;
            self.ones /= 2;
        }
    }
}

/// Below this the range is widened by a byte.
const NARROW: u32 = 1 << 24;

pub(super) struct Encoder {
    low: u64,
    range: u32,
    held: u8,
    /// Bytes 0xff after the held one that a carry would turn over.
    waiting: usize,
    out: Vec<u8>,
}

impl Encoder {
    pub(super) fn new(out: Vec<u8>) -> Self {
        Self {
            low: 0,
            range: u32::MAX,
            held: 0,
            waiting: 0,
            out,
        }
    }

    pub(super) fn learnt(&mut self, bit: bool, model: &mut Bit) {
        let bound = (self.range >> 16) * model.zero();
        if bit {
            self.low += u64::from(bound);
            self.range -= bound;
        } else {
            self.range = bound;
        }
        model.learn(bit);
        self.widen();
    }

    /// The lowest `count` bits of `word`, each as likely 0 as 1.
    pub(super) fn plain(&mut self, word: u64, count: u32) {
        for place in (0..count).rev() {
            self.range >>= 1;
            if word >> place & 1 == 1 {
                self.low += u64::from(self.range);
            }
            self.widen();
        }
    }

    fn widen(&mut self) {
        while self.range < NARROW {
            self.range <<= 8;
            self.shift();
        }
    }

    fn shift(&mut self) {
        let carry = (self.low >> 32) as u8;
        if carry != 0 || (self.low as u32) < 0xff00_0000 {
            self.out.push(self.held.wrapping_add(carry));
            let turned = 0xff_u8.wrapping_add(carry);
            self.out.extend(std::iter::repeat_n(turned, self.waiting));
            self.waiting = 0;
            self.held = (self.low >> 24) as u8;
        } else {
            self.waiting += 1;
        }
        self.low = (self.low & 0x00ff_ffff) << 8;
    }

    /// What was written, after what stood in `out` before. The first byte of the coder's own is always 0 and left out.
    pub(super) fn finish(mut self, began: usize) -> Vec<u8> {
        // Any number in [low, low + range) says the same; the one with most zeros at its end is shortest.
        let last = self.low + u64::from(self.range) - 1;
        let shortest = (0..=32)
            .rev()
            .map(|zeros| {
                let mask = (1_u64 << zeros) - 1;
                (self.low + mask) & !mask
            })
            .find(|number| *number <= last);
        self.low = shortest.unwrap_or(self.low);
        for _ in 0..5 {
            self.shift();
        }
        self.out.remove(began);
        while self.out.len() > began && self.out.last() == Some(&0) {
            self.out.pop();
        }
        self.out
    }
}

pub(super) struct Decoder<'a> {
    code: u32,
    range: u32,
    rest: &'a [u8],
}

impl<'a> Decoder<'a> {
    pub(super) fn new(rest: &'a [u8]) -> Self {
        let mut decoder = Self {
            code: 0,
            range: u32::MAX,
            rest,
        };
        for _ in 0..4 {
            decoder.byte();
        }
        decoder
    }

    fn byte(&mut self) {
        let next = match self.rest.split_first() {
            Some((first, rest)) => {
                self.rest = rest;
                *first
            }
            None => 0,
        };
        self.code = self.code << 8 | u32::from(next);
    }

    pub(super) fn learnt(&mut self, model: &mut Bit) -> bool {
        let bound = (self.range >> 16) * model.zero();
        let bit = self.code >= bound;
        if bit {
            self.code -= bound;
            self.range -= bound;
        } else {
            self.range = bound;
        }
        model.learn(bit);
        self.widen();
        bit
    }

    pub(super) fn plain(&mut self, count: u32) -> u64 {
        let mut word = 0;
        for _ in 0..count {
            self.range >>= 1;
            let bit = self.code >= self.range;
            if bit {
                self.code -= self.range;
            }
            word = word << 1 | u64::from(bit);
            self.widen();
        }
        word
    }

    fn widen(&mut self) {
        while self.range < NARROW {
            self.range <<= 8;
            self.byte();
        }
    }

    /// Whether bytes are left that no number was read from.
    pub(super) fn has_rest(&self) -> bool {
        !self.rest.is_empty()
    }
}
