//! Temperatures from transducer voltages and resistances: thermocouples by ITS-90, platinum by Callendar and Van Dusen,
//! thermistors by Steinhart and Hart.

mod couples;

use crate::simulator::measurement::temperature::couples::{B, CoupleSection, E, J, K, N, R, S, T};

/// The additional term of type K above 0 degrees: a0 exp(a1 (t - a2)^2) mV.
const K_EXPONENTIAL: [f64; 3] = [0.1185976, -0.0001183432, 126.9686];

/// The sections of a thermocouple's function, and the lowest temperature used. Type B is used from 100 degrees only,
/// because below it two temperatures have the same voltage.
fn sections(couple: &str) -> (&'static [CoupleSection], f64) {
    let all = match couple {
        "B" => B,
        "E" => E,
        "K" => K,
        "N" => N,
        "R" => R,
        "S" => S,
        "T" => T,
        _ => J,
    };
    // near absolute zero some functions are almost constant: the limits of the instrument apply
    let least = match couple {
        "B" => 100.0,
        "E" | "J" | "K" | "N" | "T" => -200.0,
        _ => -50.0,
    };
    (all, least)
}

/// Voltage of a thermocouple with its reference junction at 0 degrees, mV.
fn millivolts(couple: &str, celsius: f64) -> f64 {
    let (all, _) = sections(couple);
    let stretch = all.iter().find(|(_, to, _)| celsius <= *to).or(all.last());
    let Some((_, _, coefficients)) = stretch else {
        return 0.0;
    };
    let polynomial = coefficients
        .iter()
        .rev()
        .fold(0.0, |sum, c| sum * celsius + c);
    match couple {
        "K" if celsius > 0.0 => {
            let [a0, a1, a2] = K_EXPONENTIAL;
            polynomial + a0 * (a1 * (celsius - a2).powi(2)).exp()
        }
        _ => polynomial,
    }
}

/// Temperature of a thermocouple, degrees Celsius, from its voltage and the temperature of its reference junction;
/// infinite beyond its range.
pub(crate) fn of_couple(couple: &str, volts: f64, junction: f64) -> f64 {
    let (all, least) = sections(couple);
    let most = all.last().map_or(0.0, |(_, to, _)| *to);
    let sought = volts * 1e3 + millivolts(couple, junction);
    between(least, most, |celsius| millivolts(couple, celsius) - sought)
}

/// Temperature of a platinum resistor, degrees Celsius; infinite beyond -200 to 600 degrees.
pub(crate) fn of_rtd(kind: f64, at_zero: f64, ohms: f64) -> f64 {
    // IEC 751 for 0.00385, the older standard for 0.00391.
    let [a, b, c] = if kind == 91.0 {
        [3.9692e-3, -5.8495e-7, -4.2325e-12]
    } else {
        [3.9083e-3, -5.775e-7, -4.183e-12]
    };
    between(-200.0, 600.0, |t| {
        let cold = if t < 0.0 {
            c * (t - 100.0) * t.powi(3)
        } else {
            0.0
        };
        at_zero * (1.0 + a * t + b * t * t + cold) - ohms
    })
}

/// Temperature of a thermistor of type 44004, 44007 or 44006, degrees Celsius; infinite beyond -80 to 150 degrees.
pub(crate) fn of_thermistor(kind: f64, ohms: f64) -> f64 {
    let [a, b, c] = match kind {
        2252.0 => [1.468e-3, 2.383e-4, 1.007e-7],
        10_000.0 => [1.032e-3, 2.387e-4, 1.580e-7],
        _ => [1.285e-3, 2.362e-4, 9.285e-8],
    };
    if ohms <= 0.0 {
        return f64::INFINITY;
    }
    let log = ohms.ln();
    let celsius = 1.0 / (a + b * log + c * log.powi(3)) - 273.15;
    match celsius {
        celsius if celsius.is_nan() || celsius < -80.0 => f64::NEG_INFINITY,
        celsius if celsius > 150.0 => f64::INFINITY,
        celsius => celsius,
    }
}

/// The zero of an increasing function in an interval; infinite, with the sign of the side, if there is none.
fn between(mut least: f64, mut most: f64, rising: impl Fn(f64) -> f64) -> f64 {
    if rising(least) > 0.0 {
        return f64::NEG_INFINITY;
    }
    let top = rising(most);
    if top < 0.0 || top.is_nan() {
        return f64::INFINITY;
    }
    // Bisection down to the last bit of a double.
    for _ in 0..64 {
        let middle = 0.5 * (least + most);
        if rising(middle) > 0.0 {
            most = middle;
        } else {
            least = middle;
        }
    }
    0.5 * (least + most)
}

#[cfg(test)]
mod tests {
    use crate::simulator::measurement::temperature::*;

    #[test]
    fn couples_read_the_temperatures_of_the_tables() {
        // NIST Monograph 175, reference junction at 0 degrees, mV to three decimals
        let table = [
            ("B", 1000.0, 4.834),
            ("E", 500.0, 37.005),
            ("E", -100.0, -5.237),
            ("J", 100.0, 5.269),
            ("J", 1000.0, 57.953),
            ("K", 100.0, 4.096),
            ("K", 1000.0, 41.276),
            ("K", -100.0, -3.554),
            ("N", 1000.0, 36.256),
            ("R", 1500.0, 17.451),
            ("S", 1000.0, 9.587),
            ("T", 100.0, 4.279),
            ("T", -100.0, -3.379),
        ];
        for (couple, celsius, millivolts) in table {
            let read = of_couple(couple, millivolts * 1e-3, 0.0);
            assert!((read - celsius).abs() < 0.1, "{couple} {celsius}: {read}");
        }
        // a thermocouple at the temperature of its reference junction gives 0 V
        assert!((of_couple("K", 0.0, 23.0) - 23.0).abs() < 1e-9);
        assert_eq!(of_couple("J", 1.0, 0.0), f64::INFINITY);
        assert_eq!(of_couple("J", -1.0, 0.0), f64::NEG_INFINITY);
        assert_eq!(of_couple("J", f64::INFINITY, 0.0), f64::INFINITY);
    }

    #[test]
    fn resistances_read_the_temperatures_of_their_standards() {
        assert!(of_rtd(85.0, 100.0, 100.0).abs() < 1e-9);
        // IEC 751: 138.51 ohm at 100 degrees, 60.26 at -100
        assert!((of_rtd(85.0, 100.0, 138.5055) - 100.0).abs() < 1e-3);
        assert!((of_rtd(85.0, 100.0, 60.256) + 100.0).abs() < 2e-3);
        assert!((of_rtd(91.0, 100.0, 139.10) - 100.0).abs() < 0.1);
        assert_eq!(of_rtd(85.0, 100.0, f64::INFINITY), f64::INFINITY);
        assert_eq!(of_rtd(85.0, 100.0, 0.0), f64::NEG_INFINITY);
        for kind in [2252.0, 5000.0, 10_000.0] {
            assert!((of_thermistor(kind, kind) - 25.0).abs() < 0.05, "{kind}");
        }
        assert_eq!(of_thermistor(5000.0, f64::INFINITY), f64::NEG_INFINITY);
        assert_eq!(of_thermistor(5000.0, 1.0), f64::INFINITY);
    }
}
