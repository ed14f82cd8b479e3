//! The same sheet measured by a scan of pairs and through a matrix: the same voltages.

use std::time::Duration;

use phantom::{Scene, TimedLoad, paper};

use crate::test_rig::runtime;
use crate::transport::frame_as_text::{drivers, frame, plan, simulated, volts};

#[test]
fn scan_and_matrix_measure_the_same_voltages() {
    runtime().block_on(async {
        let press = paper::s1(paper::test1_positions()[5]);
        let scene = Scene {
            loads: vec![TimedLoad::still(press, Duration::ZERO, None)],
            ..Scene::quiet()
        };
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
