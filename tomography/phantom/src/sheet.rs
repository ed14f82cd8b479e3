//! The phantom: a simulated sheet with its electrodes, and the loads at a time.

use std::sync::Arc;
use std::time::Duration;

use eit::{DiscTank, Forward, ForwardError, Mesh, MeshError, PaperSheet, Preset};
use nalgebra::DMatrix;
use survey::{Dipole, Ohms, Relay, Volts};

use crate::effects::{Effects, Needs, Places, RelayContact};
use crate::history::History;
use crate::law::Law;
use crate::load::{Load, LoadError};
use crate::press::{Print, Stage};
use crate::scan::{ReadingContext, Scan, across};
use crate::scene::Scene;

/// Maximum number of stored solutions.
const KEPT: usize = 8;

/// Errors of the phantom.
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

/// A simulated sheet: transfer impedances between its electrodes at a time, and readings with the scene's effects.
#[derive(Debug)]
pub struct Phantom {
    scene: Scene,
    forward: Forward,
    /// The contact impedances without effects, ohm m.
    contacts: Vec<f64>,
    /// Centroids (m) and areas (m2) of the triangles.
    places: Vec<[f64; 2]>,
    areas: Vec<f64>,
    law: Law,
    /// The losses by each load of the time line, at the last step computed.
    prints: Vec<(Stage, Print)>,
    /// Loads pressed interactively.
    live: Vec<(Load, Print)>,
    /// Whether the interactive loads have changed since the last update of the history.
    live_changed: bool,
    /// `None` if no effect acts on the losses of the loads.
    history: Option<History>,
    /// Stored solutions, the most recently used last.
    solved: Vec<(State, DMatrix<f64>)>,
    effects: Effects,
}

/// The state that determines the solution: the step of each load, the interactive loads, the epochs.
#[derive(Debug, Clone, PartialEq)]
struct State {
    stages: Vec<Option<Stage>>,
    live: Vec<Load>,
    /// Of the effects on sheet, contacts and network, and of the load history.
    epochs: Vec<u64>,
}

/// Smallest conductance in the load history, as a share of the unloaded sheet's.
const LEAST: f64 = 1e-8;

/// Length of each electrode's contact, m: converts ohm to ohm m.
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

/// The mesh with the node displacements of the scene's effects.
fn displaced(mesh: Mesh, sheet: &Preset, effects: &Effects) -> Result<Mesh, MeshError> {
    if effects.mesh.is_empty() {
        return Ok(mesh);
    }
    let mut nodes = mesh.nodes().to_vec();
    for effect in &effects.mesh {
        effect.displace(sheet, &mut nodes);
    }
    let (triangles, edges) = (mesh.triangles().to_vec(), mesh.electrode_edges().to_vec());
    Mesh::new(nodes, triangles, edges, Some(mesh.region().to_vec()))
}

impl Phantom {
    /// Meshes the scene's sheet and prepares its loads.
    ///
    /// # Errors
    /// Inconsistent dimensions, or a load outside the sheet.
    pub fn new(scene: Scene) -> Result<Self, PhantomError> {
        let mut effects = Effects::new(&scene.effects, scene.seed);
        let law = effects.law(scene.pressure);
        let mesh = Arc::new(displaced(scene.sheet.mesh()?, &scene.sheet, &effects)?);
        let begin = [0, 0];
        let prints = scene
            .loads
            .iter()
            .map(|timed| Ok((begin, timed.print(begin, &law, &mesh)?)))
            .collect::<Result<_, LoadError>>()?;
        let mut contacts = scene.sheet.contact_ohm_m();
        let lengths = contact_lengths(&scene.sheet);
        for (electrode, ohm) in &scene.contacts {
            contacts[electrode.0] = ohm * lengths[electrode.0];
        }
        let triangles = 0..mesh.triangles().len();
        let places = triangles.clone().map(|t| mesh.centroid(t)).collect();
        let areas = triangles.map(|t| mesh.area(t)).collect();
        let forward = Forward::new(mesh, &contacts)?;
        let history = History::new(std::mem::take(&mut effects.losses));
        Ok(Self {
            scene,
            forward,
            contacts,
            places,
            areas,
            law,
            prints,
            live: Vec::new(),
            live_changed: false,
            history,
            solved: Vec::new(),
            effects,
        })
    }

    /// Number of electrodes.
    pub fn electrodes(&self) -> usize {
        self.forward.mesh().electrodes()
    }

    /// The scene.
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

    /// The loads on the sheet at a time: those of the time line, then the interactive ones.
    pub fn loads(&self, at: Duration) -> impl Iterator<Item = Load> {
        let timed = self.scene.loads.iter();
        timed
            .filter_map(move |timed| timed.at(at, &self.law))
            .chain(self.live.iter().map(|(load, _)| load.clone()))
    }

    /// Adds an interactive load.
    ///
    /// # Errors
    /// An invalid load, or one outside the sheet.
    pub fn press(&mut self, load: Load) -> Result<(), PhantomError> {
        let covered = load.coverage(self.forward.mesh())?.into_iter();
        let print = covered.map(|(t, share)| (t, load.loss * share)).collect();
        self.live.push((load, print));
        self.live_changed = true;
        Ok(())
    }

    /// Removes all interactive loads; the time line continues. Returns false if there were none.
    pub fn release(&mut self) -> bool {
        let pressed = !self.live.is_empty();
        self.live.clear();
        self.live_changed |= pressed;
        pressed
    }

    /// The true conductance of each triangle of the phantom's mesh at a time, S per square. The remaining shares under
    /// overlapping loads are multiplied. Time must not decrease: for an earlier time, random processes keep their last
    /// value.
    pub fn conductance(&mut self, at: Duration) -> Vec<f64> {
        self.follow(at);
        let mut sigma = vec![self.scene.sheet.conductance(); self.mesh().triangles().len()];
        self.each_print(at, |triangle, lost| sigma[triangle] *= 1.0 - lost);
        if let Some(history) = &self.history {
            history.act(&mut sigma);
        }
        for effect in &mut self.effects.sheet {
            effect.act(at, &self.places, &mut sigma);
        }
        sigma
    }

    /// Calls `tell` with each triangle under a load and its loss, load by load.
    fn each_print(&mut self, at: Duration, mut tell: impl FnMut(usize, f64)) {
        for (timed, (known, print)) in self.scene.loads.iter().zip(&mut self.prints) {
            let Some(stage) = timed.stage(at) else {
                continue;
            };
            if stage != *known {
                // the first step was computed in `new`, so later ones cannot fail
                let mesh = self.forward.mesh();
                *print = timed.print(stage, &self.law, mesh).unwrap_or_default();
                *known = stage;
            }
            for &(triangle, lost) in print.iter() {
                tell(triangle, lost);
            }
        }
        for &(triangle, lost) in self.live.iter().flat_map(|(_, print)| print) {
            tell(triangle, lost);
        }
    }

    /// Updates the load history up to a time.
    fn follow(&mut self, at: Duration) {
        let Some(mut history) = self.history.take() else {
            return;
        };
        let mut changes = Vec::new();
        if self.live_changed || history.last().is_none() {
            changes.push(history.last().unwrap_or_default());
            self.live_changed = false;
        }
        let mut last = history.last().unwrap_or_default();
        loop {
            let loads = self.scene.loads.iter();
            let next = loads.filter_map(|timed| timed.next_change(last)).min();
            match next.filter(|next| *next <= at) {
                Some(next) => changes.push(next),
                None => break,
            }
            last = changes[changes.len() - 1];
        }
        for change in changes {
            let on = |at: Duration| self.scene.loads.iter().map(move |timed| timed.is_on(at));
            let before = history.last();
            let moved = before.is_some_and(|before| change > before && on(before).eq(on(change)));
            let mut losses = vec![0.0; self.places.len()];
            self.each_print(change, |t, lost| losses[t] -= (1.0 - lost).max(LEAST).ln());
            let places = Places {
                centroids: &self.places,
                areas: &self.areas,
                pressed: &[],
            };
            history.change(change, losses, moved, &places);
        }
        let places = Places {
            centroids: &self.places,
            areas: &self.areas,
            pressed: &[],
        };
        history.rest(at, &places);
        self.history = Some(history);
    }

    /// The matrix Z with U = Z I between the electrodes at a time, ohm, one row and one column per electrode; reused
    /// while nothing changes.
    ///
    /// # Errors
    /// A sheet that cannot be solved.
    pub fn transfer_impedance(&mut self, at: Duration) -> Result<&DMatrix<f64>, PhantomError> {
        self.follow(at);
        let mut epochs = self.effects.epochs(at);
        epochs.extend(self.history.as_ref().map(History::version));
        let loads = self.scene.loads.iter();
        let state = State {
            stages: loads.map(|timed| timed.stage(at)).collect(),
            live: self.live.iter().map(|(load, _)| load.clone()).collect(),
            epochs,
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

    /// Whether an effect acts on relays and wires, so that [`Phantom::relay_contact`] is needed.
    pub fn affects_wires(&self) -> bool {
        !self.effects.wires.is_empty()
    }

    /// The state of a relay's path after this many closures, with the scene's effects.
    pub fn relay_contact(&mut self, relay: Relay, closures: u64, at: Duration) -> RelayContact {
        let mut contact = RelayContact::default();
        for effect in &mut self.effects.wires {
            effect.act(relay, closures, at, &mut contact);
        }
        contact
    }

    /// Resistance that the scene's effects add to the source's loop, without the relays.
    pub fn loop_resistance(&self) -> Ohms {
        let wires = self.effects.wires.iter();
        // the fold starts at 0.0 because `sum` of an empty list would be -0.0
        Ohms(wires.fold(0.0, |sum, effect| sum + effect.loop_resistance().0))
    }

    /// The values that a reading's context must include.
    pub fn needs(&self) -> Needs {
        self.effects.needs()
    }

    /// The measured voltage for an exact one, with the scene's effects; bit for bit the same if the scene names none.
    pub fn reading(&mut self, exact: Volts, context: ReadingContext) -> Volts {
        self.effects.reading(exact, &context)
    }
}

impl Scan {
    /// The readings of a frame that starts at `begin`, for an ideal voltmeter: without compliance, ranges and digits,
    /// which the simulated instruments add. `begin` must not be earlier than in the last call.
    ///
    /// # Errors
    /// A sheet that cannot be solved.
    pub fn frame(
        &self,
        phantom: &mut Phantom,
        begin: Duration,
    ) -> Result<Vec<Volts>, PhantomError> {
        let needs = phantom.needs();
        let measurements = self.protocol.measurements().iter();
        measurements
            .zip(self.contexts(begin))
            .map(|(measurement, context)| {
                let z = phantom.transfer_impedance(context.at)?;
                let exact = self.current.0 * across(z, measurement.sense, measurement.drive);
                let seen = |needed: bool, pair: Dipole| {
                    Ohms(if needed { across(z, pair, pair) } else { 0.0 })
                };
                let context = ReadingContext {
                    source_resistance: seen(needs.source_resistance, measurement.sense),
                    load_resistance: seen(needs.load_resistance, measurement.drive),
                    ..context
                };
                Ok(phantom.reading(Volts(exact), context))
            })
            .collect()
    }
}
