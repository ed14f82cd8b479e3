//! The phantom itself: a sheet under the loads of now, and its electrodes.

use std::sync::Arc;
use std::time::Duration;

use eit::{DiscTank, Forward, ForwardError, Mesh, MeshError, PaperSheet, Preset};
use nalgebra::DMatrix;
use survey::Volts;

use crate::effects::{Effects, Needs, ReadingContext};
use crate::load::{Load, LoadError};
use crate::scene::{Scene, TimedLoad};

/// Solutions kept: the untouched sheet and a few recent states.
const KEPT: usize = 8;

/// Why there is no phantom, or no answer from it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PhantomError {
    /// The sheet cannot be meshed.
    #[error("the phantom's sheet is refused")]
    Mesh(#[from] MeshError),
    /// A load cannot be pressed.
    #[error("the phantom's load is refused")]
    Load(#[from] LoadError),
    /// The voltages cannot be computed.
    #[error("the phantom's voltages cannot be computed")]
    Forward(#[from] ForwardError),
}

/// A simulated sheet: transfer impedances between its electrodes at a moment, and readings bent by its scene's effects.
#[derive(Debug)]
pub struct Phantom {
    scene: Scene,
    forward: Forward,
    /// The contact impedances without effects, ohm m.
    contacts: Vec<f64>,
    /// Centroids of the triangles, m.
    places: Vec<[f64; 2]>,
    /// Covered share of triangles of each load of the time line.
    covered: Vec<Vec<(usize, f64)>>,
    /// Loads pressed by hand.
    live: Vec<(Load, Vec<(usize, f64)>)>,
    /// Most recent last.
    solved: Vec<(State, DMatrix<f64>)>,
    effects: Effects,
}

/// What decides the solution: which loads of the time line are on, the loads pressed by hand, what effects are at.
#[derive(Debug, Clone, PartialEq)]
struct State {
    on: Vec<bool>,
    live: Vec<Load>,
    /// Of the effects on sheet, contacts and network.
    epochs: Vec<u64>,
}

/// Length of each electrode's contact, m: what 1 ohm is in ohm m.
fn contact_lengths(sheet: &Preset) -> Vec<f64> {
    match sheet.clone() {
        Preset::PaperSheet(sheet) => Preset::PaperSheet(PaperSheet {
            contact_ohm: 1.0,
            ..sheet
        }),
        Preset::DiscTank(tank) => Preset::DiscTank(DiscTank {
            contact_ohm: 1.0,
            ..tank
        }),
    }
    .contact_ohm_m()
}

impl Phantom {
    /// Meshes the scene's sheet and places its loads.
    ///
    /// # Errors
    /// Measures that do not fit together, or a load beside the sheet.
    pub fn new(scene: Scene) -> Result<Self, PhantomError> {
        let mesh = Arc::new(scene.sheet.mesh()?);
        let covered = scene
            .loads
            .iter()
            .map(|timed| timed.load.coverage(&mesh))
            .collect::<Result<_, _>>()?;
        let mut contacts = scene.sheet.contact_ohm_m();
        let lengths = contact_lengths(&scene.sheet);
        for (electrode, ohm) in &scene.contacts {
            contacts[electrode.0] = ohm * lengths[electrode.0];
        }
        let places = (0..mesh.triangles().len())
            .map(|t| mesh.centroid(t))
            .collect();
        let forward = Forward::new(mesh, &contacts)?;
        let effects = Effects::new(&scene.effects, scene.seed);
        Ok(Self {
            scene,
            forward,
            contacts,
            places,
            covered,
            live: Vec::new(),
            solved: Vec::new(),
            effects,
        })
    }

    /// Number of electrodes.
    pub fn electrodes(&self) -> usize {
        self.forward.mesh().electrodes()
    }

    /// What is simulated.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The phantom's own mesh.
    pub fn mesh(&self) -> &Arc<Mesh> {
        self.forward.mesh()
    }

    pub(crate) fn forward(&self) -> &Forward {
        &self.forward
    }

    /// The loads on the sheet at a moment: those of the time line, then those pressed by hand.
    pub fn loads(&self, at: Duration) -> impl Iterator<Item = &Load> {
        self.scene
            .loads
            .iter()
            .filter(move |timed| timed.is_on(at))
            .map(|timed| &timed.load)
            .chain(self.live.iter().map(|(load, _)| load))
    }

    /// Presses a load by hand, beside whatever is on the sheet.
    ///
    /// # Errors
    /// A load from which nothing follows, or beside the sheet.
    pub fn press(&mut self, load: Load) -> Result<(), PhantomError> {
        let covered = load.coverage(self.forward.mesh())?;
        self.live.push((load, covered));
        Ok(())
    }

    /// Takes all loads pressed by hand away; the time line goes on.
    pub fn release(&mut self) {
        self.live.clear();
    }

    /// The truth: conductance of each triangle of the phantom's own mesh at a moment, S per square. Losses that cover
    /// the same place multiply. Time does not run back: what wanders is answered as it was last.
    pub fn conductance(&mut self, at: Duration) -> Vec<f64> {
        let mut sigma = vec![self.scene.sheet.conductance(); self.mesh().triangles().len()];
        let on = self
            .scene
            .loads
            .iter()
            .zip(&self.covered)
            .filter(|(timed, _)| timed.is_on(at))
            .map(|(timed, covered)| (&timed.load, covered));
        let live = self.live.iter().map(|(load, covered)| (load, covered));
        for (load, covered) in on.chain(live) {
            for &(triangle, share) in covered {
                sigma[triangle] *= 1.0 - load.loss * share;
            }
        }
        for effect in &mut self.effects.sheet {
            effect.act(at, &self.places, &mut sigma);
        }
        sigma
    }

    /// The matrix Z with U = Z I between the electrodes at a moment, ohm; computed once as long as no load changes.
    ///
    /// # Errors
    /// A sheet that cannot be solved.
    pub fn transfer_impedance(&mut self, at: Duration) -> Result<&DMatrix<f64>, PhantomError> {
        let state = State {
            on: self
                .scene
                .loads
                .iter()
                .map(|timed: &TimedLoad| timed.is_on(at))
                .collect(),
            live: self.live.iter().map(|(load, _)| load.clone()).collect(),
            epochs: self.effects.epochs(at),
        };
        match self.solved.iter().position(|(solved, _)| *solved == state) {
            Some(known) => {
                let last = self.solved.len() - 1;
                self.solved[known..=last].rotate_left(1);
            }
            None => {
                let solved = self.solve(at)?;
                if self.solved.len() == KEPT {
                    self.solved.remove(0);
                }
                self.solved.push((state, solved));
            }
        }
        let last = self.solved.len() - 1;
        Ok(&self.solved[last].1)
    }

    fn solve(&mut self, at: Duration) -> Result<DMatrix<f64>, PhantomError> {
        let sigma = self.conductance(at);
        if !self.effects.contacts.is_empty() {
            let mut contacts = self.contacts.clone();
            for effect in &mut self.effects.contacts {
                effect.act(at, &mut contacts);
            }
            if contacts != self.forward.contact_ohm_m() {
                self.forward.set_contact_ohm_m(&contacts)?;
            }
        }
        let mut solved = self.forward.transfer_impedance(&sigma)?;
        for effect in &mut self.effects.network {
            effect.act(at, &mut solved);
        }
        Ok(solved)
    }

    /// What a reading's context must say beside what is at hand.
    pub fn needs(&self) -> Needs {
        self.effects.needs()
    }

    /// What the voltmeter is given instead of the exact voltage: bent by the scene's effects, bit for bit the same
    /// where the scene names none.
    pub fn reading(&mut self, exact: Volts, context: ReadingContext) -> Volts {
        self.effects.reading(exact, &context)
    }
}
