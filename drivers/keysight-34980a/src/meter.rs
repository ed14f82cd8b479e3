//! Data of the internal voltmeter: DC ranges, integration times, resolution.

use std::time::Duration;

use survey::{Timing, Volts};

/// DC voltage ranges, V (section 5).
pub const RANGES: [f64; 5] = [0.1, 1.0, 10.0, 100.0, 300.0];

/// Overrange as a factor of the range (section 5: 20 %).
pub const OVERRANGE: f64 = 1.2;

/// Integration times, power-line cycles, and the resolution of each as a fraction of the range: the table "Custom A/D
/// integration time" of the guide of the 34970A, which has the same integration times and digits. The resolution is
/// used as the standard deviation of a reading.
pub const INTEGRATION: [(f64, f64); 8] = [
    (0.02, 1e-4),
    (0.2, 1e-5),
    (1.0, 3e-6),
    (2.0, 2.2e-6),
    (10.0, 1e-6),
    (20.0, 8e-7),
    (100.0, 3e-7),
    (200.0, 2.2e-7),
];

/// The smallest range, V, that reads this voltage with its overrange; the largest range if none does.
pub fn range_for(most: Volts) -> Volts {
    let fits = RANGES.into_iter().find(|range| range * OVERRANGE >= most.0);
    Volts(fits.unwrap_or(RANGES[RANGES.len() - 1]))
}

/// Resolution as a fraction of the range for an integration time in power-line cycles: log-log interpolation between
/// the points of [`INTEGRATION`], the nearest point beyond them.
///
/// ```
/// assert_eq!(keysight_34980a::resolution(2.0), 2.2e-6);
/// ```
pub fn resolution(nplc: f64) -> f64 {
    let nplc = nplc.clamp(INTEGRATION[0].0, INTEGRATION[INTEGRATION.len() - 1].0);
    let upper = INTEGRATION
        .iter()
        .position(|(at, _)| *at >= nplc)
        .unwrap_or(INTEGRATION.len() - 1);
    let (right, high) = INTEGRATION[upper];
    if right == nplc {
        return high;
    }
    let (left, low) = INTEGRATION[upper - 1];
    let share = (nplc / left).ln() / (right / left).ln();
    low * (high / low).powf(share)
}

/// Time of single readings without relay moves, at most 3,000 readings a second (section 5).
pub fn reading_timing(nplc: f64, line_hz: f64) -> Timing {
    Timing {
        reading_period: Duration::from_secs(1) / 3000,
        ..Timing::ideal(nplc, line_hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resolution_meets_and_joins_the_table() {
        assert_eq!(resolution(1.0), 3e-6);
        assert_eq!(resolution(0.001), 1e-4);
        assert_eq!(resolution(1000.0), 2.2e-7);
        let between = resolution(5.0);
        assert!(between < 2.2e-6 && between > 1e-6);
    }

    #[test]
    fn range_holds_a_fifth_more_than_its_name() {
        assert_eq!(range_for(Volts(12.0)), Volts(10.0));
        assert_eq!(range_for(Volts(12.1)), Volts(100.0));
        assert_eq!(range_for(Volts(1e3)), Volts(300.0));
    }
}
