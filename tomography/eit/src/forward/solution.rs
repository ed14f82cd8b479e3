//! What the unknowns say: electrode voltages, potentials, drops over contacts.

use nalgebra::DMatrix;
use survey::Dipole;

use super::system::Form;
use super::{Fields, Forward};

/// Unknowns of some drives as they come from the solver, with what is needed to read them.
pub(crate) struct Solution {
    /// Nodes then electrodes (rows), drives (columns): u or d on nodes, U (0 where eliminated) on electrodes.
    pub(crate) x: DMatrix<f64>,
    pub(super) forms: Vec<Form>,
    /// Currents into the electrodes (rows) of each drive (column).
    pub(super) currents: DMatrix<f64>,
    pub(super) floored: usize,
}

impl Forward {
    /// An electrode's voltage relative to the ground node, in two parts of which the second (z I / |e|, where the
    /// voltage was eliminated) may be far larger.
    pub(super) fn voltage(&self, solution: &Solution, electrode: usize, column: usize) -> [f64; 2] {
        match solution.forms[electrode] {
            Form::Difference | Form::Shunt => [
                solution.x[(self.mesh.nodes().len() + electrode, column)],
                0.0,
            ],
            Form::Eliminated => {
                let contact = &self.electrodes[electrode];
                let mean = contact.mean(|node| solution.x[(node, column)]);
                let current = solution.currents[(electrode, column)];
                [mean, self.contact[electrode] * current / contact.length]
            }
        }
    }

    /// U\[plus\] - U\[minus\] of a drive, exact to rounding whatever the contacts of other electrodes.
    pub(crate) fn voltage_between(&self, solution: &Solution, pair: Dipole, column: usize) -> f64 {
        let plus = self.voltage(solution, pair.plus.0, column);
        let minus = self.voltage(solution, pair.minus.0, column);
        (plus[0] - minus[0]) + (plus[1] - minus[1])
    }

    /// Potential of every node of one drive relative to the ground node.
    pub(crate) fn potential(&self, solution: &Solution, column: usize) -> Vec<f64> {
        let nodes = self.mesh.nodes().len();
        (0..nodes)
            .map(|node| {
                let x = solution.x[(node, column)];
                match self.on[node] {
                    Some(e) if solution.forms[e] != Form::Eliminated => {
                        x + solution.x[(nodes + e, column)]
                    }
                    _ => x,
                }
            })
            .collect()
    }

    pub(super) fn fields(&self, solution: &Solution) -> Fields {
        let nodes = self.mesh.nodes().len();
        let count = self.electrodes.len();
        let columns = solution.x.ncols();
        let mut potentials = DMatrix::zeros(nodes, columns);
        let mut electrodes = DMatrix::zeros(count, columns);
        for column in 0..columns {
            let voltages: Vec<[f64; 2]> = (0..count)
                .map(|e| self.voltage(solution, e, column))
                .collect();
            // the large parts are summed apart: equal contacts cancel exactly
            let mean = [0, 1].map(|part| {
                voltages.iter().map(|voltage| voltage[part]).sum::<f64>() / count as f64
            });
            for (e, voltage) in voltages.iter().enumerate() {
                electrodes[(e, column)] = (voltage[0] - mean[0]) + (voltage[1] - mean[1]);
            }
            for (node, u) in self.potential(solution, column).into_iter().enumerate() {
                potentials[(node, column)] = u - (mean[0] + mean[1]);
            }
        }
        Fields {
            potentials,
            electrodes,
            floored: solution.floored,
        }
    }

    /// ∫ (U - u)(W - w) over an electrode, for two drives.
    pub(crate) fn drop_product(
        &self,
        solution: &Solution,
        electrode: usize,
        a: usize,
        b: usize,
    ) -> f64 {
        let contact = &self.electrodes[electrode];
        match solution.forms[electrode] {
            Form::Shunt => 0.0,
            Form::Difference => {
                contact.mass(|node| solution.x[(node, a)], |node| solution.x[(node, b)])
            }
            Form::Eliminated => {
                let mean = |c: usize| contact.mean(|node| solution.x[(node, c)]);
                let (mean_a, mean_b) = (mean(a), mean(b));
                let drop = |c: usize| {
                    self.contact[electrode] * solution.currents[(electrode, c)] / contact.length
                };
                contact.mass(
                    |node| solution.x[(node, a)] - mean_a,
                    |node| solution.x[(node, b)] - mean_b,
                ) + drop(a) * drop(b) * contact.length
            }
        }
    }
}
