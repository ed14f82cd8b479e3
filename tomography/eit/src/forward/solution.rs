//! Electrode voltages, potentials and drops over contacts, from the unknowns.

use nalgebra::DMatrix;

use super::system::Form;
use super::{Fields, Forward};
use crate::linear_algebra::sparse::Block;

/// Unknowns of some drives as the solver returns them, with the system that interprets them.
pub(crate) struct Solution<'s> {
    /// u or d on nodes, U (0 where eliminated) on electrodes; one column per drive, and padding.
    pub(super) x: &'s Block,
    pub(super) forms: &'s [Form],
    /// Currents into the electrodes (rows) of each drive (column).
    pub(super) currents: &'s DMatrix<f64>,
    pub(super) floored: usize,
}

impl Forward {
    /// An unknown by index: nodes first, then electrodes.
    fn at(&self, solution: &Solution, index: usize, column: usize) -> f64 {
        solution.x.row(self.layout.unknown[index])[column]
    }

    /// An electrode's voltage relative to the ground node, in two parts; the second (z I / |e|, if the voltage was
    /// eliminated) may be far larger.
    pub(super) fn voltage(&self, solution: &Solution, electrode: usize, column: usize) -> [f64; 2] {
        match solution.forms[electrode] {
            Form::Difference | Form::Shunt => [
                self.at(solution, self.mesh.nodes().len() + electrode, column),
                0.0,
            ],
            Form::Eliminated => {
                let contact = &self.layout.electrodes[electrode];
                let mean = contact.mean(|node| self.at(solution, node, column));
                let current = solution.currents[(electrode, column)];
                [mean, self.contact[electrode] * current / contact.length]
            }
        }
    }

    /// Potentials relative to the ground node: a row per node (in the mesh's order), a column per drive.
    pub(crate) fn potentials(&self, solution: &Solution) -> Block {
        let nodes = self.mesh.nodes().len();
        let mut block = Block::zeros(nodes, solution.currents.ncols());
        for (node, row) in block.values.chunks_exact_mut(block.width).enumerate() {
            row.copy_from_slice(solution.x.row(self.layout.unknown[node]));
            if let Some(e) = self.layout.on[node]
                && solution.forms[e] != Form::Eliminated
            {
                let electrode = solution.x.row(self.layout.unknown[nodes + e]);
                row.iter_mut().zip(electrode).for_each(|(u, v)| *u += v);
            }
        }
        block
    }

    /// Electrode voltages of each drive (column) with their mean subtracted, and that mean.
    fn levelled(&self, solution: &Solution) -> (DMatrix<f64>, Vec<f64>) {
        let count = self.layout.electrodes.len();
        let columns = solution.currents.ncols();
        let mut electrodes = DMatrix::zeros(count, columns);
        let mut means = Vec::with_capacity(columns);
        for column in 0..columns {
            let voltages: Vec<[f64; 2]> = (0..count)
                .map(|e| self.voltage(solution, e, column))
                .collect();
            // the large parts are summed separately: equal contacts cancel exactly
            let mean = [0, 1].map(|part| {
                voltages.iter().map(|voltage| voltage[part]).sum::<f64>() / count as f64
            });
            for (e, voltage) in voltages.iter().enumerate() {
                electrodes[(e, column)] = (voltage[0] - mean[0]) + (voltage[1] - mean[1]);
            }
            means.push(mean[0] + mean[1]);
        }
        (electrodes, means)
    }

    /// Electrode voltages of each drive (column), mean zero.
    pub(super) fn electrodes(&self, solution: &Solution) -> DMatrix<f64> {
        self.levelled(solution).0
    }

    pub(super) fn fields(&self, solution: &Solution) -> Fields {
        let (electrodes, means) = self.levelled(solution);
        let nodes = self.mesh.nodes().len();
        let mut potentials = DMatrix::zeros(nodes, means.len());
        let into = potentials.as_mut_slice();
        for node in 0..nodes {
            let row = solution.x.row(self.layout.unknown[node]).iter().zip(&means);
            match self.layout.on[node] {
                Some(e) if solution.forms[e] != Form::Eliminated => {
                    let electrode = solution.x.row(self.layout.unknown[nodes + e]);
                    for (column, ((d, mean), v)) in row.zip(electrode).enumerate() {
                        into[column * nodes + node] = (d + v) - mean;
                    }
                }
                _ => {
                    for (column, (u, mean)) in row.enumerate() {
                        into[column * nodes + node] = u - mean;
                    }
                }
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
        let contact = &self.layout.electrodes[electrode];
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
