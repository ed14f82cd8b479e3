//! A short between two electrodes: 0.1 to 10 ohm between them, from a given time on.
//!
//! A resistor R between electrodes a and b is a rank-one change of a network's transfer impedance Z: Z - (Z d)(Z d)^T /
//! (R + d^T Z d), d = e_a - e_b. The formula is exact (fact sheet, section 2.3). A short is a fault, absent from a
//! healthy sheet.

use std::time::Duration;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::bounds::{Bounds, Fault, Parameters};
use super::{Effect, Effects, OnNetwork, SheetResponse};

/// The shorted electrodes, and the time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShortSettings {
    /// The two electrodes, from 1.
    pub electrodes: [usize; 2],
    /// Resistance between them, ohm.
    #[serde(default = "ohm")]
    pub ohm: f64,
    /// Start, s.
    #[serde(default)]
    pub from_s: f64,
    /// End, s; `None` for no end.
    pub to_s: Option<f64>,
}

fn ohm() -> f64 {
    1.0
}

impl Default for ShortSettings {
    /// The first two electrodes, without an end.
    fn default() -> Self {
        Self {
            electrodes: [1, 2],
            ohm: ohm(),
            from_s: 0.0,
            to_s: None,
        }
    }
}

impl ShortSettings {
    /// Whether the short exists at a time, s.
    fn is_on(&self, at: f64) -> bool {
        at >= self.from_s && self.to_s.is_none_or(|to| at < to)
    }

    fn bridge(&self, z: &mut DMatrix<f64>) {
        let [a, b] = self.electrodes.map(|number| number.wrapping_sub(1));
        if a >= z.nrows() || b >= z.nrows() {
            return;
        }
        let across = z.column(a) - z.column(b);
        let own = across[a] - across[b];
        z.ger(-1.0 / (self.ohm + own), &across, &across, 1.0);
    }
}

impl Parameters for ShortSettings {
    fn check(&self) -> Result<(), Fault> {
        let [a, b] = self.electrodes;
        if a == b {
            return Err(Fault {
                key: "electrodes",
                why: format!("names electrode {a} twice"),
            });
        }
        Bounds::new()
            .within("electrodes", a as f64, [1.0, 256.0], "")
            .within("electrodes", b as f64, [1.0, 256.0], "")
            .within("ohm", self.ohm, [0.0, 1e9], "ohm")
            .within("from_s", self.from_s, [0.0, 1e9], "s")
            .within("to_s", self.to_s.unwrap_or(1e9), [self.from_s, 1e9], "s")
            .end()
    }
}

impl Effect for ShortSettings {
    fn check_on(&self, electrodes: usize) -> Result<(), Fault> {
        self.electrodes
            .into_iter()
            .try_for_each(|number| Fault::beyond("electrodes", number, electrodes))
    }

    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        let shorted = response.network(&|z| self.bridge(z));
        shorted * response.over_time(&|at| f64::from(u8::from(self.is_on(at))))
    }

    fn assumes(&self) -> Option<String> {
        let [a, b] = self.electrodes;
        Some(format!("electrodes {a} and {b} from {} s", self.from_s))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.network.push(Box::new(self.clone()));
    }
}

impl OnNetwork for ShortSettings {
    fn act(&mut self, at: Duration, z: &mut DMatrix<f64>) {
        if self.epoch(at) == 1 {
            self.bridge(z);
        }
    }

    fn epoch(&self, at: Duration) -> u64 {
        u64::from(self.is_on(at.as_secs_f64()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resistor_beside_a_resistor() {
        // two electrodes connected by 300 ohm: Z = 75 [[1, -1], [-1, 1]] with zero mean potential
        let mut z = DMatrix::from_row_slice(2, 2, &[75.0, -75.0, -75.0, 75.0]);
        let mut short = ShortSettings {
            electrodes: [1, 2],
            ohm: 100.0,
            from_s: 5.0,
            to_s: None,
        };
        short.act(Duration::from_secs(4), &mut z);
        assert_eq!(z[(0, 0)], 75.0);
        short.act(Duration::from_secs(5), &mut z);
        let seen = z[(0, 0)] - z[(0, 1)] - z[(1, 0)] + z[(1, 1)];
        assert!((seen - 75.0).abs() < 1e-12, "{seen}");
    }
}
