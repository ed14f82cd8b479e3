//! What the unknowns say: electrode voltages, potentials, drops over contacts.

use nalgebra::DMatrix;

use super::system::Form;
use super::{Fields, Forward};
use crate::sparse::Block;

/// Unknowns of some drives as they come from the solver, with what is needed to read them.
pub(crate) struct Solution {
    /// u or d on nodes, U (0 where eliminated) on electrodes; as many columns as there are drives, and padding.
    pub(super) x: Block,
    pub(super) forms: Vec<Form>,
    /// Currents into the electrodes (rows) of each drive (column).
    pub(super) currents: DMatrix<f64>,
    pub(super) floored: usize,
}

impl Forward {
    /// An unknown: of a node, or of an electrode (counted on from the nodes).
    fn at(&self, solution: &Solution, index: usize, column: usize) -> f64 {
        solution.x.row(self.unknown[index])[column]
    }

    /// An electrode's voltage relative to the ground node, in two parts of which the second (z I / |e|, where the
    /// voltage was eliminated) may be far larger.
    pub(super) fn voltage(&self, solution: &Solution, electrode: usize, column: usize) -> [f64; 2] {
        match solution.forms[electrode] {
            Form::Difference | Form::Shunt => [
                self.at(solution, self.mesh.nodes().len() + electrode, column),
                0.0,
            ],
            Form::Eliminated => {
                let contact = &self.electrodes[electrode];
                let mean = contact.mean(|node| self.at(solution, node, column));
                let current = solution.currents[(electrode, column)];
                [mean, self.contact[electrode] * current / contact.length]
            }
        }
    }

    /// Potential of every node of one drive relative to the ground node.
    pub(crate) fn potential(&self, solution: &Solution, column: usize) -> Vec<f64> {
        let nodes = self.mesh.nodes().len();
        (0..nodes)
            .map(|node| {
                let x = self.at(solution, node, column);
                match self.on[node] {
                    Some(e) if solution.forms[e] != Form::Eliminated => {
                        x + self.at(solution, nodes + e, column)
                    }
                    _ => x,
                }
            })
            .collect()
    }

    pub(super) fn fields(&self, solution: &Solution) -> Fields {
        let nodes = self.mesh.nodes().len();
        let count = self.electrodes.len();
        let columns = solution.currents.ncols();
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
            Form::Difference => contact.mass(
                |node| self.at(solution, node, a),
                |node| self.at(solution, node, b),
            ),
            Form::Eliminated => {
                let mean = |c: usize| contact.mean(|node| self.at(solution, node, c));
                let (mean_a, mean_b) = (mean(a), mean(b));
                let drop = |c: usize| {
                    self.contact[electrode] * solution.currents[(electrode, c)] / contact.length
                };
                contact.mass(
                    |node| self.at(solution, node, a) - mean_a,
                    |node| self.at(solution, node, b) - mean_b,
                ) + drop(a) * drop(b) * contact.length
            }
        }
    }
}
