//! Ranges and limits of the instrument (fact sheet, section 7).

use survey::{Amps, SourceLimits, Volts};

/// Largest current of either sign: 5 % above the 100 mA range.
pub const LARGEST_CURRENT: Amps = Amps(0.105);
/// Smallest voltage limit.
pub const SMALLEST_LIMIT: Volts = Volts(0.1);
/// Largest voltage limit.
pub const LARGEST_LIMIT: Volts = Volts(105.0);
/// Limits of the current and of the voltage limit, for checking a plan.
pub const LIMITS: SourceLimits = SourceLimits {
    current: LARGEST_CURRENT,
    compliance: (SMALLEST_LIMIT, LARGEST_LIMIT),
};
/// Step of the voltage limit.
pub const LIMIT_STEP: Volts = Volts(0.01);

/// A range of the source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Nominal full scale; the range holds levels up to 5 % above it.
    pub full_scale: Amps,
    /// Step of the level.
    pub step: Amps,
}

const fn range(full_scale: f64, step: f64) -> Range {
    Range {
        full_scale: Amps(full_scale),
        step: Amps(step),
    }
}

/// All ranges, ascending.
pub const RANGES: [Range; 9] = [
    range(2e-9, 100e-15),
    range(20e-9, 1e-12),
    range(200e-9, 10e-12),
    range(2e-6, 100e-12),
    range(20e-6, 1e-9),
    range(200e-6, 10e-9),
    range(2e-3, 100e-9),
    range(20e-3, 1e-6),
    range(100e-3, 10e-6),
];

impl Range {
    /// The smallest range that holds this level, including the 5 % above full scale; `None` beyond 105 mA and for NaN.
    pub fn holding(level: Amps) -> Option<Range> {
        RANGES.into_iter().find(|range| range.holds(level))
    }

    /// The range with this nominal full scale, as read back with seven digits; `None` if there is none.
    pub fn named(full_scale: Amps) -> Option<Range> {
        RANGES
            .into_iter()
            .find(|range| (full_scale.0 / range.full_scale.0 - 1.0).abs() < 1e-5)
    }

    /// Whether the level is within the range.
    pub fn holds(self, level: Amps) -> bool {
        level.abs() <= self.most()
    }

    /// Largest level of this range: 5 % above its full scale.
    pub fn most(self) -> Amps {
        // In binary, 1.05 is slightly above its decimal value and 2e-9 * 1.05 slightly below: a relative tolerance of
        // 1e-9 keeps 2.1 nA on the 2 nA range.
        self.full_scale * (1.05 * (1.0 + 1e-9))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_range_holds_five_per_cent_over_and_no_more() {
        for (range, next) in RANGES.iter().zip(&RANGES[1..]) {
            let level = range.full_scale * 1.05;
            assert_eq!(Range::holding(level), Some(*range));
            assert_eq!(Range::holding(-level), Some(*range));
            assert_eq!(Range::holding(level * 1.001), Some(*next));
        }
        assert_eq!(Range::holding(LARGEST_CURRENT), Some(RANGES[8]));
        assert_eq!(Range::holding(Amps(0.1051)), None);
        assert_eq!(Range::holding(Amps(f64::NAN)), None);
    }
}
