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
pub(crate) const FILM_SPEED: Bounds = Bounds::Within(0.001, 1e6);
/// Integration time, power-line cycles; the valid values depend on the voltmeter.
pub(crate) const NPLC: Bounds = Bounds::Within(0.001, 1000.0);
/// A length, mm.
pub(crate) const MILLIMETRES: Bounds = Bounds::Within(0.01, 20e3);
/// An angle, degrees.
pub(crate) const DEGREES: Bounds = Bounds::Within(-360.0, 360.0);
/// Pixels along a side.
pub(crate) const PIXELS: Bounds = Bounds::Within(2.0, 4096.0);
/// Electrodes of a ring.
pub(crate) const ELECTRODES: Bounds = Bounds::Within(2.0, 256.0);

#[cfg(test)]
mod tests {
    use crate::options::numbers::*;

    #[test]
    fn extremes_are_refused_with_what_is_allowed() {
        let bounds = [FILM_SPEED, NPLC, MILLIMETRES, DEGREES];
        for text in ["inf", "-inf", "nan", "1e308", "-1e308", "1e999", "", "x"] {
            let others = bounds.map(|bounds| bounds.parse(text));
            for refused in others.into_iter().chain([speed(text)]) {
                let refusal = refused.unwrap_err();
                assert!(refusal.contains("it must be "), "{text}: {refusal}");
            }
            let refusal = ELECTRODES.parse_count(text).unwrap_err();
            assert!(refusal.contains("2 to 256"), "{text}: {refusal}");
        }
        assert!(ELECTRODES.parse_count("18446744073709551615").is_err());
        assert_eq!(ELECTRODES.parse_count("26"), Ok(26));
        assert_eq!(NPLC.parse("0.02"), Ok(0.02));
    }
}
