//! Diagram 8: location error over months with the baseline of the first day, while the sheet drifts.

use std::sync::Arc;
use std::time::Duration;

use eit::{Hyper, OneStep, OneStepOptions, PaperSheet, Preset, Reconstructor};
use nalgebra::DMatrix;
use phantom::{FINER, Load, Phantom, Scene, across};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::{Protocol, Reading, Volts};

use crate::failure::Failure;
use crate::progress;
use crate::tradeoff::Effort;
use crate::tradeoff::panel::FARTHEST_MM;
use crate::tradeoff::panel::{Panel, Point};

/// White noise of one reading, V, at [`CURRENT`].
const NOISE_V: f64 = 2e-6;
const CURRENT: f64 = 1e-3;
/// Positions of the presses, mm: a disc of 30 mm that takes half the conductance.
const PRESSES_MM: [[f64; 2]; 3] = [[107.0, 115.0], [60.0, 70.0], [150.0, 160.0]];
const DISC_MM: f64 = 30.0;

/// What drifts.
const DRIFTS: [(&str, &str); 2] = [
    ("gain", "[effects.long-drift]\n"),
    ("contacts", "[effects.contact-drift]\n"),
];

pub(crate) fn panel(effort: &Effort) -> Result<Panel, Failure> {
    let days: &[f64] = effort.of(
        &[0.01, 1.0, 30.0][..],
        &[0.01, 0.04, 0.2, 1.0, 3.0, 7.0, 14.0, 30.0, 60.0, 90.0],
    );
    let sheet = PaperSheet {
        fineness: effort.of(0.5, 1.0),
        ..PaperSheet::default()
    };
    let mesh = Arc::new(
        sheet
            .mesh()
            .map_err(|fault| Failure::of("the mesh", &fault))?,
    );
    let protocol = Protocol::sheffield(sheet.electrodes())
        .map_err(|fault| Failure::of("the protocol", &fault))?;
    let sigma0 = vec![sheet.conductance(); mesh.triangles().len()];
    let options = OneStepOptions {
        hyper: Hyper::Noise {
            volts: NOISE_V,
            current: CURRENT,
        },
        ..OneStepOptions::default()
    };
    let method = OneStep::new(
        Arc::clone(&mesh),
        &sheet.contact_ohm_m(),
        &sigma0,
        &protocol,
        options,
    )
    .map_err(|fault| Failure::of("one-step", &fault))?;
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    let bar = progress::bar(DRIFTS.len() * effort.seeds() as usize, "months");
    let mut zero = vec![vec![Vec::new(); days.len()]; DRIFTS.len()];
    let mut place = zero.clone();
    for (drift, (_, effect)) in DRIFTS.iter().enumerate() {
        for draw in 0..effort.seeds() {
            let mut month = Month::new(&sheet, effect, 100 * effort.seed + draw, &protocol)?;
            let baseline = month.frame(Duration::ZERO, None)?;
            for (day, zero) in days.iter().zip(&mut zero[drift]) {
                let at = survey::duration(86_400.0 * day);
                let map = method
                    .reconstruct(&baseline, &month.frame(at, None)?)
                    .map_err(|fault| Failure::of("one-step", &fault))?;
                let (mut sum, mut all) = (0.0, 0.0);
                for (value, area) in map.values.iter().zip(&areas) {
                    sum += area * value * value;
                    all += area;
                }
                zero.push((sum / all).sqrt());
            }
            // time must not decrease: another phantom for the presses
            let mut month = Month::new(&sheet, effect, 100 * effort.seed + draw, &protocol)?;
            let baseline = month.frame(Duration::ZERO, None)?;
            for (day, place) in days.iter().zip(&mut place[drift]) {
                let at = survey::duration(86_400.0 * day);
                let mut errors = 0.0;
                for press in PRESSES_MM {
                    let map = method
                        .reconstruct(&baseline, &month.frame(at, Some(press))?)
                        .map_err(|fault| Failure::of("one-step", &fault))?;
                    // a map without any loss gets the largest error: the sheet's half diagonal
                    errors += map.found(&centroids, &areas).map_or(FARTHEST_MM, |found| {
                        (1e3 * found[0] - press[0]).hypot(1e3 * found[1] - press[1])
                    });
                }
                place.push(errors / PRESSES_MM.len() as f64);
            }
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    let mut points = Vec::new();
    for (drift, (name, _)) in DRIFTS.iter().enumerate() {
        for (k, day) in days.iter().enumerate() {
            let setting = format!("{day} days");
            let percent: Vec<f64> = zero[drift][k].iter().map(|v| 100.0 * v).collect();
            points.push(Point::new(
                format!("zero, %, {name}"),
                setting.clone(),
                *day,
                &percent,
            ));
            points.push(Point::new(
                format!("place, mm, {name}"),
                setting,
                *day,
                &place[drift][k],
            ));
        }
    }
    Ok(Panel {
        panel: "months".to_owned(),
        title: "Months: the baseline of the first day".to_owned(),
        across: "days since the baseline".to_owned(),
        up: "zero, % of conductance; place, mm".to_owned(),
        shows: format!(
            "Root mean square of the map of an untouched sheet, and location error of a {DISC_MM} mm press that takes half the \
             conductance, by one-step with the baseline of day 0, while the sheet's gain or its contacts drift as the scenes' \
             effects `long-drift` and `contact-drift` do by default."
        ),
        not_proved: "The sizes of the drifts are the fact sheet's ranges, not a measured sheet's; a baseline that is recorded anew \
                     every day begins this diagram anew, and a press on a sheet that is never empty is not judged."
            .to_owned(),
        not_built: vec!["a baseline that is tracked: its curve waits for it".to_owned()],
        costs: false,
        points,
    })
}

/// A drifting sheet, measured.
struct Month<'a> {
    phantom: Phantom,
    protocol: &'a Protocol,
    noise: Normal<f64>,
    random: ChaCha8Rng,
}

impl<'a> Month<'a> {
    fn new(
        sheet: &PaperSheet,
        effect: &str,
        seed: u64,
        protocol: &'a Protocol,
    ) -> Result<Self, Failure> {
        let scene =
            Scene::parse("month", effect).map_err(|fault| Failure::of("the scene", &fault))?;
        let scene = Scene {
            seed,
            sheet: Preset::PaperSheet(sheet.clone()).remeshed(FINER, 1),
            ..scene
        };
        Ok(Self {
            phantom: Phantom::new(scene).map_err(|fault| Failure::of("the sheet", &fault))?,
            protocol,
            noise: Normal::new(0.0, NOISE_V).expect("a positive constant"),
            random: ChaCha8Rng::seed_from_u64(seed),
        })
    }

    fn frame(&mut self, at: Duration, press: Option<[f64; 2]>) -> Result<Vec<Reading>, Failure> {
        let failed = |fault| Failure::of("the sheet", &fault);
        self.phantom.release();
        if let Some(place) = press {
            let load = Load::disc(place, DISC_MM, 0.5);
            self.phantom.press(load).map_err(failed)?;
        }
        let z: &DMatrix<f64> = self.phantom.transfer_impedance(at).map_err(failed)?;
        Ok(self
            .protocol
            .measurements()
            .iter()
            .map(|q| CURRENT * across(z, q.sense, q.drive))
            .map(|volts| Reading::Ok(Volts(volts + self.noise.sample(&mut self.random))))
            .collect())
    }
}
