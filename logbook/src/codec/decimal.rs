//! Voltages as the decimals of nine digits that a voltmeter sends.

/// Nine digits, no more: `integer` has at most nine, the first not 0, so `power` is the coarsest that holds all nine.
pub(super) struct Decimal {
    integer: i64,
    power: i16,
}

impl Decimal {
    /// `None` where nine digits do not give the same bits (and for -0, which an integer cannot hold).
    pub(super) fn of(volts: f64) -> Option<Self> {
        if volts == 0.0 {
            return volts.is_sign_positive().then_some(Self {
                integer: 0,
                power: 0,
            });
        }
        if let Some(quick) = Self::quickly(volts) {
            return Some(quick);
        }
        let text = format!("{volts:.8e}");
        let (mantissa, exponent) = text.split_once('e')?;
        let integer: i64 = mantissa.replace('.', "").parse().ok()?;
        let power = exponent.parse::<i16>().ok()? - 8;
        (value(integer, power).to_bits() == volts.to_bits()).then_some(Self { integer, power })
    }

    /// Where powers of ten are exact: nine digits that give the bits back are the digits, however they were found.
    fn quickly(volts: f64) -> Option<Self> {
        let size = volts.abs();
        if !(1e-12..1e6).contains(&size) {
            return None;
        }
        let power = size.log10().floor() as i16 - 8;
        let scaled = if power >= 0 {
            volts / power_of_ten(i32::from(power))
        } else {
            volts * power_of_ten(-i32::from(power))
        };
        let integer = scaled.round() as i64;
        ((100_000_000..1_000_000_000).contains(&integer.abs())
            && value(integer, power).to_bits() == volts.to_bits())
        .then_some(Self { integer, power })
    }

    /// The power of ten of the last digit that is not 0; `None` for zero, which lies on any grid.
    pub(super) fn finest(&self) -> Option<i16> {
        let (mut integer, mut power) = (self.integer, self.power);
        if integer == 0 {
            return None;
        }
        while integer % 10 == 0 {
            integer /= 10;
            power += 1;
        }
        Some(power)
    }

    /// As an integer times the larger of the grid's power and its own; a zero takes the expected power.
    pub(super) fn on(&self, grid: i16, expected: i16) -> Option<(i64, i16)> {
        if self.integer == 0 {
            return Some((0, expected));
        }
        let power = grid.max(self.power);
        let places = u32::from(power.abs_diff(self.power));
        // No digit is lost: the grid is no coarser than this value's last digit that is not 0.
        Some((self.integer / 10_i64.checked_pow(places)?, power))
    }
}

/// Of a voltage's ninth digit, whether or not it has more; `None` for zero.
pub(super) fn finest_power(volts: f64) -> Option<i16> {
    if volts == 0.0 {
        return None;
    }
    let text = format!("{volts:.8e}");
    let (_, exponent) = text.split_once('e')?;
    exponent.parse::<i16>().ok().map(|exponent| exponent - 8)
}

pub(super) fn predicted(reference: f64, power: i16) -> i64 {
    let power = i32::from(power);
    let counts = if power >= 0 {
        reference / power_of_ten(power)
    } else {
        reference * power_of_ten(-power)
    };
    // `as` saturates, and gives 0 for NaN: the same on every machine, as the decoder needs.
    counts.round() as i64
}

/// integer x 10^power, correctly rounded.
pub(super) fn value(integer: i64, power: i16) -> f64 {
    let power = i32::from(power);
    let exact = integer.unsigned_abs() < 1 << 53 && power.unsigned_abs() <= 22;
    match power {
        _ if !exact => format!("{integer}e{power}").parse().unwrap_or(f64::NAN),
        0.. => integer as f64 * power_of_ten(power),
        _ => integer as f64 / power_of_ten(-power),
    }
}

fn power_of_ten(power: i32) -> f64 {
    const EXACT: [f64; 23] = [
        1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
        1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
    ];
    match EXACT.get(power as usize) {
        Some(exact) => *exact,
        None => format!("1e{power}").parse().unwrap_or(f64::INFINITY),
    }
}
