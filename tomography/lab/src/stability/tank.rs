//! The sheet that most hard cases are tried on: a small round tank with eight electrodes.

use std::sync::Arc;

use eit::{DiscTank, Forward, Mesh, PaperSheet};
use qd::Quad;
use survey::{Protocol, Reading, Volts};

use super::bordered::{Bordered, Ground, Number};
use crate::failure::Failure;

/// A round sheet of 1 kohm a square with its protocol.
pub(super) struct Tank {
    pub(super) preset: DiscTank,
    pub(super) mesh: Arc<Mesh>,
    /// Contact of each electrode, ohm m.
    pub(super) contact: Vec<f64>,
    /// The unloaded sheet.
    pub(super) sigma: Vec<f64>,
    pub(super) protocol: Protocol,
}

impl Tank {
    /// Eight electrodes of 100 ohm, some hundreds of nodes.
    pub(super) fn small() -> Result<Self, Failure> {
        Self::of(DiscTank {
            electrodes: 8,
            arc_deg: 12.0,
            fineness: 0.5,
            ..DiscTank::default()
        })
    }

    /// Sixteen electrodes, for reconstructions.
    pub(super) fn sixteen(fineness: f64) -> Result<Self, Failure> {
        Self::of(DiscTank {
            fineness,
            ..DiscTank::default()
        })
    }

    /// The paper's sheet, coarse.
    pub(super) fn paper() -> Result<Self, Failure> {
        let sheet = PaperSheet {
            fineness: 0.4,
            ..PaperSheet::default()
        };
        let mesh = sheet
            .mesh()
            .map_err(|fault| Failure::of("the paper's sheet", &fault))?;
        Ok(Self {
            sigma: vec![sheet.conductance(); mesh.triangles().len()],
            contact: sheet.contact_ohm_m(),
            protocol: protocol(sheet.electrodes())?,
            mesh: Arc::new(mesh),
            preset: DiscTank::default(),
        })
    }

    pub(super) fn of(preset: DiscTank) -> Result<Self, Failure> {
        let mesh = preset
            .mesh()
            .map_err(|fault| Failure::of("the tank", &fault))?;
        Ok(Self {
            sigma: vec![preset.conductance(); mesh.triangles().len()],
            contact: preset.contact_ohm_m(),
            protocol: protocol(preset.electrodes)?,
            mesh: Arc::new(mesh),
            preset,
        })
    }

    /// Radius, m.
    pub(super) fn radius(&self) -> f64 {
        1e-3 * self.preset.radius_mm
    }

    /// Length of an electrode, m.
    pub(super) fn length(&self) -> f64 {
        self.mesh.electrode_length(0)
    }

    /// Triangles within a disc; place and radius in radii of the tank.
    pub(super) fn patch(&self, centre: [f64; 2], radius: f64) -> Vec<usize> {
        let r = self.radius();
        (0..self.mesh.triangles().len())
            .filter(|&t| {
                let [x, y] = self.mesh.centroid(t);
                (x / r - centre[0]).hypot(y / r - centre[1]) < radius
            })
            .collect()
    }

    /// The sheet with these triangles multiplied.
    pub(super) fn with(&self, triangles: &[usize], factor: f64) -> Vec<f64> {
        let mut sigma = self.sigma.clone();
        triangles.iter().for_each(|&t| sigma[t] *= factor);
        sigma
    }

    pub(super) fn forward(&self, contact: &[f64]) -> Result<Forward, Failure> {
        Forward::new(Arc::clone(&self.mesh), contact).map_err(refused)
    }

    /// Our readings at 1 A, V.
    pub(super) fn ours(&self, contact: &[f64], sigma: &[f64]) -> Result<Vec<f64>, Failure> {
        let readings = self.forward(contact)?.readings(sigma, &self.protocol);
        Ok(readings.map_err(refused)?.as_slice().to_vec())
    }

    /// The textbook's readings in some precision.
    pub(super) fn textbook<T: Number>(
        &self,
        contact: &[f64],
        sigma: &[f64],
        ground: Ground,
    ) -> Vec<f64> {
        Bordered::<T>::new(&self.mesh, contact, sigma, &[], ground).readings(&self.protocol)
    }

    /// The readings in twice the precision.
    pub(super) fn exact(&self, contact: &[f64], sigma: &[f64]) -> Vec<f64> {
        self.textbook::<Quad>(contact, sigma, Ground::Node)
    }
}

pub(super) fn protocol(electrodes: usize) -> Result<Protocol, Failure> {
    Protocol::sheffield(electrodes).map_err(|fault| Failure::of("the protocol", &fault))
}

pub(super) fn refused(fault: eit::ForwardError) -> Failure {
    Failure::of("the forward model", &fault)
}

/// Volts as a rig gives them.
pub(super) fn measured(volts: &[f64]) -> Vec<Reading> {
    volts.iter().map(|v| Reading::Ok(Volts(*v))).collect()
}
