//! A sheet that makes readings, on a mesh finer than the model's.

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

    /// A sheet that was measured.
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
        // columns: 1 A into e, out of 0
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
        let sheet = paper_sheet(0.7);
        let mesh = sheet.mesh().unwrap();
        let sigma0 = vec![sheet.conductance(); mesh.triangles().len()];
        DriftModel::new(
            &mesh,
            &sheet.contact_ohm_m(),
            &sigma0,
            &Protocol::sheffield(26).unwrap(),
            &self.baseline,
            Noise {
                reading_v: 2e-6,
                emf_v: 0.0,
            },
            &FitOptions::default(),
        )
        .unwrap()
    }
}
