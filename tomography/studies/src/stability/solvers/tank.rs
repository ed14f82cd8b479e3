//! The sheet for most hard cases: a small round tank with eight electrodes.

use std::sync::Arc;

use eit::{
    DiscTank, Forward, Jitter, Mesh, Model, Network, OneStep, OneStepError, OneStepOptions,
    PaperSheet, RbfNetwork, Report, TrainingSettings, Tv, TvOptions,
};
use qd::Quad;
use survey::Protocol;
use training::rbf::train_rbf_on;
use training::samples::{Simulation, TrainError};

use super::bordered::{Bordered, Ground, Number};
use crate::failure::{Attempt, Failure};
use crate::sheet::protocol;

/// A round sheet of 1 kohm per square with its protocol.
pub(crate) struct Tank {
    pub(crate) preset: DiscTank,
    pub(crate) mesh: Arc<Mesh>,
    /// Contact impedance of each electrode, ohm m.
    pub(crate) contact: Vec<f64>,
    /// Conductance of each triangle of the unloaded sheet, S per square.
    pub(crate) sigma: Vec<f64>,
    pub(crate) protocol: Protocol,
}

impl Tank {
    /// A tank with eight electrodes of 100 ohm and some hundreds of nodes.
    pub(crate) fn small() -> Result<Self, Failure> {
        Self::of(DiscTank {
            electrodes: 8,
            arc_deg: 12.0,
            fineness: 0.5,
            ..DiscTank::default()
        })
    }

    /// A tank with sixteen electrodes, for reconstructions.
    pub(crate) fn sixteen(fineness: f64) -> Result<Self, Failure> {
        Self::of(DiscTank {
            fineness,
            ..DiscTank::default()
        })
    }

    /// The paper's sheet on a coarse mesh.
    pub(crate) fn paper() -> Result<Self, Failure> {
        let sheet = PaperSheet {
            fineness: 0.4,
            ..PaperSheet::default()
        };
        let mesh = sheet.mesh().attempt("the paper's sheet")?;
        Ok(Self {
            sigma: vec![sheet.conductance(); mesh.triangles().len()],
            contact: sheet.contact_ohm_m(),
            protocol: protocol(sheet.electrodes())?,
            mesh: Arc::new(mesh),
            preset: DiscTank::default(),
        })
    }

    pub(crate) fn of(preset: DiscTank) -> Result<Self, Failure> {
        let mesh = preset.mesh().attempt("the tank")?;
        Ok(Self {
            sigma: vec![preset.conductance(); mesh.triangles().len()],
            contact: preset.contact_ohm_m(),
            protocol: protocol(preset.electrodes)?,
            mesh: Arc::new(mesh),
            preset,
        })
    }

    /// Radius, m.
    pub(crate) fn radius(&self) -> f64 {
        1e-3 * self.preset.radius_mm
    }

    /// Length of an electrode, m.
    pub(crate) fn length(&self) -> f64 {
        self.mesh.electrode_length(0)
    }

    /// Triangles within a disc; position and radius in units of the tank's radius.
    pub(crate) fn patch(&self, centre: [f64; 2], radius: f64) -> Vec<usize> {
        let r = self.radius();
        (0..self.mesh.triangles().len())
            .filter(|&t| {
                let [x, y] = self.mesh.centroid(t);
                (x / r - centre[0]).hypot(y / r - centre[1]) < radius
            })
            .collect()
    }

    /// The conductance with these triangles multiplied by a factor.
    pub(crate) fn with(&self, triangles: &[usize], factor: f64) -> Vec<f64> {
        let mut sigma = self.sigma.clone();
        triangles.iter().for_each(|&t| sigma[t] *= factor);
        sigma
    }

    pub(crate) fn forward(&self, contact: &[f64]) -> Result<Forward, Failure> {
        Forward::new(Arc::clone(&self.mesh), contact).map_err(refused)
    }

    /// The readings of `eit` at 1 A, V.
    pub(crate) fn ours(&self, contact: &[f64], sigma: &[f64]) -> Result<Vec<f64>, Failure> {
        let readings = self.forward(contact)?.readings(sigma, &self.protocol);
        Ok(readings.map_err(refused)?.as_slice().to_vec())
    }

    /// The readings of the textbook's form in a given precision.
    pub(crate) fn textbook<T: Number>(
        &self,
        contact: &[f64],
        sigma: &[f64],
        ground: Ground,
    ) -> Vec<f64> {
        Bordered::<T>::new(&self.mesh, contact, sigma, &[], ground).readings(&self.protocol)
    }

    /// The readings of the textbook's form in twice the precision of f64.
    pub(crate) fn exact(&self, contact: &[f64], sigma: &[f64]) -> Vec<f64> {
        self.textbook::<Quad>(contact, sigma, Ground::Node)
    }

    /// The one-step method on the tank.
    pub(crate) fn one_step(&self, options: OneStepOptions) -> Result<OneStep, OneStepError> {
        let mesh = Arc::clone(&self.mesh);
        OneStep::new(mesh, &self.contact, &self.sigma, &self.protocol, options)
    }

    /// Total variation on the tank.
    pub(crate) fn tv(&self, options: TvOptions) -> Result<Tv, Failure> {
        let mesh = Arc::clone(&self.mesh);
        Tv::new(mesh, &self.contact, &self.sigma, &self.protocol, options)
            .attempt("total variation")
    }

    /// Cases for a training on the tank.
    pub(crate) fn simulation(&self, settings: &TrainingSettings) -> Result<Simulation, TrainError> {
        let (contact, sigma) = (&self.contact, &self.sigma);
        Simulation::new(&self.mesh, contact, sigma, &self.protocol, settings)
    }

    /// A network of [`few_neurons`], and its model.
    pub(crate) fn trained(&self, cases: usize) -> Result<(RbfNetwork, Model), Failure> {
        let settings = few_neurons(cases);
        let (network, report) = self
            .simulation(&settings)
            .and_then(|simulation| train_rbf_on(&simulation, &settings, &|_, _, _| {}))
            .attempt("the training")?;
        let model = Model::new(
            "rbf matched",
            Arc::clone(&self.mesh),
            &self.protocol,
            Network::Rbf(network.clone()),
            settings,
            Report::Rbf(report),
            None,
        );
        let model = model.attempt("the model")?;
        Ok((network, model))
    }
}

/// A training of twelve neurons with the noise of the paper's instruments.
pub(crate) fn few_neurons(cases: usize) -> TrainingSettings {
    TrainingSettings {
        cases,
        repeats: 2,
        neurons: 12,
        jitter: Jitter::Matched {
            noise_v: 2e-6,
            current_a: 1e-3,
        },
        ..TrainingSettings::default()
    }
}

pub(crate) fn refused(fault: eit::ForwardError) -> Failure {
    Failure::of("the forward model", &fault)
}
