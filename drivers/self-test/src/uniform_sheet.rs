//! The uniform sheet that a self-test compares with: voltages of every pair for every injection, per ampere.

use std::sync::Arc;

use eit::{Forward, ForwardError, Mesh};

/// The expected sheet below the electrodes, without a load.
#[derive(Debug, Clone)]
pub struct ExpectedSheet {
    /// The mesh with its electrodes.
    pub mesh: Arc<Mesh>,
    /// Contact impedance of each electrode, ohm m.
    pub contact_ohm_m: Vec<f64>,
    /// Conductance of each triangle, S per square.
    pub sigma: Vec<f64>,
}

/// The expected sheet, scaled to the fitted resistance.
pub(crate) struct Uniform {
    electrodes: usize,
    /// Transfer impedance, ohm: a row for each electrode of the voltage, a column for each of the current.
    z: Vec<Vec<f64>>,
    /// Mean sheet resistance, ohm.
    pub sheet_ohm: f64,
    /// Contact resistance of each electrode, ohm.
    pub contact_ohm: Vec<f64>,
}

impl Uniform {
    /// The expected sheet, its resistance multiplied by `factor`.
    pub(crate) fn new(expected: &ExpectedSheet, factor: f64) -> Result<Self, ForwardError> {
        let forward = Forward::new(Arc::clone(&expected.mesh), &expected.contact_ohm_m)?;
        let sigma: Vec<f64> = expected.sigma.iter().map(|sigma| sigma / factor).collect();
        let impedance = forward.transfer_impedance(&sigma)?;
        let electrodes = expected.mesh.electrodes();
        let mean = sigma.iter().sum::<f64>() / sigma.len().max(1) as f64;
        let nodes = expected.mesh.nodes();
        let length = |edges: &Vec<[usize; 2]>| {
            let each = edges.iter().map(|[from, to]| {
                let [x, y] = nodes[*from];
                (nodes[*to][0] - x).hypot(nodes[*to][1] - y)
            });
            each.sum::<f64>()
        };
        let edges = expected.mesh.electrode_edges();
        Ok(Self {
            electrodes,
            z: (0..electrodes)
                .map(|row| {
                    (0..electrodes)
                        .map(|column| impedance[(row, column)])
                        .collect()
                })
                .collect(),
            sheet_ohm: 1.0 / mean,
            contact_ohm: expected
                .contact_ohm_m
                .iter()
                .zip(edges)
                .map(|(contact, edges)| contact / length(edges))
                .collect(),
        })
    }

    /// Voltage from electrode `plus` to `minus` for a current of 1 A that enters at `from` and leaves at `to`.
    pub(crate) fn volts(&self, (from, to): (usize, usize), (plus, minus): (usize, usize)) -> f64 {
        let n = self.electrodes;
        let at = |electrode: usize| self.z[electrode % n][from % n] - self.z[electrode % n][to % n];
        at(plus) - at(minus)
    }

    /// Voltage of pair `sense` when pair `drive` is driven.
    pub(crate) fn pair(&self, drive: usize, sense: usize) -> f64 {
        self.volts((drive, drive + 1), (sense, sense + 1))
    }
}
