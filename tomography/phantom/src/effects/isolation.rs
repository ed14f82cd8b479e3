//! Leakage between wires: every electrode has a resistance to a common earth.
//!
//! More than 10 Gohm in a healthy module, 1 to 100 Mohm in a humid fault (fact sheet, section 2.2). With the admittance
//! Y, the pseudo-inverse of Z, and the conductance G to earth, the network becomes Y + G (1 - 11^T / n). Its inverse in
//! the mean-free space of Z is Z (1 + G Z)^-1.

use std::time::Duration;

use nalgebra::DMatrix;

use super::bounds::parameters;
use super::{Effect, Effects, OnNetwork, SheetResponse};

parameters! {
    /// Insulation of the wires.
    IsolationSettings {
        /// Resistance of every electrode's wire to earth, Mohm.
        mohm = 10.0, in [0.001, 1e7], "Mohm";
    }
}

impl IsolationSettings {
    fn leak(&self, z: &mut DMatrix<f64>) {
        let leak = 1.0 / (self.mohm * 1e6);
        let size = z.nrows();
        let both = DMatrix::identity(size, size) + &*z * leak;
        // Z is positive on mean-free currents and zero on the others, so 1 + G Z always has an inverse
        if let Some(solved) = both.lu().solve(&*z) {
            *z = (&solved + solved.transpose()) * 0.5;
        }
    }
}

impl Effect for IsolationSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.network(&|z| self.leak(z))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.network.push(Box::new(self.clone()));
    }
}

impl OnNetwork for IsolationSettings {
    fn act(&mut self, _at: Duration, z: &mut DMatrix<f64>) {
        self.leak(z);
    }

    fn epoch(&self, _at: Duration) -> u64 {
        0
    }
}
