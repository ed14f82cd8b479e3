//! The uniform sheet that a self-test compares with: voltages of every pair for every injection, per ampere.

use std::sync::Arc;

use eit::{Forward, ForwardError};

use imaging::Geometry;

/// A uniform sheet on the configured geometry.
pub(super) struct Uniform {
    electrodes: usize,
    /// Transfer impedance, ohm, by row.
    z: Vec<Vec<f64>>,
    /// Mean sheet resistance, ohm.
    pub sheet_ohm: f64,
    /// Contact resistance of each electrode, ohm.
    pub contact_ohm: Vec<f64>,
}

impl Uniform {
    /// The geometry's own sheet, its resistance multiplied by `factor`.
    pub(super) fn new(geometry: &Geometry, factor: f64) -> Result<Self, ForwardError> {
        let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m)?;
        let sigma: Vec<f64> = geometry.sigma0.iter().map(|sigma| sigma / factor).collect();
        let impedance = forward.transfer_impedance(&sigma)?;
        let electrodes = geometry.electrodes();
        let mean = sigma.iter().sum::<f64>() / sigma.len().max(1) as f64;
        let nodes = geometry.mesh.nodes();
        let length = |edges: &Vec<[usize; 2]>| {
            let each = edges.iter().map(|[from, to]| {
                let [x, y] = nodes[*from];
                (nodes[*to][0] - x).hypot(nodes[*to][1] - y)
            });
            each.sum::<f64>()
        };
        let edges = geometry.mesh.electrode_edges();
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
            contact_ohm: geometry
                .contact_ohm_m
                .iter()
                .zip(edges)
                .map(|(contact, edges)| contact / length(edges))
                .collect(),
        })
    }

    /// Voltage from electrode `plus` to `minus` when an ampere enters at `from` and leaves at `to`.
    pub(super) fn volts(&self, (from, to): (usize, usize), (plus, minus): (usize, usize)) -> f64 {
        let n = self.electrodes;
        let at = |electrode: usize| self.z[electrode % n][from % n] - self.z[electrode % n][to % n];
        at(plus) - at(minus)
    }

    /// Voltage of pair `sense` when pair `drive` is driven.
    pub(super) fn pair(&self, drive: usize, sense: usize) -> f64 {
        self.volts((drive, drive + 1), (sense, sense + 1))
    }
}
