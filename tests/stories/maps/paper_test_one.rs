//! The paper's Test #1 in our interpretation: sixteen presses of a 10 mm disc, 2 uV of noise, data from a finer mesh.

use phantom::Scene;
use survey::Baseline;

use crate::test_rig::{NOISY, runtime};
use crate::transport::frame_as_text::{drivers, frame, plan, simulated};

/// Accuracy goals for the one-step method, mm.
const MEAN_MM: f64 = 2.0;
const EACH_MM: f64 = 5.0;

#[test]
fn sixteen_presses_are_found_by_the_one_step_method() {
    let method = {
        let preset = eit::Preset::default();
        let mesh = std::sync::Arc::new(preset.mesh().expect("the preset's mesh"));
        let contacts = preset.contact_ohm_m();
        let sigma0 = vec![preset.conductance(); mesh.triangles().len()];
        let protocol = survey::Protocol::sheffield(26).expect("26 electrodes");
        let options = eit::OneStepOptions {
            hyper: eit::Hyper::Noise {
                volts: 2e-6,
                current: 1e-3,
            },
            ..eit::OneStepOptions::default()
        };
        eit::OneStep::new(mesh, &contacts, &sigma0, &protocol, options)
            .expect("the preset can be reconstructed")
    };
    let models = ["rbf-matched", "rbf-paper"].map(|name| {
        let path = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../models"));
        eit::load_reconstructor(&path.join(format!("{name}.safetensors")))
            .expect("the model ships with the project")
    });
    runtime().block_on(async {
        let scene = Scene::parse("two-microvolts.toml", NOISY).expect("the scene is sound");
        let bench = simulated("pairs-34924a", scene);
        let rig = drivers(&bench).await;
        let plan = plan(&keysight_34980a::pairs_34924a(1, 26).expect("26 pairs fit"));
        let mut quiet = Vec::new();
        for _ in 0..10 {
            quiet.push(frame(&rig, &plan).await);
        }
        let baseline = Baseline::from_frames("unloaded", &quiet).expect("ten frames of one kind");
        let mut off: Vec<Vec<f64>> = vec![Vec::new(); 3];
        for place in phantom::paper::test1_positions() {
            bench
                .press(phantom::paper::s1(place))
                .expect("the place is on the sheet");
            let pressed = frame(&rig, &plan).await;
            bench.release();
            let methods: [&dyn eit::Reconstructor; 3] =
                [&method, models[0].as_ref(), models[1].as_ref()];
            for (off, method) in off.iter_mut().zip(methods) {
                let map = method
                    .reconstruct(&baseline.readings, &pressed.readings)
                    .expect("a clean frame gives a map");
                let mesh = eit::Reconstructor::mesh(method);
                let found = map.found(&mesh.region_centroids(), &mesh.region_areas());
                off.push(found.map_or(f64::INFINITY, |at| {
                    (at[0] * 1e3 - place[0]).hypot(at[1] * 1e3 - place[1])
                }));
            }
        }
        for (name, off) in ["one-step", "rbf-matched", "rbf-paper"].iter().zip(&off) {
            let mean = off.iter().sum::<f64>() / 16.0;
            let worst = off.iter().copied().fold(0.0, f64::max);
            println!("{name:>12}: mean {mean:.2} mm, worst {worst:.2} mm");
        }
        let mean = off[0].iter().sum::<f64>() / 16.0;
        assert!(mean <= MEAN_MM, "one-step: mean {mean} mm: {:?}", off[0]);
        assert!(
            off[0].iter().all(|off| *off <= EACH_MM),
            "one-step: {:?}",
            off[0]
        );
    });
}
