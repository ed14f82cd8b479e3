//! Voltages as the decimals of nine digits that a voltmeter sends: an integer over a power of ten.

/// Powers of ten up to this one are exact in an `f64`.
pub(super) const MOST_PLACES: u8 = 22;
/// Integers below this one are exact in an `f64`, so that a quotient of two exact numbers is rounded once.
pub(super) const INTEGERS: f64 = (1_u64 << 53) as f64;

const POWERS: [f64; MOST_PLACES as usize + 1] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

/// 10^places; places beyond [`MOST_PLACES`] count as that many.
fn power(places: u8) -> f64 {
    POWERS[usize::from(places.min(MOST_PLACES))]
}

/// Returns integer / 10^places.
pub(super) fn value(integer: i64, places: u8) -> f64 {
    integer as f64 / power(places)
}

/// The integer whose [`value`] has the same bits as the voltage; `None` if there is none below 2^53.
pub(super) fn integer(volts: f64, places: u8) -> Option<i64> {
    let scaled = (volts * power(places)).round_ties_even();
    let integer = scaled as i64;
    (scaled.abs() < INTEGERS && value(integer, places).to_bits() == volts.to_bits())
        .then_some(integer)
}

/// The integer predicted from a reference at this number of places; 0 if the reference is too large.
pub(super) fn predicted(reference: f64, places: u8) -> i64 {
    let scaled = (reference * power(places)).round_ties_even();
    if scaled.abs() < INTEGERS {
        scaled as i64
    } else {
        0
    }
}

/// Decimal places of a voltage's ninth digit, 0 to [`MOST_PLACES`], whether or not it has more digits; `None` for zero.
pub(super) fn ninth_digit(volts: f64) -> Option<u8> {
    if volts == 0.0 {
        return None;
    }
    // from the rounded digits: 9.9999999996 has the exponent of 10
    let text = format!("{volts:.8e}");
    let exponent: i16 = text.split_once('e')?.1.parse().ok()?;
    Some((8 - exponent).clamp(0, i16::from(MOST_PLACES)) as u8)
}

/// The fewest decimal places that represent a nine-digit decimal; `None` for zero and for any other number.
pub(super) fn places(volts: f64) -> Option<u8> {
    let size = volts.abs();
    if size == 0.0 {
        return None;
    }
    // a logarithm rounded up at a power of ten yields one digit too few; the next place is then tried
    let guess = (8.0 - size.log10().floor()).clamp(0.0, f64::from(MOST_PLACES)) as u8;
    let (mut integer, mut places) = [guess, guess.saturating_add(1).min(MOST_PLACES)]
        .into_iter()
        .find_map(|places| Some((integer(volts, places)?, places)))?;
    while places > 0 && integer % 10 == 0 {
        integer /= 10;
        places -= 1;
    }
    Some(places)
}

/// The most places at which integers of that size stay exact.
pub(super) fn most_places(largest: f64) -> u8 {
    let fits = |places: &u8| largest * power(*places) < INTEGERS;
    (0..=MOST_PLACES).rev().find(fits).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decimal_is_found_with_the_fewest_places() {
        for (volts, wanted) in [
            (0.1234567, Some(7)),
            (-0.25, Some(2)),
            (0.001, Some(3)),
            (1e-9, Some(9)),
            (9.99999999e-5, Some(13)),
            (300.0, Some(0)),
            (1.23456789e12, Some(0)),
            (0.0, None),
            (0.1 + 0.2, None),
            (f64::MIN_POSITIVE, None),
        ] {
            assert_eq!(places(volts), wanted, "{volts:e}");
        }
    }

    #[test]
    fn the_ninth_digit_is_that_of_the_rounded_decimal() {
        assert_eq!(ninth_digit(0.1), Some(9));
        assert_eq!(ninth_digit(9.999_999_999_6), Some(7));
        assert_eq!(ninth_digit(1e300), Some(0));
        assert_eq!(ninth_digit(-1e-300), Some(MOST_PLACES));
        assert_eq!(ninth_digit(0.0), None);
    }

    #[test]
    fn an_integer_is_exact_or_none() {
        assert_eq!(integer(0.1234567, 7), Some(1_234_567));
        assert_eq!(integer(0.1234567, 9), Some(123_456_700));
        assert_eq!(integer(0.1234567, 6), None);
        assert_eq!(integer(-0.0, 3), None);
        assert_eq!(integer(1e300, 22), None);
        assert_eq!(predicted(1e300, 22), 0);
        assert_eq!(most_places(0.3), 16);
        assert_eq!(most_places(f64::MAX), 0);
    }
}
