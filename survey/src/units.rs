//! Unit types for interfaces. Formulas use plain `f64` in SI units.
//!
//! ```
//! use survey::{Amps, Ohms, Volts};
//! let resistance: Ohms = Volts(0.309) / Amps(1e-3);
//! assert_eq!(resistance.to_string(), "309 ohm");
//! ```

use std::fmt;
use std::ops::{Add, Div, Mul, Neg, Sub};

use serde::{Deserialize, Serialize};

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident, $unit:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
        #[serde(transparent)]
        pub struct $name(pub f64);

        impl $name {
            /// The magnitude, sign dropped.
            pub fn abs(self) -> Self {
                Self(self.0.abs())
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                engineering(self.0, $unit, f)
            }
        }

        impl Add for $name {
            type Output = Self;
            fn add(self, other: Self) -> Self {
                Self(self.0 + other.0)
            }
        }

        impl Sub for $name {
            type Output = Self;
            fn sub(self, other: Self) -> Self {
                Self(self.0 - other.0)
            }
        }

        impl Neg for $name {
            type Output = Self;
            fn neg(self) -> Self {
                Self(-self.0)
            }
        }

        impl Mul<f64> for $name {
            type Output = Self;
            fn mul(self, factor: f64) -> Self {
                Self(self.0 * factor)
            }
        }
    };
}

quantity!(
    /// A voltage, V.
    Volts,
    "V"
);
quantity!(
    /// A current, A.
    Amps,
    "A"
);
quantity!(
    /// A resistance, ohm (a sheet resistance is in ohm per square).
    Ohms,
    "ohm"
);

impl Div<Amps> for Volts {
    type Output = Ohms;
    fn div(self, current: Amps) -> Ohms {
        Ohms(self.0 / current.0)
    }
}

impl Mul<Ohms> for Amps {
    type Output = Volts;
    fn mul(self, resistance: Ohms) -> Volts {
        Volts(self.0 * resistance.0)
    }
}

impl Div<Ohms> for Volts {
    type Output = Amps;
    fn div(self, resistance: Ohms) -> Amps {
        Amps(self.0 / resistance.0)
    }
}

/// Writes the value with the SI prefix that leaves one to three digits before the decimal point: `2.5 uV`. A
/// precision, `{:.3}`, is the total number of digits.
fn engineering(value: f64, unit: &str, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    const PREFIXES: [(f64, &str); 9] = [
        (1e9, "G"),
        (1e6, "M"),
        (1e3, "k"),
        (1.0, ""),
        (1e-3, "m"),
        (1e-6, "u"),
        (1e-9, "n"),
        (1e-12, "p"),
        (1e-15, "f"),
    ];
    if value == 0.0 || !value.is_finite() {
        return write!(f, "{value} {unit}");
    }
    // 0.9999999 keeps 1e-3 (stored a hair below) from printing as 1000 u.
    let (scale, prefix) = PREFIXES
        .into_iter()
        .find(|(scale, _)| value.abs() >= scale * 0.9999999)
        .unwrap_or(PREFIXES[PREFIXES.len() - 1]);
    let scaled = value / scale;
    let decimals = match f.precision() {
        None => 6,
        Some(digits) => digits.saturating_sub(1 + scaled.abs().max(1.0).log10() as usize),
    };
    let mut scaled = format!("{scaled:.decimals$}");
    if decimals > 0 {
        scaled.truncate(scaled.trim_end_matches('0').trim_end_matches('.').len());
    }
    write!(f, "{scaled} {prefix}{unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantity_prints_with_its_prefix() {
        assert_eq!(Amps(1e-3).to_string(), "1 mA");
        assert_eq!(Volts(-2.5e-6).to_string(), "-2.5 uV");
        assert_eq!(Ohms(1000.0).to_string(), "1 kohm");
        assert_eq!(format!("{:.3}", Volts(2.082384e-6)), "2.08 uV");
        assert_eq!(format!("{:.3}", Volts(-0.208_238_4)), "-208 mV");
        assert_eq!(format!("{:.2}", Volts(0.2)), "200 mV");
        assert_eq!(format!("{:.3}", Amps(1e-3)), "1 mA");
        assert_eq!(Volts(0.0).to_string(), "0 V");
    }

    #[test]
    fn ohms_law_joins_the_units() {
        assert_eq!((Amps(2e-3) * Ohms(500.0)), Volts(1.0));
        assert_eq!(Volts(1.0) / Amps(2e-3), Ohms(500.0));
        assert_eq!(Volts(1.0) / Ohms(500.0), Amps(2e-3));
    }
}
