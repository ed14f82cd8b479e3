//! Bounds of the numeric options of training commands. The memory that they need is compared with the machine's before
//! work begins.

use survey::Bounds;

/// Simulated cases: the most take hours.
pub(crate) const CASES: Bounds = Bounds::Within(1.0, 1e7);
/// A count that may be zero.
pub(crate) const ANY_COUNT: Bounds = Bounds::Within(0.0, 1e7);
/// Jittered copies of each case.
pub(crate) const REPEATS: Bounds = Bounds::Within(1.0, 1e3);
/// Passes over a training set.
pub(crate) const EPOCHS: Bounds = Bounds::Within(1.0, 1e5);
/// Neurons of an RBF network.
pub(crate) const NEURONS: Bounds = Bounds::Within(1.0, 1e5);
/// Width of the neurons as a multiple of the spread of Eq. 13.
pub(crate) const SPREAD_TIMES: Bounds = Bounds::Above(0.0, 1e3);

/// Jitter of the profile `paper`: parts of the standard deviation of the normalised baseline.
pub(crate) fn gamma(text: &str) -> Result<f64, String> {
    Bounds::Above(0.0, 100.0)
        .parse(text)
        .map_err(|refusal| format!("{refusal}; the paper's is 0.01"))
}

/// Noise of one reading, V. That it is below the readings of the case is checked where the case is known.
pub(crate) fn noise_v(text: &str) -> Result<f64, String> {
    Bounds::Above(0.0, 1e3)
        .parse(text)
        .map_err(|refusal| format!("{refusal}, in volts: 2 uV are 2e-6"))
}

/// Relative loss of conductance.
pub(crate) const LOSS: Bounds = Bounds::Above(0.0, 1.0);
/// Noise of one reading, uV.
pub(crate) const NOISE_UV: Bounds = Bounds::Above(0.0, 1e6);
/// Virtual days.
pub(crate) const DAYS: Bounds = Bounds::Within(0.0, 3650.0);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_are_refused_with_what_is_allowed() {
        for text in ["1e11", "0", "-1", "1.5", "nan", "x"] {
            let refusal = CASES.parse_count(text).unwrap_err();
            assert!(refusal.contains("from 1 to 10000000"), "{text}: {refusal}");
        }
        assert_eq!(CASES.parse_count("15000"), Ok(15_000));
        assert_eq!(CASES.parse_count("1e5"), Ok(100_000));
        assert!(noise_v("0").unwrap_err().contains("2e-6"));
        assert!(gamma("inf").is_err() && REPEATS.parse_count("1e4").is_err());
    }
}
