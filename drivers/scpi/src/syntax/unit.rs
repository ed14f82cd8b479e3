//! Units of numbers, with their multipliers.

use crate::ParseError;

/// The quantity of a number, which determines the units that may follow it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Unit {
    /// A plain number: no unit may follow.
    None,
    /// Ampere.
    Ampere,
    /// Volt.
    Volt,
    /// Ohm.
    Ohm,
    /// Second.
    Second,
    /// Hertz.
    Hertz,
    /// Power-line cycles.
    PowerLineCycle,
}

impl Unit {
    /// Applies a suffix such as `mA`. `2 mA` gives the same bits as `2e-3`: dividing by an exact power of ten rounds
    /// once, multiplying by 1e-3 twice.
    ///
    /// # Errors
    /// -138 if no unit may follow, -131 for a unit of another quantity.
    pub fn scale(self, value: f64, suffix: &str) -> Result<f64, ParseError> {
        let factor = self.factor(suffix)?;
        Ok(if factor < 1.0 {
            value / (1.0 / factor).round()
        } else {
            value * factor
        })
    }

    /// The factor of a suffix such as `MA`, `UV`, `MOHM` (mega, an exception in SCPI) or `MHZ` (also mega).
    fn factor(self, suffix: &str) -> Result<f64, ParseError> {
        let name = match self {
            Unit::None => return Err(ParseError::SuffixNotAllowed),
            Unit::Ampere => "A",
            Unit::Volt => "V",
            Unit::Ohm => "OHM",
            Unit::Second => "S",
            Unit::Hertz => "HZ",
            Unit::PowerLineCycle => "PLC",
        };
        let upper = suffix.to_ascii_uppercase();
        let multiplier = upper.strip_suffix(name).ok_or(ParseError::InvalidSuffix)?;
        match multiplier {
            "" => Ok(1.0),
            _ if self == Unit::PowerLineCycle => Err(ParseError::InvalidSuffix),
            "M" if matches!(self, Unit::Ohm | Unit::Hertz) => Ok(1e6),
            "G" => Ok(1e9),
            "MA" => Ok(1e6),
            "K" => Ok(1e3),
            "M" => Ok(1e-3),
            "U" => Ok(1e-6),
            "N" => Ok(1e-9),
            "P" => Ok(1e-12),
            "F" => Ok(1e-15),
            "A" => Ok(1e-18),
            _ => Err(ParseError::InvalidSuffix),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::syntax::unit::*;

    #[test]
    fn units_scale_to_the_bits_of_the_plain_number() {
        let amps = |value, suffix| Unit::Ampere.scale(value, suffix);
        assert_eq!(amps(2.0, "mA"), Ok(2e-3));
        assert_eq!(amps(1e3, "uA"), Ok(1e-3));
        assert_eq!(amps(0.3, "nA"), Ok(0.3e-9));
        assert_eq!(amps(2.0, "mV"), Err(ParseError::InvalidSuffix));
        assert_eq!(amps(2.0, "xA"), Err(ParseError::InvalidSuffix));
        assert_eq!(Unit::Volt.scale(2.0, "maV"), Ok(2e6));
        assert_eq!(Unit::Ohm.scale(2.0, "MOHM"), Ok(2e6));
        assert_eq!(Unit::PowerLineCycle.scale(10.0, "plc"), Ok(10.0));
        assert_eq!(
            Unit::None.scale(2.0, "V"),
            Err(ParseError::SuffixNotAllowed)
        );
    }
}
