//! Conversion of a pressure to a loss of conductance.

use std::fmt;

use crate::load::loss_of_pressure;
use crate::paper;

/// Foam properties without effects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pressure {
    /// Pressure at which half of the conductance is lost, kPa. The paper gives no law; see [`loss_of_pressure`].
    pub half_kpa: f64,
    /// Young's modulus across the foam, kPa; 20 to 500 (fact sheet, section 2.4).
    pub modulus_kpa: f64,
}

impl Default for Pressure {
    fn default() -> Self {
        Self {
            half_kpa: paper::HALF_KPA,
            modulus_kpa: 100.0,
        }
    }
}

/// A conductance law that replaces p / (p + p_half).
pub(crate) trait Conduction: fmt::Debug + Send {
    /// Share of the conductance that is lost at a pressure (kPa) and strain; negative for a gain, never above 1.
    fn loss(&self, kpa: f64, strain: f64) -> f64;
}

/// Smallest thickness of foam, as a share of its unloaded thickness.
const THINNEST: f64 = 0.05;

/// The stress-strain curve of foam, with its slopes.
#[derive(Debug)]
pub(crate) struct Foam {
    /// Pressure (kPa), strain, slope; the first point is zero.
    points: Vec<[f64; 3]>,
}

impl Foam {
    /// A monotone cubic through pressures (kPa) and strains (%), both ascending, starting at zero.
    pub(crate) fn new(kpa: &[f64], strain_percent: &[f64]) -> Self {
        let given = kpa.iter().zip(strain_percent);
        let mut points: Vec<[f64; 3]> = [[0.0; 3]]
            .into_iter()
            .chain(given.map(|(kpa, percent)| [*kpa, percent / 100.0, 0.0]))
            .collect();
        let secant = |a: [f64; 3], b: [f64; 3]| (b[1] - a[1]) / (b[0] - a[0]);
        let last = points.len() - 1;
        // slopes: at inner points the weighted harmonic mean of both secants, which keeps the cubic monotone; at the
        // ends the secant
        points[0][2] = secant(points[0], points[1]);
        points[last][2] = secant(points[last - 1], points[last]);
        for k in 1..last {
            let [a, b, c] = [points[k - 1], points[k], points[k + 1]];
            let (before, after) = (b[0] - a[0], c[0] - b[0]);
            let (w, v) = (2.0 * after + before, after + 2.0 * before);
            points[k][2] = (w + v) / (w / secant(a, b) + v / secant(b, c));
        }
        Self { points }
    }

    /// The strain at a pressure, kPa; 0 to 1.
    pub(crate) fn strain(&self, kpa: f64) -> f64 {
        let after = self.points.iter().position(|point| point[0] >= kpa);
        match after {
            Some(0) => 0.0,
            Some(k) => {
                let [a, b] = [self.points[k - 1], self.points[k]];
                let wide = b[0] - a[0];
                let t = (kpa - a[0]) / wide;
                let rest = 1.0 - t;
                // Hermite's cubic
                rest * rest * ((1.0 + 2.0 * t) * a[1] + t * wide * a[2])
                    + t * t * ((3.0 - 2.0 * t) * b[1] - rest * wide * b[2])
            }
            None => {
                let [at, strain, _] = self.points[self.points.len() - 1];
                1.0 - (1.0 - strain) * at / kpa
            }
        }
    }
}

/// The law from pressure to conductance, with the scene's effects.
#[derive(Debug)]
pub(crate) struct Law {
    pub(crate) pressure: Pressure,
    pub(crate) foam: Option<Foam>,
    pub(crate) conduction: Option<Box<dyn Conduction>>,
}

impl Law {
    fn strain(&self, kpa: f64) -> f64 {
        match &self.foam {
            Some(foam) => foam.strain(kpa),
            None => (kpa / self.pressure.modulus_kpa).min(1.0 - THINNEST),
        }
    }

    /// Share of the conductance that is lost at a pressure, kPa.
    pub(crate) fn loss(&self, kpa: f64) -> f64 {
        match (&self.conduction, &self.foam) {
            (Some(conduction), _) => conduction.loss(kpa, self.strain(kpa)),
            (None, Some(foam)) => {
                let straight = self.pressure.modulus_kpa * foam.strain(kpa);
                loss_of_pressure(straight, self.pressure.half_kpa)
            }
            (None, None) => loss_of_pressure(kpa, self.pressure.half_kpa),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{EffectSettings, Effects};

    fn law(text: &str) -> Law {
        let effects: EffectSettings = toml::from_str(text).unwrap();
        Effects::new(&effects, 1).law(Pressure::default())
    }

    #[test]
    fn each_law_is_its_formula() {
        assert_eq!(law("").loss(25.0), 0.5);
        // 10 kPa on a foam of 100 kPa give a strain of 0.1
        assert!((law("gauge-law.factor = 5").loss(10.0) - 1.0 / 3.0).abs() < 1e-15);
        let exponential = law("exponential-law.per_strain = 4").loss(10.0);
        assert!((exponential - (1.0 - (-0.4_f64).exp())).abs() < 1e-15);
        // two decades above 0.1 kPa, 20 % each, leave 0.6 of the resistance
        let log = law("log-law.from_kpa = 0.1").loss(10.0);
        assert!((log - (1.0 - 1.0 / 0.6)).abs() < 1e-14, "{log}");
        assert_eq!(law("log-law.from_kpa = 20").loss(10.0), 0.0);
        let foam = "foam.kpa = [1, 10]\nfoam.strain_percent = [10, 50]\n";
        assert!((law(&format!("{foam}gauge-law.factor = 2")).loss(10.0) - 0.5).abs() < 1e-15);
        // 50 kPa compress a foam of 100 kPa by half: 50 / (50 + 25)
        assert!((law(foam).loss(10.0) - 2.0 / 3.0).abs() < 1e-15);
    }

    #[test]
    fn no_law_takes_all_or_gives_without_bound() {
        for text in [
            "",
            "gauge-law.factor = 1000",
            "exponential-law.per_strain = 18",
            "log-law.percent_per_decade = 100",
            "[foam]\n[exponential-law]",
        ] {
            let law = law(text);
            let mut last = 0.0_f64;
            for exponent in -60..=60 {
                let kpa = 10f64.powf(f64::from(exponent) / 10.0);
                let loss = law.loss(kpa);
                assert!(
                    (-99.0..1.0).contains(&loss),
                    "{text}: {loss} under {kpa} kPa"
                );
                // monotone in the pressure
                assert!(
                    loss.abs() >= last.abs() - 1e-15,
                    "{text}: {loss} after {last}"
                );
                last = loss;
            }
        }
    }
}
