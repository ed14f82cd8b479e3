//! Ranges of numbers on the command line; the daemon checks its input independently.

use survey::Bounds;

/// Speed of a recording.
pub(crate) fn speed(text: &str) -> Result<f64, String> {
    let meaning = "1 is the recording's own rate, 10 ten times faster, 0 as fast as possible";
    Bounds::Within(0.0, 1e6)
        .parse(text)
        .map_err(|refusal| format!("{refusal}: {meaning}"))
}

/// Ratio of the speed of a film to that of the session.
pub(crate) fn film_speed(text: &str) -> Result<f64, String> {
    Bounds::Within(0.001, 1e6).parse(text)
}

/// Integration time, power-line cycles; the valid values depend on the voltmeter.
pub(crate) fn nplc(text: &str) -> Result<f64, String> {
    Bounds::Within(0.001, 1000.0).parse(text)
}

/// A length, mm.
pub(crate) fn millimetres(text: &str) -> Result<f64, String> {
    Bounds::Within(0.01, 20e3).parse(text)
}

/// An angle, degrees.
pub(crate) fn degrees(text: &str) -> Result<f64, String> {
    Bounds::Within(-360.0, 360.0).parse(text)
}

/// Pixels along a side.
pub(crate) fn pixels(text: &str) -> Result<usize, String> {
    Bounds::Within(2.0, 4096.0).parse_count(text)
}

/// Electrodes of a ring.
pub(crate) fn electrodes(text: &str) -> Result<usize, String> {
    Bounds::Within(2.0, 256.0).parse_count(text)
}

#[cfg(test)]
mod tests {
    use crate::options::numbers::*;

    #[test]
    fn extremes_are_refused_with_what_is_allowed() {
        let parsers = [speed, film_speed, nplc, millimetres, degrees];
        for text in ["inf", "-inf", "nan", "1e308", "-1e308", "1e999", "", "x"] {
            for parse in parsers {
                let refusal = parse(text).unwrap_err();
                assert!(refusal.contains("it must be "), "{text}: {refusal}");
            }
            assert!(electrodes(text).unwrap_err().contains("2 to 256"));
        }
        assert!(electrodes("18446744073709551615").is_err());
        assert_eq!(electrodes("26"), Ok(26));
        assert_eq!(nplc("0.02"), Ok(0.02));
    }
}
