//! Stress and strain of the foam: stiff at first, soft on its plateau, stiff again when its cells have closed.
//!
//! A monotone cubic through given points (Fritsch and Carlson 1980), starting at zero; beyond the last point the
//! remaining thickness falls as 1 / p. Plateau at 2 to 10 kPa, Young's modulus 20 to 500 kPa (fact sheet, section 2.4).
//! The conductance laws use this strain. The loss p / (p + p_half) depends on no strain; it uses the pressure that
//! would cause this strain in a linear foam (`pressure.modulus_kpa`). Leave it out below a strain of 10 %.

use serde::{Deserialize, Serialize};

use super::bounds::{Bounds, Fault, Parameters};
use super::{Effect, Effects, SheetResponse};
use crate::law::Foam;

/// Points of the curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FoamSettings {
    /// Pressures, ascending, kPa.
    pub kpa: Vec<f64>,
    /// Strain at each pressure, ascending, %.
    pub strain_percent: Vec<f64>,
}

impl Default for FoamSettings {
    fn default() -> Self {
        Self {
            kpa: vec![2.0, 5.0, 8.0, 30.0, 200.0],
            strain_percent: vec![3.0, 10.0, 45.0, 70.0, 85.0],
        }
    }
}

impl Parameters for FoamSettings {
    fn check(&self) -> Result<(), Fault> {
        let fault = |key, why: String| Err(Fault { key, why });
        if self.kpa.len() != self.strain_percent.len() || self.kpa.is_empty() {
            let why = format!(
                "has {} numbers, it must have one for each of the {} of kpa, and at least one",
                self.strain_percent.len(),
                self.kpa.len()
            );
            return fault("strain_percent", why);
        }
        let curve = [
            ("kpa", &self.kpa, [1e-6, 1e6], "kPa"),
            ("strain_percent", &self.strain_percent, [1e-6, 99.9], "%"),
        ];
        for (key, values, allowed, unit) in curve {
            values
                .iter()
                .fold(Bounds::new(), |bounds, value| {
                    bounds.within(key, *value, allowed, unit)
                })
                .end()?;
            if let Some(pair) = values.windows(2).find(|pair| pair[1] <= pair[0]) {
                return fault(
                    key,
                    format!("has {} after {}, it must rise", pair[1], pair[0]),
                );
            }
        }
        Ok(())
    }
}

impl Effect for FoamSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.on_loads(&|effects, on| {
            effects.foam = on.then(|| self.clone());
            // `foam` and `log-law` exclude each other, so the scene's log law is removed for the solution with `foam`
            if on {
                effects.log_law = None;
            }
        })
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.foam = Some(self.curve());
    }
}

impl FoamSettings {
    fn curve(&self) -> Foam {
        Foam::new(&self.kpa, &self.strain_percent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_rises_everywhere_and_meets_its_points() {
        let curves = [
            FoamSettings::default(),
            FoamSettings {
                kpa: vec![1.0, 1.001, 50.0],
                strain_percent: vec![0.1, 80.0, 80.01],
            },
            FoamSettings {
                kpa: vec![7.0],
                strain_percent: vec![30.0],
            },
        ];
        for settings in curves {
            settings.check().unwrap();
            let foam = settings.curve();
            assert_eq!(foam.strain(0.0), 0.0);
            for (kpa, percent) in settings.kpa.iter().zip(&settings.strain_percent) {
                assert!((foam.strain(*kpa) - percent / 100.0).abs() < 1e-14);
            }
            let mut last = 0.0;
            for k in 1..200_000 {
                let strain = foam.strain(f64::from(k) * 2e-3);
                assert!(strain >= last && strain < 1.0, "{k}: {strain} after {last}");
                last = strain;
            }
        }
        // points on a straight line give a straight line
        let straight = Foam::new(&[1.0, 2.0, 4.0], &[10.0, 20.0, 40.0]);
        assert!((straight.strain(2.7) - 0.27).abs() < 1e-15);
    }
}
