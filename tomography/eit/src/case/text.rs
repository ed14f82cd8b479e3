//! Numbers as text.

use nalgebra::DMatrix;

/// A matrix as text: a row per line, no header.
pub fn matrix_text(matrix: &DMatrix<f64>) -> String {
    let mut text = String::new();
    for row in matrix.row_iter() {
        let fields: Vec<String> = row.iter().map(|value| digits(*value)).collect();
        line(&mut text, &fields);
    }
    text
}

pub(super) fn line(text: &mut String, fields: &[String]) {
    text.push_str(&fields.join(","));
    text.push('\n');
}

/// A number with 17 significant digits, trailing zeros dropped: C's `%.17g`.
pub fn digits(value: f64) -> String {
    if !value.is_finite() {
        return if value.is_nan() {
            "nan".to_owned()
        } else if value > 0.0 {
            "inf".to_owned()
        } else {
            "-inf".to_owned()
        };
    }
    if value == 0.0 {
        return if value.is_sign_negative() { "-0" } else { "0" }.to_owned();
    }
    let scientific = format!("{value:.16e}");
    let (mantissa, exponent) = scientific
        .split_once('e')
        .expect("the e format has an exponent");
    let exponent: i32 = exponent.parse().expect("the exponent is an integer");
    let trim = |text: &str| {
        if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        } else {
            text.to_owned()
        }
    };
    if (-4..17).contains(&exponent) {
        trim(&format!("{value:.*}", (16 - exponent).max(0) as usize))
    } else {
        let sign = if exponent < 0 { '-' } else { '+' };
        format!("{}e{sign}{:02}", trim(mantissa), exponent.abs())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seventeen_digits_as_c_writes_them() {
        for (value, text) in [
            (0.1, "0.10000000000000001"),
            (1.0, "1"),
            (-2.5e-5, "-2.5000000000000001e-05"),
            (1e22, "1e+22"),
            (123456.0, "123456"),
            (0.0001, "0.0001"),
            (1e17, "1e+17"),
            (0.23, "0.23000000000000001"),
        ] {
            assert_eq!(digits(value), text);
        }
        assert_eq!(digits(f64::NAN), "nan");
    }

    #[test]
    fn seventeen_digits_are_every_bit() {
        let mut value = 1.234_567_890_123_456_7e-300_f64;
        while value.is_finite() {
            assert_eq!(
                digits(value).parse::<f64>().unwrap().to_bits(),
                value.to_bits()
            );
            value *= -9.876_543_21;
        }
    }
}
