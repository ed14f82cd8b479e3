//! Test #1 of the paper on the simulated sheet: 16 presses of 10 mm with half the conductance lost, 2 uV of white noise
//! on baseline and frame, frames simulated on the phantom's finer mesh, and one hyper-parameter derived from the noise.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use eit::{
    Mesh, OneStep, OneStepOptions, PaperSheet, Preset, Prior, Reconstructor, load_reconstructor,
};
use phantom::{Phantom, Scene, TimedLoad, paper};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::{Protocol, Reading, Volts};

const CURRENT: f64 = 1e-3;
const NOISE: f64 = 2e-6;

struct Test1 {
    baselines: Vec<Vec<Reading>>,
    /// Position (m) and one frame for each baseline.
    presses: Vec<([f64; 2], Vec<Vec<Reading>>)>,
}

impl Test1 {
    /// Draws the noise of every frame `draws` times.
    fn new(protocol: &Protocol, draws: u64) -> Self {
        let noisy = |position: usize, scene: Scene| -> Vec<Vec<Reading>> {
            let mut phantom = Phantom::new(scene).unwrap();
            let z = phantom
                .transfer_impedance(Duration::from_secs(1))
                .unwrap()
                .clone();
            let noise = Normal::new(0.0, NOISE).unwrap();
            (0..draws)
                .map(|draw| {
                    let mut random = ChaCha8Rng::seed_from_u64(1000 * draw + position as u64);
                    protocol
                        .measurements()
                        .iter()
                        .map(|question| {
                            let exact = phantom::across(&z, question.sense, question.drive);
                            Reading::Ok(Volts(CURRENT * exact + noise.sample(&mut random)))
                        })
                        .collect()
                })
                .collect()
        };
        Self {
            baselines: noisy(999, Scene::quiet()),
            presses: paper::test1_positions()
                .iter()
                .enumerate()
                .map(|(position, at)| {
                    let scene = Scene {
                        loads: vec![TimedLoad::still(paper::s1(*at), Duration::ZERO, None)],
                        ..Scene::quiet()
                    };
                    ([at[0] * 1e-3, at[1] * 1e-3], noisy(position, scene))
                })
                .collect(),
        }
    }

    /// Mean and largest distance, mm, between true and found position.
    fn errors(&self, mesh: &Mesh, reconstructor: &dyn Reconstructor) -> (f64, f64) {
        let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
        let mut errors = Vec::new();
        for (at, frames) in &self.presses {
            for (baseline, frame) in self.baselines.iter().zip(frames) {
                let map = reconstructor.reconstruct(baseline, frame).unwrap();
                let found = map.found(&centroids, &areas).unwrap();
                errors.push(1e3 * (found[0] - at[0]).hypot(found[1] - at[1]));
            }
        }
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        (mean, errors.iter().copied().fold(0.0, f64::max))
    }
}

#[test]
fn sixteen_presses_are_found_where_they_are() {
    let sheet = PaperSheet::default();
    let mesh = Arc::new(sheet.mesh().unwrap());
    let protocol = Protocol::sheffield(26).unwrap();
    let test = Test1::new(&protocol, 4);
    let sigma0 = vec![sheet.conductance(); mesh.triangles().len()];
    for (prior, loss_only, mean_mm, worst_mm) in [
        (OneStepOptions::default().prior, false, 2.0, 5.0),
        (OneStepOptions::default().prior, true, 1.0, 2.5),
        (Prior::Laplace, false, 2.5, 5.0),
        // p = 0.5 shifts presses towards the middle and is therefore not the default
        (Prior::default(), false, 3.5, 5.0),
        (Prior::default(), true, 1.5, 3.0),
    ] {
        let options = OneStepOptions {
            prior,
            loss_only,
            ..OneStepOptions::default()
        };
        let one_step = OneStep::new(
            Arc::clone(&mesh),
            &sheet.contact_ohm_m(),
            &sigma0,
            &protocol,
            options,
        )
        .unwrap();
        let (mean, worst) = test.errors(&mesh, &one_step);
        println!(
            "{prior:?}, loss only {loss_only}, lambda {:.3e}: mean {mean:.2} mm, worst {worst:.2} mm",
            one_step.lambda().unwrap()
        );
        assert!(
            mean <= mean_mm && worst <= worst_mm,
            "{prior:?}, loss only {loss_only}"
        );
    }
}

/// The files of the shipped networks must fit the sheet. Networks of the paper's size blur a press of 10 mm, so their
/// results are only printed.
#[test]
fn the_shipped_networks_fit_the_sheet() {
    let mesh = Preset::default().mesh().unwrap();
    let protocol = Protocol::sheffield(26).unwrap();
    let test = Test1::new(&protocol, 1);
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
    for name in ["rbf-paper", "rbf-matched"] {
        let path = models.join(format!("{name}.safetensors"));
        let network = load_reconstructor(&path).unwrap();
        assert_eq!(network.mesh().hash(), mesh.hash());
        assert_eq!(network.protocol(), &protocol);
        let (mean, worst) = test.errors(&mesh, network.as_ref());
        println!("{name}: mean {mean:.1} mm, worst {worst:.1} mm");
    }
}
