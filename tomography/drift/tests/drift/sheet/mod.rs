//! A simulated sheet on a finer mesh than the model's.

use std::sync::Arc;

use drift::{DriftModel, FitOptions, Noise};
use eit::{Forward, PaperSheet};
use nalgebra::DMatrix;
use survey::{Dipole, Electrode, Protocol, Reading, Volts};

pub struct Sheet {
    pub baseline: Vec<Reading>,
    gain: f64,
}

fn paper_sheet(fineness: f64) -> PaperSheet {
    PaperSheet {
        fineness,
        ..PaperSheet::default()
    }
}

impl Sheet {
    pub fn new() -> Self {
        Self::with_gain(1.0)
    }

    pub fn with_gain(gain: f64) -> Self {
        let mut sheet = Self {
            baseline: Vec::new(),
            gain,
        };
        sheet.baseline = sheet.readings(|_| 1.0, |_| 1.0);
        sheet
    }

    /// A sheet with a measured baseline.
    pub fn of(baseline: Vec<Reading>) -> Self {
        Self {
            baseline,
            gain: 1.0,
        }
    }

    /// Readings at 1 mA; contacts and conductance (by place, m) relative to nominal.
    pub fn readings(
        &self,
        contacts: impl Fn(usize) -> f64,
        sigma: impl Fn([f64; 2]) -> f64,
    ) -> Vec<Reading> {
        let (forward, sigma) = self.forward(contacts, sigma);
        let ohms = forward
            .readings(&sigma, &Protocol::sheffield(26).unwrap())
            .unwrap();
        ohms.iter()
            .map(|ohms| Reading::Ok(Volts(1e-3 * ohms)))
            .collect()
    }

    /// Readings with two electrodes connected by 1 ohm.
    pub fn shorted(&self, [a, b]: [usize; 2]) -> Vec<Reading> {
        let (forward, sigma) = self.forward(|_| 1.0, |_| 1.0);
        let drives: Vec<Dipole> = (1..26)
            .map(|e| Dipole {
                plus: Electrode(e),
                minus: Electrode(0),
            })
            .collect();
        let solved = forward.solve(&sigma, &drives).unwrap().electrodes;
        // column e: potentials for 1 A into electrode e and out of electrode 0
        let z = DMatrix::from_fn(26, 26, |r, c| if c == 0 { 0.0 } else { solved[(r, c - 1)] });
        let field = z.column(a) - z.column(b);
        let own = field[a] - field[b] + 1.0;
        let protocol = Protocol::sheffield(26).unwrap();
        let volts = protocol.measurements().iter().map(|q| {
            let [p, m, s, t] = [
                q.drive.plus.0,
                q.drive.minus.0,
                q.sense.plus.0,
                q.sense.minus.0,
            ];
            let direct = z[(s, p)] - z[(t, p)] - z[(s, m)] + z[(t, m)];
            let through = (field[s] - field[t]) * (field[p] - field[m]) / own;
            Reading::Ok(Volts(1e-3 * (direct - through)))
        });
        volts.collect()
    }

    fn forward(
        &self,
        contacts: impl Fn(usize) -> f64,
        sigma: impl Fn([f64; 2]) -> f64,
    ) -> (Forward, Vec<f64>) {
        let sheet = paper_sheet(1.2);
        let mesh = Arc::new(sheet.mesh().unwrap());
        let contact = sheet.contact_ohm_m().into_iter().enumerate();
        let contact: Vec<f64> = contact.map(|(e, value)| value * contacts(e)).collect();
        let sigma = (0..mesh.triangles().len())
            .map(|triangle| sheet.conductance() / self.gain * sigma(mesh.centroid(triangle)));
        let sigma = sigma.collect();
        (Forward::new(mesh, &contact).unwrap(), sigma)
    }

    pub fn model(&self) -> DriftModel {
        self.model_with_noise(2e-6)
    }

    /// `reading_v`: standard deviation of one reading, V.
    pub fn model_with_noise(&self, reading_v: f64) -> DriftModel {
        self.model_on(0.7, reading_v)
    }

    /// On a mesh of this fineness; the preset's is 1.
    pub fn model_on(&self, fineness: f64, reading_v: f64) -> DriftModel {
        let sheet = paper_sheet(fineness);
        let mesh = sheet.mesh().unwrap();
        let sigma0 = vec![sheet.conductance(); mesh.triangles().len()];
        DriftModel::new(
            &mesh,
            &sheet.contact_ohm_m(),
            &sigma0,
            &Protocol::sheffield(26).unwrap(),
            &self.baseline,
            Noise {
                reading_v,
                emf_v: 0.0,
            },
            &FitOptions::default(),
        )
        .unwrap()
    }
}

/// A finer mesh, made once, for many states of the sheet.
pub struct Fine {
    forward: Forward,
    mesh: Arc<eit::Mesh>,
    sigma: f64,
    protocol: Protocol,
}

impl Fine {
    pub fn new() -> Self {
        Self::of(1.2)
    }

    pub fn of(fineness: f64) -> Self {
        let sheet = paper_sheet(fineness);
        let mesh = Arc::new(sheet.mesh().unwrap());
        Self {
            forward: Forward::new(Arc::clone(&mesh), &sheet.contact_ohm_m()).unwrap(),
            mesh,
            sigma: sheet.conductance(),
            protocol: Protocol::sheffield(26).unwrap(),
        }
    }

    /// Readings at 1 mA, V. `factor` returns the relative conductance of a triangle; its argument returns the share of
    /// that triangle within a disc (centre and radius, m).
    pub fn volts(&self, factor: impl Fn(&dyn Fn([f64; 2], f64) -> f64) -> f64) -> Vec<f64> {
        let sigma: Vec<f64> = (0..self.mesh.triangles().len())
            .map(|triangle| {
                let corners = self.mesh.corners(triangle);
                self.sigma * factor(&|centre, radius| share(corners, centre, radius))
            })
            .collect();
        let ohms = self.forward.readings(&sigma, &self.protocol).unwrap();
        ohms.iter().map(|ohms| 1e-3 * ohms).collect()
    }
}

/// Share of a triangle within a disc, by 36 points in it.
fn share(corners: [[f64; 2]; 3], centre: [f64; 2], radius: f64) -> f64 {
    const SIDE: usize = 8;
    let (mut inside, mut all) = (0, 0);
    for i in 0..SIDE {
        for j in 0..SIDE - i {
            let (a, b) = (
                (i as f64 + 1.0 / 3.0) / SIDE as f64,
                (j as f64 + 1.0 / 3.0) / SIDE as f64,
            );
            let at = [0, 1].map(|axis| {
                corners[0][axis] * (1.0 - a - b) + corners[1][axis] * a + corners[2][axis] * b
            });
            all += 1;
            inside += usize::from((at[0] - centre[0]).hypot(at[1] - centre[1]) < radius);
        }
    }
    inside as f64 / all as f64
}
