//! Bounds of the numeric options of training commands. The memory that they need is compared with the machine's before
//! work begins.

use survey::Bounds;

/// Simulated cases: the most take hours.
pub(crate) fn cases(text: &str) -> Result<usize, String> {
    Bounds::Within(1.0, 1e7).parse_count(text)
}

/// A count that may be zero.
pub(crate) fn any_count(text: &str) -> Result<usize, String> {
    Bounds::Within(0.0, 1e7).parse_count(text)
}

/// Jittered copies of each case.
pub(crate) fn repeats(text: &str) -> Result<usize, String> {
    Bounds::Within(1.0, 1e3).parse_count(text)
}

/// Passes over a training set.
pub(crate) fn epochs(text: &str) -> Result<usize, String> {
    Bounds::Within(1.0, 1e5).parse_count(text)
}

/// Neurons of an RBF network.
pub(crate) fn neurons(text: &str) -> Result<usize, String> {
    Bounds::Within(1.0, 1e5).parse_count(text)
}

/// Width of the neurons as a multiple of the spread of Eq. 13.
pub(crate) fn spread_times(text: &str) -> Result<f64, String> {
    Bounds::Above(0.0, 1e3).parse(text)
}

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
pub(crate) fn loss(text: &str) -> Result<f64, String> {
    Bounds::Above(0.0, 1.0).parse(text)
}

/// Noise of one reading, uV.
pub(crate) fn noise_uv(text: &str) -> Result<f64, String> {
    Bounds::Above(0.0, 1e6).parse(text)
}

/// Virtual days.
pub(crate) fn days(text: &str) -> Result<f64, String> {
    Bounds::Within(0.0, 3650.0).parse(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_are_refused_with_what_is_allowed() {
        for text in ["1e11", "0", "-1", "1.5", "nan", "x"] {
            let refusal = cases(text).unwrap_err();
            assert!(refusal.contains("from 1 to 10000000"), "{text}: {refusal}");
        }
        assert_eq!(cases("15000"), Ok(15_000));
        assert_eq!(cases("1e5"), Ok(100_000));
        assert!(noise_v("0").unwrap_err().contains("2e-6"));
        assert!(gamma("inf").is_err() && repeats("1e4").is_err());
    }
}
