//! Van der Pauw's formula: exp(-pi R1 / Rs) + exp(-pi R2 / Rs) = 1 (physics-and-hard-cases.md, section 5).

use std::f64::consts::PI;

/// Sheet resistance from two four-point resistances, ohm; `None` if they are not positive numbers.
///
/// The left side grows with Rs from 0 to 2 and crosses 1 once, between pi R1 / ln 2 and pi R2 / ln 2 (the solutions for
/// two equal resistances).
pub fn sheet_resistance(first: f64, second: f64) -> Option<f64> {
    let sound = |value: f64| value.is_finite() && value > 0.0;
    if !(sound(first) && sound(second)) {
        return None;
    }
    let alone = |value: f64| PI * value / std::f64::consts::LN_2;
    let (mut low, mut high) = (alone(first.min(second)), alone(first.max(second)));
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        let sum = (-PI * first / middle).exp() + (-PI * second / middle).exp();
        if sum < 1.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(0.5 * (low + high))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn van_der_pauw_solves_equal_and_unequal_resistances() {
        let square = sheet_resistance(220.635_600, 220.635_600).unwrap();
        assert!((square - 220.635_600 * PI / std::f64::consts::LN_2).abs() < 1e-9);
        let oblong = sheet_resistance(100.0, 400.0).unwrap();
        let sum = (-PI * 100.0 / oblong).exp() + (-PI * 400.0 / oblong).exp();
        assert!((sum - 1.0).abs() < 1e-12, "{sum}");
        assert_eq!(sheet_resistance(0.0, 1.0), None);
        assert_eq!(sheet_resistance(f64::NAN, 1.0), None);
    }
}
