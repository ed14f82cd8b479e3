//! Differences as bits: how many binary digits, then the first two after the leading one, both learnt; then the other
//! digits and the sign as they are. Learnt apart for each power of ten, since noise in volts counts ten times as many
//! units of a digit further down. Learning starts from normal noise of the frame's own size, not from nothing: that is
//! worth a tenth of a bit a reading. Integers only: every machine must begin with the same chances.

use super::range::{Bit, Decoder, Encoder};

/// Powers of ten above the grid that are told apart; those further up share the last.
const POWERS: usize = 8;
/// Nodes of the tree that a number of digits (0 to 64) is found in, seven decisions deep.
const NODES: usize = 128;
/// Contexts of the two learnt digits: three a number of digits.
const DIGITS: usize = 65 * 3;

/// Share of normal noise below 2^(k/16) of its mean size, in 1/65536, for k = -96 to 40:
/// erf(2^(k/16) / sqrt(pi)).
const BELOW: [u16; 137] = [
    652, 681, 711, 742, 775, 810, 845, 883, 922, 963, 1005, 1050, 1096, 1145, 1195, 1248, 1304,
    1361, 1422, 1485, 1550, 1619, 1691, 1765, 1843, 1925, 2010, 2099, 2192, 2289, 2390, 2496, 2607,
    2722, 2842, 2968, 3099, 3236, 3379, 3529, 3685, 3847, 4017, 4195, 4380, 4574, 4776, 4987, 5207,
    5436, 5676, 5926, 6187, 6460, 6744, 7041, 7351, 7674, 8011, 8363, 8730, 9113, 9512, 9928,
    10362, 10814, 11285, 11777, 12289, 12822, 13377, 13955, 14557, 15184, 15836, 16514, 17218,
    17950, 18711, 19501, 20320, 21170, 22051, 22963, 23908, 24884, 25893, 26935, 28008, 29114,
    30252, 31421, 32620, 33848, 35103, 36383, 37687, 39012, 40354, 41710, 43077, 44450, 45823,
    47192, 48552, 49895, 51216, 52508, 53763, 54976, 56140, 57247, 58292, 59269, 60174, 61002,
    61752, 62422, 63013, 63525, 63962, 64328, 64628, 64869, 65059, 65204, 65311, 65389, 65443,
    65480, 65503, 65518, 65526, 65531, 65534, 65535, 65535,
];

/// Sixteenths of an octave in a power of ten, 16 log2 10.
const POWER_OF_TEN: i32 = 53;
/// What the first guess weighs, in readings.
const GUESS: u32 = 256;

/// Mean size of a frame's differences, in sixteenths of an octave: 0 for one unit of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Scale(pub(super) u16);

impl Scale {
    /// Of differences, each with its power of ten above the grid. By the median, which a few large ones do not move.
    pub(super) fn of(differences: impl IntoIterator<Item = (i64, i16)>) -> Self {
        let mut sizes: Vec<u16> = differences
            .into_iter()
            .map(|(difference, above)| {
                let size = sixteenths(difference.unsigned_abs());
                size.saturating_add_signed(above.saturating_mul(POWER_OF_TEN as i16))
            })
            .collect();
        if sizes.is_empty() {
            return Self(0);
        }
        let middle = sizes.len() / 2;
        let (_, median, _) = sizes.select_nth_unstable(middle);
        // The mean size of normal noise is 0.24 octaves above its median.
        Self(*median + 4)
    }
}

/// 16 log2 of a size, to about one; 0 for 0 and 1.
fn sixteenths(size: u64) -> u16 {
    let Some(log) = size.checked_ilog2() else {
        return 0;
    };
    // The next four digits after the leading one, as if the logarithm were straight between powers of two.
    let digits = if log >= 4 {
        size >> (log - 4) & 15
    } else {
        size << (4 - log) & 15
    };
    (16 * log) as u16 + digits as u16
}

pub(super) struct Model {
    scale: Scale,
    powers: [Option<Box<Chances>>; POWERS],
}

struct Chances {
    lengths: [Bit; NODES],
    digits: [Bit; DIGITS],
}

impl Chances {
    /// Of normal noise whose mean size is 2^(scale/16) units.
    fn new(scale: i32) -> Self {
        let below = |edge: i32| match edge - scale + 96 {
            index @ 0..=136 => u32::from(BELOW[index as usize]),
            ..0 => 0,
            _ => 65_535,
        };
        // Where numbers of so many digits begin, in sixteenths of an octave; half a unit below, as they are rounded.
        let begin = |length: usize| match length {
            0 => i32::MIN / 2,
            1 => -16,
            2 => 9,
            3 => 29,
            _ => 16 * (length as i32 - 1),
        };
        let mut chances = Self {
            lengths: [Bit::default(); NODES],
            digits: [Bit::default(); DIGITS],
        };
        let mut weights = [0_u32; NODES];
        for (length, weight) in weights.iter_mut().enumerate().take(65) {
            *weight = below(begin(length + 1)) - below(begin(length));
        }
        for node in 1..NODES {
            // The leaves under a node, left and right.
            let depth = node.ilog2();
            let leaves = NODES >> depth;
            let first = (node << (7 - depth)) - NODES;
            let (left, right) = weights[first..first + leaves].split_at(leaves / 2);
            chances.lengths[node] = guess(left.iter().sum(), right.iter().sum());
        }
        for length in 2..65 {
            let from = 16 * (length as i32 - 1);
            // log2 of 1, 5/4, 3/2, 7/4, 2 in sixteenths.
            let edges = [0, 5, 9, 13, 16].map(|part| below(from + part));
            let share = |a: usize, b: usize| edges[b] - edges[a];
            chances.digits[3 * length] = guess(share(0, 2), share(2, 4));
            chances.digits[3 * length + 1] = guess(share(0, 1), share(1, 2));
            chances.digits[3 * length + 2] = guess(share(2, 3), share(3, 4));
        }
        chances
    }
}

/// As if so many of [`GUESS`] readings had been seen as come to this decision.
fn guess(zeros: u32, ones: u32) -> Bit {
    let seen = |share: u32| ((share * GUESS + 32_768) >> 16) as u16;
    Bit::seen(seen(zeros), seen(ones))
}

impl Model {
    pub(super) fn new(scale: Scale) -> Self {
        Self {
            scale,
            powers: Default::default(),
        }
    }

    fn at(&mut self, above_grid: i16) -> &mut Chances {
        let power = usize::try_from(above_grid).unwrap_or(0).min(POWERS - 1);
        let scale = i32::from(self.scale.0) - POWER_OF_TEN * power as i32;
        self.powers[power].get_or_insert_with(|| Box::new(Chances::new(scale)))
    }

    pub(super) fn write(&mut self, encoder: &mut Encoder, difference: i64, above_grid: i16) {
        let chances = self.at(above_grid);
        let size = difference.unsigned_abs();
        let length = 64 - size.leading_zeros();
        let mut node = 1;
        for place in (0..7).rev() {
            let bit = length >> place & 1 == 1;
            encoder.learnt(bit, &mut chances.lengths[node]);
            node = 2 * node + usize::from(bit);
        }
        let Some(mut left) = length.checked_sub(1) else {
            return;
        };
        let mut context = 0;
        while left > 0 && context < 3 {
            left -= 1;
            let bit = size >> left & 1 == 1;
            encoder.learnt(bit, &mut chances.digits[length as usize * 3 + context]);
            context = if context == 0 {
                1 + usize::from(bit)
            } else {
                3
            };
        }
        encoder.plain(size, left);
        encoder.plain(u64::from(difference < 0), 1);
    }

    /// `None` where the bits are none that [`Model::write`] makes.
    pub(super) fn read(&mut self, decoder: &mut Decoder<'_>, above_grid: i16) -> Option<i64> {
        let chances = self.at(above_grid);
        let mut node = 1;
        for _ in 0..7 {
            node = 2 * node + usize::from(decoder.learnt(&mut chances.lengths[node]));
        }
        let length = (node - NODES) as u32;
        if length > 64 {
            return None;
        }
        let Some(mut left) = length.checked_sub(1) else {
            return Some(0);
        };
        let mut size = 1_u64;
        let mut context = 0;
        while left > 0 && context < 3 {
            left -= 1;
            let bit = decoder.learnt(&mut chances.digits[length as usize * 3 + context]);
            size = size << 1 | u64::from(bit);
            context = if context == 0 {
                1 + usize::from(bit)
            } else {
                3
            };
        }
        if left > 0 {
            size = size << left | decoder.plain(left);
        }
        let negative = decoder.plain(1) == 1;
        match (negative, i64::try_from(size)) {
            (false, Ok(size)) => Some(size),
            (true, Ok(size)) => Some(-size),
            (true, Err(_)) if size == 1 << 63 => Some(i64::MIN),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_is_the_mean_size_of_normal_noise() {
        // 1, 2, .. 33: median 17, so a mean of 17 x 1.18 = 20.2, which is 2^4.33.
        let differences: Vec<_> = (1..=33).map(|size| (size, 0)).collect();
        let scale = f64::from(Scale::of(differences.iter().copied()).0) / 16.0;
        assert!((scale - 4.33).abs() < 0.1, "{scale}");
        // Ten times as many units of a digit further down are the same noise.
        let further_up: Vec<_> = (1..=33).map(|size| (size, 1)).collect();
        assert_eq!(
            Scale::of(further_up).0,
            Scale::of(differences.iter().copied()).0 + 53
        );
        assert_eq!(Scale::of([]), Scale(0));
        assert!(
            Scale::of([(i64::MIN, i16::MAX)]).0 > 60_000 || Scale::of([(i64::MIN, 300)]).0 > 1000
        );
    }
}
