//! The same sheet measured by a scan of pairs and through a matrix: the same voltages.

use phantom::Scene;

use crate::test_rig::runtime;
use crate::transport::frame_as_text::{drivers, frame, plan, simulated, volts};

#[test]
fn scan_and_matrix_measure_the_same_voltages() {
    runtime().block_on(async {
        let mut scene = Scene::quiet();
        scene.loads = Scene::paper_test1(5)
            .expect("there are sixteen places")
            .loads;
        let at_once = |scene: &Scene| {
            let mut scene = scene.clone();
            for load in &mut scene.loads {
                load.from = std::time::Duration::ZERO;
                load.to = None;
            }
            scene
        };
        let scene = at_once(&scene);
        let pairs = simulated("pairs-34924a", scene.clone());
        let scanned = frame(
            &drivers(&pairs).await,
            &plan(&keysight_34980a::pairs_34924a(1, 26).expect("fits")),
        )
        .await;
        let matrix = simulated("matrix-34932a", scene);
        let routed = frame(
            &drivers(&matrix).await,
            &plan(&keysight_34980a::matrix_34932a(1, 26).expect("fits")),
        )
        .await;
        for (reading, (a, b)) in volts(&scanned).into_iter().zip(volts(&routed)).enumerate() {
            // both are rounded to nine digits
            assert!(
                (a - b).abs() <= 2e-8 * a.abs(),
                "m{reading}: {a:e} by scan, {b:e} by matrix"
            );
        }
    });
}
