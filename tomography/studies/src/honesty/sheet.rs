//! The sheet on which frames are simulated: a finer, different mesh than the model's, with loads of many shapes.

use std::f64::consts::TAU;
use std::sync::Arc;

use eit::{Forward, Mesh, PaperSheet, bounding_box};
use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use survey::Protocol;

use crate::failure::{Attempt, Failure};

/// Current of the frames, A.
pub(super) const CURRENT: f64 = 1e-3;
/// A load within this distance of an electrode, m, counts as a load at the electrode.
const FAR: f64 = 8e-3;

/// The paper's sheet on a mesh that is finer than, and different from, the model's.
pub struct FineSheet {
    forward: Forward,
    conductance: f64,
    pub(super) protocol: Protocol,
    centroids: Vec<[f64; 2]>,
    /// Smallest and largest value of each coordinate of the centroids, m.
    bounds: [[f64; 2]; 2],
    electrodes: Vec<[f64; 2]>,
    /// Readings of the unloaded sheet at 1 A, V.
    pub(super) unloaded: Vec<f64>,
}

/// Kinds of load, used in turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Discs(usize),
    Blob,
    Ramp,
    /// A change of the whole sheet by 1 %, and a press of 10 mm.
    SheetChange,
    SquareRing,
    /// A press over an electrode.
    OverElectrode,
    /// A disc of 10 mm with half its conductance lost, 20 mm or more from the edge.
    Press,
    Nothing,
}

impl Kind {
    pub(super) const ALL: [Self; 10] = [
        Self::Discs(1),
        Self::Discs(2),
        Self::Discs(3),
        Self::Blob,
        Self::Ramp,
        Self::SheetChange,
        Self::SquareRing,
        Self::OverElectrode,
        Self::Press,
        Self::Nothing,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Discs(1) => "one disc",
            Self::Discs(2) => "two discs",
            Self::Discs(_) => "three discs",
            Self::Blob => "soft blob",
            Self::Ramp => "ramp over the sheet",
            Self::SheetChange => "1 % of the sheet and a press",
            Self::SquareRing => "square ring",
            Self::OverElectrode => "press over an electrode",
            Self::Press => "press of 10 mm",
            Self::Nothing => "nothing",
        }
    }
}

/// A load: the factor of the conductance of each triangle of the finer mesh.
pub(super) struct Load {
    pub(super) kind: Kind,
    pub(super) factors: Vec<f64>,
    /// Whether it changes the conductance within [`FAR`] of an electrode, apart from a change of the whole sheet.
    pub(super) at_electrode: bool,
}

impl FineSheet {
    /// Solves the unloaded sheet.
    ///
    /// # Errors
    /// A sheet that cannot be computed, or a protocol for another number of electrodes.
    pub fn new(protocol: &Protocol) -> Result<Self, Failure> {
        let sheet = PaperSheet {
            fineness: 1.6,
            ..PaperSheet::default()
        };
        let mesh = sheet.mesh().attempt("the finer sheet")?;
        let centroids: Vec<[f64; 2]> = (0..mesh.triangles().len())
            .map(|triangle| mesh.centroid(triangle))
            .collect();
        let [low, high] = bounding_box(centroids.iter().copied());
        let bounds = [0, 1].map(|axis| [low[axis], high[axis]]);
        let electrodes = mesh.electrode_centres();
        let mut fine = Self {
            forward: Forward::new(Arc::new(mesh), &sheet.contact_ohm_m()).map_err(unsolved)?,
            conductance: sheet.conductance(),
            protocol: protocol.clone(),
            bounds,
            electrodes,
            unloaded: Vec::new(),
            centroids,
        };
        fine.unloaded = fine.readings(&fine.factors(|_| 1.0))?;
        Ok(fine)
    }

    /// The finer mesh.
    pub(super) fn mesh(&self) -> &Mesh {
        self.forward.mesh()
    }

    /// The factor of the conductance of each triangle, as a function of its centroid (m).
    pub fn factors(&self, factor: impl Fn([f64; 2]) -> f64) -> Vec<f64> {
        self.centroids.iter().map(|at| factor(*at)).collect()
    }

    /// Readings of the sheet with these factors of its conductance, V at 1 A.
    ///
    /// # Errors
    /// Factors that are refused: negative, or not one for each triangle.
    pub fn readings(&self, factors: &[f64]) -> Result<Vec<f64>, Failure> {
        self.solved(&self.forward, factors)
    }

    /// As [`FineSheet::readings`], with the contact impedance of one electrode multiplied by a factor.
    pub(super) fn readings_with_contact(
        &self,
        factors: &[f64],
        electrode: usize,
        times: f64,
    ) -> Result<Vec<f64>, Failure> {
        let mut impedances = self.forward.contact_ohm_m().to_vec();
        impedances[electrode] *= times;
        let mesh = Arc::clone(self.forward.mesh());
        let forward = Forward::new(mesh, &impedances).map_err(unsolved)?;
        self.solved(&forward, factors)
    }

    fn solved(&self, forward: &Forward, factors: &[f64]) -> Result<Vec<f64>, Failure> {
        let sigma: Vec<f64> = factors.iter().map(|f| self.conductance * f).collect();
        let readings = forward.readings(&sigma, &self.protocol).map_err(unsolved)?;
        Ok(readings.as_slice().to_vec())
    }

    /// A load of this kind.
    pub(super) fn load(&self, kind: Kind, random: &mut ChaCha8Rng) -> Load {
        let bounds = self.bounds;
        let place =
            |random: &mut ChaCha8Rng| bounds.map(|[low, high]| random.random_range(low..high));
        let mut factors = self.factors(|_| 1.0);
        let mut press = |inside: &dyn Fn([f64; 2]) -> f64| {
            for (factor, at) in factors.iter_mut().zip(&self.centroids) {
                *factor = f64::min(*factor, inside(*at));
            }
        };
        let disc = |centre: [f64; 2], radius: f64, loss: f64| {
            move |at: [f64; 2]| match away(at, centre) < radius {
                true => 1.0 - loss,
                false => 1.0,
            }
        };
        match kind {
            Kind::Discs(count) => {
                for _ in 0..count {
                    let centre = place(random);
                    let radius = 3e-3 * 10_f64.powf(random.random_range(0.0..1.0));
                    press(&disc(centre, radius, random.random_range(0.1..0.95)));
                }
            }
            Kind::Blob => {
                let (centre, width) = (place(random), random.random_range(0.008..0.04));
                let loss = random.random_range(0.1..0.8);
                press(&|at| 1.0 - loss * (-0.5 * (away(at, centre) / width).powi(2)).exp());
            }
            Kind::Ramp => {
                let angle: f64 = random.random_range(0.0..TAU);
                let loss = random.random_range(0.05..0.5);
                let [x, y] = bounds.map(|[low, high]| move |v: f64| (v - low) / (high - low) - 0.5);
                press(&|at| {
                    let along = x(at[0]) * angle.cos() + y(at[1]) * angle.sin();
                    1.0 - loss * (0.5 + along / std::f64::consts::SQRT_2)
                });
            }
            Kind::SheetChange => {
                press(&disc(place(random), 5e-3, random.random_range(0.3..0.7)));
            }
            Kind::SquareRing => {
                let (centre, half) = (place(random), random.random_range(0.01..0.04));
                let loss = random.random_range(0.1..0.8);
                press(&|at| {
                    let distance = (at[0] - centre[0]).abs().max((at[1] - centre[1]).abs());
                    match (0.5 * half..half).contains(&distance) {
                        true => 1.0 - loss,
                        false => 1.0,
                    }
                });
            }
            Kind::OverElectrode => {
                let electrode = random.random_range(0..self.electrodes.len());
                let radius = random.random_range(0.004..0.015);
                let loss = random.random_range(0.2..0.8);
                press(&disc(self.electrodes[electrode], radius, loss));
            }
            Kind::Press => {
                let inner = bounds.map(|[low, high]| random.random_range(low + 0.02..high - 0.02));
                press(&disc(inner, 5e-3, 0.5));
            }
            Kind::Nothing => {}
        }
        // a ramp changes the surroundings of every electrode a little, which no contact explains
        let at_electrode = kind != Kind::Ramp
            && self.centroids.iter().zip(&factors).any(|(at, factor)| {
                *factor < 1.0 - 1e-3 && self.electrodes.iter().any(|e| away(*at, *e) < FAR)
            });
        if kind == Kind::SheetChange {
            factors.iter_mut().for_each(|factor| *factor *= 0.99);
        }
        Load {
            kind,
            factors,
            at_electrode,
        }
    }
}

fn unsolved(fault: eit::ForwardError) -> Failure {
    Failure::of("the finer sheet", &fault)
}

pub(super) fn away(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// The random stream of one frame of one series.
pub(super) fn random(seed: u64, series: u64, frame: u64) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(series << 32 | frame);
    random
}
