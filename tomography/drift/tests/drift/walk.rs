//! A sheet whose data are linear draws of drift, with a load or without.

use std::sync::Arc;

use drift::{Answer, DriftModel, Sizes, Tracker};
use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use survey::{Reading, Volts};

use crate::sheet::Sheet;

/// Interval of the frames, s.
pub const EVERY_S: f64 = 600.0;

/// A sheet whose data are a random walk with the tracker's own rates times a pace.
pub struct Walk {
    pub sheet: Sheet,
    pub model: Arc<DriftModel>,
    drift: nalgebra::DMatrix<f64>,
    at: DVector<f64>,
    random: ChaCha8Rng,
}

impl Walk {
    pub fn new(pace: f64) -> Self {
        let sheet = Sheet::new();
        let model = Arc::new(sheet.model());
        let day = Sizes {
            gain: 0.01,
            contact: 0.08,
            field: 2e-3,
            local: 2e-3,
        };
        let step = model.drift(&day) * (pace * pace * EVERY_S / 86_400.0);
        let step = step + model.noise() * 1e-9; // definite
        Self {
            drift: step.cholesky().unwrap().l(),
            at: DVector::zeros(299),
            random: ChaCha8Rng::seed_from_u64(5),
            model,
            sheet,
        }
    }

    pub fn frame(&mut self, load: Option<(&DVector<f64>, f64)>) -> Vec<Reading> {
        self.frame_with_change([load, load], 0)
    }

    /// A frame with one load during the injections before that of this electrode, and another from then on.
    pub fn frame_with_change(
        &mut self,
        loads: [Option<(&DVector<f64>, f64)>; 2],
        electrode: usize,
    ) -> Vec<Reading> {
        let mut normal = || -> f64 { StandardNormal.sample(&mut self.random) };
        let draw = DVector::from_fn(299, |_, _| normal());
        self.at += &self.drift * draw;
        let data = loads.map(|load| match load {
            Some((change, by)) => &self.at + change * by,
            None => self.at.clone(),
        });
        let measurements = self.model.pairs().protocol().measurements();
        let mut volts: Vec<f64> = self
            .sheet
            .baseline
            .iter()
            .map(|r| r.volts().unwrap().0)
            .collect();
        for (row, (before, after)) in data[0].iter().zip(&data[1]).enumerate() {
            for reading in self.model.pairs().readings(row) {
                let later = measurements[reading].drive.plus.0 >= electrode;
                volts[reading] += if later { after } else { before } + 2e-6 * normal();
            }
        }
        volts.into_iter().map(|v| Reading::Ok(Volts(v))).collect()
    }
}

/// A walk at the tracker's own pace, and the tracker after this number of its empty frames.
pub fn walked(frames: usize) -> (Walk, Tracker) {
    let mut walk = Walk::new(1.0);
    let mut tracker = Tracker::new(Arc::clone(&walk.model), 0.0).unwrap();
    for frame in 1..=frames {
        follow(&mut tracker, &mut walk, frame, None);
    }
    (walk, tracker)
}

/// Follows a frame of the walk.
pub fn follow(
    tracker: &mut Tracker,
    walk: &mut Walk,
    frame: usize,
    load: Option<(&DVector<f64>, f64)>,
) -> Answer {
    let readings = walk.frame(load);
    tracker.follow(&readings, EVERY_S * frame as f64).unwrap()
}
