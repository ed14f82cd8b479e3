//! Every trained method runs the paper's two tests in the daemon, on frames received as SCPI text. The maps equal those
//! made offline from ideal frames, within the digits of the instruments.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use dbus::{Address, Manager1Proxy, Options, Session1Proxy, Simulation1Proxy};
use eit::Reconstructor;
use phantom::{Load, Phantom, Scene, Shape, paper};
use survey::{Protocol, Reading, Volts};
use tactus_tests::DEADLINE;

use crate::test_rig::{self, Needs, QUIET, runtime};

const CURRENT: f64 = 1e-3;
/// Trainings too small to learn much, but enough to run the networks.
const TRAIN: [(&str, &str); 2] = [
    (
        "deep",
        "tactus-lab train dnn --yes --profile paper --cases 200 --repeats 1 --epochs 1 --set width=24 --set hidden_layers=2 \
         --set batch=16 --set held_out=8 --seed 7 --out",
    ),
    (
        "linear",
        "tactus-lab train linear --yes --profile matched --cases 200 --seed 7 --out",
    ),
];

/// Waits for the map of a frame: a busy daemon publishes the frame first.
async fn map_of(session: &Session1Proxy<'_>, sequence: u64) -> dbus::LatestMap {
    let begun = Instant::now();
    loop {
        match session.latest_map().await {
            Ok(map) if map.sequence == sequence => return map,
            _ => assert!(begun.elapsed() < DEADLINE, "frame {sequence} has no map"),
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[test]
fn paper_tests_agree_between_daemon_and_offline() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let shipped = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../models"));
    let mut files: Vec<PathBuf> = ["rbf-paper", "rbf-matched"]
        .map(|name| shipped.join(format!("{name}.safetensors")))
        .to_vec();
    for (name, command) in TRAIN {
        let file = folder.path().join(format!("{name}.safetensors"));
        let words = command
            .split_whitespace()
            .map(Into::into)
            .chain([file.clone().into_os_string()]);
        assert_eq!(lab::run(words), std::process::ExitCode::SUCCESS);
        files.push(file);
    }
    let models: Vec<_> = files
        .iter()
        .map(|file| eit::load_reconstructor(file).expect("the model was made for this sheet"))
        .collect();
    let loads: Vec<Load> = paper::test1_positions()
        .map(paper::s1)
        .into_iter()
        .chain(
            [paper::s2, paper::s3, paper::s4]
                .into_iter()
                .flat_map(|shape| paper::TEST2_MM.map(shape)),
        )
        .collect();
    let (baseline, ideal) = ideal(&loads);

    let Some(stage) = test_rig::set_with(Needs::SIMULATED, QUIET, |config| {
        with_model(config, &files[0])
    }) else {
        return;
    };
    let template = std::fs::read_to_string(stage.config_path()).expect("the stage is there");
    let _guard = test_rig::start(&stage);
    test_rig::baseline(&stage, 1);
    runtime().block_on(async {
        let (connection, _) = dbus::connect(Some(&Address::Unix(stage.peer_path())))
            .await
            .expect("the daemon listens");
        let manager = Manager1Proxy::new(&connection).await.expect("its root is there");
        let hand = Simulation1Proxy::new(&connection).await.expect("the rig is simulated");
        for (file, model) in files.iter().zip(&models) {
            let config = template.replace(
                &files[0].display().to_string(),
                &file.display().to_string(),
            );
            stage.configure(&config).expect("the stage is there");
            manager.reload().await.expect("the daemon is idle, the model fits");
            let path = manager
                .start_session(&Options::new().with("step", true))
                .await
                .expect("the baseline serves every model");
            let session = Session1Proxy::new(&connection, path).await.expect("it has begun");
            let allowed = digits_of_a_map(model.as_ref(), &baseline, &ideal);
            let mut furthest = 0.0_f64;
            for (load, exact) in loads.iter().zip(&ideal) {
                press(&hand, load).await;
                session.step(1).await.expect("a frame is taken");
                let frame = session.latest_frame().await.expect("it is on disk");
                for (sent, exact) in frame.volts.iter().zip(exact) {
                    assert!(
                        (sent - exact).abs() <= 1.01 * half_a_digit(*exact),
                        "{}: {sent:e}, not {exact:e}",
                        load.name
                    );
                }
                let online = map_of(&session, frame.sequence).await;
                let offline = model
                    .reconstruct(&readings(&baseline), &readings(exact))
                    .expect("an ideal frame has a map");
                assert_eq!(online.method, offline.method);
                assert_eq!(online.mesh_hash, offline.mesh_hash);
                let largest = offline.values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
                assert!(largest > 0.0, "{}: an empty map proves nothing", load.name);
                let off = online
                    .values
                    .iter()
                    .zip(&offline.values)
                    .fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
                // networks sum in single precision: allow some units in its last place
                let allowed = allowed + 4.0 * f64::from(f32::EPSILON) * largest;
                assert!(
                    off <= allowed,
                    "{}, {}: {off:e} apart, the digits explain {allowed:e}",
                    offline.method,
                    load.name
                );
                furthest = furthest.max(off);
            }
            assert!(furthest > 0.0, "no digit was cut off: the frames did not come as text");
            println!(
                "{}: 25 maps, at most {furthest:.1e} from offline; the digits explain {allowed:.1e}",
                model.method()
            );
            hand.release().await.expect("the sheet is free again");
            session.stop().await.expect("it ends");
        }
    });
}

/// The exact readings of the simulated sheet at 1 mA: unloaded, and under each load.
fn ideal(loads: &[Load]) -> (Vec<f64>, Vec<Vec<f64>>) {
    let scene = Scene::parse("quiet", QUIET).expect("the scene is sound");
    let mut phantom = Phantom::new(scene).expect("the sheet can be made");
    let protocol = Protocol::sheffield(26).expect("26 electrodes");
    let mut exact = |load: Option<&Load>| -> Vec<f64> {
        phantom.release();
        if let Some(load) = load {
            phantom
                .press(load.clone())
                .expect("the load lies on the sheet");
        }
        let z = phantom
            .transfer_impedance(Duration::ZERO)
            .expect("it is solved");
        protocol
            .measurements()
            .iter()
            .map(|measurement| {
                let (drive, sense) = (measurement.drive, measurement.sense);
                let between = |to: usize| z[(sense.plus.0, to)] - z[(sense.minus.0, to)];
                CURRENT * (between(drive.plus.0) - between(drive.minus.0))
            })
            .collect()
    };
    (
        exact(None),
        loads.iter().map(|load| exact(Some(load))).collect(),
    )
}

fn readings(volts: &[f64]) -> Vec<Reading> {
    volts
        .iter()
        .map(|volts| Reading::Ok(Volts(*volts)))
        .collect()
}

/// Readings are sent as `+d.dddddddd E-dd`: half a unit of the ninth digit.
fn half_a_digit(volts: f64) -> f64 {
    0.5 * 10_f64.powf(volts.abs().log10().floor() - 8.0)
}

/// Largest change of a map's value if every reading of baseline and frame changes by half of its last digit, each in
/// the worst direction: the sum of the single effects, from differences a thousand times as large (smaller ones would
/// vanish in the single precision of networks). The maximum over four frames, one of each shape.
fn digits_of_a_map(model: &dyn Reconstructor, baseline: &[f64], ideal: &[Vec<f64>]) -> f64 {
    const STEP: f64 = 1e3;
    let map = |baseline: &[f64], frame: &[f64]| {
        model
            .reconstruct(&readings(baseline), &readings(frame))
            .expect("an ideal frame has a map")
            .values
    };
    let mut worst = 0.0_f64;
    for frame in [&ideal[5], &ideal[17], &ideal[20], &ideal[23]] {
        let middle = map(baseline, frame);
        let mut sums = vec![0.0; middle.len()];
        for reading in 0..frame.len() {
            let mut moved = [baseline.to_vec(), frame.clone()];
            for (side, volts) in [baseline, frame].into_iter().enumerate() {
                moved[side][reading] += STEP * half_a_digit(volts[reading]);
                let values = map(&moved[0], &moved[1]);
                for (sum, (value, middle)) in sums.iter_mut().zip(values.iter().zip(&middle)) {
                    *sum += (value - middle).abs() / STEP;
                }
                moved[side][reading] = volts[reading];
            }
        }
        worst = sums.into_iter().fold(worst, f64::max);
    }
    worst
}

/// Presses a load of the paper on the daemon's sheet.
async fn press(hand: &Simulation1Proxy<'_>, load: &Load) {
    let (shape, mm) = match load.shape {
        Shape::Disc { diameter_mm } => ("disc", diameter_mm),
        Shape::Rectangle { width_mm, .. } => ("rectangle", width_mm),
        Shape::Triangle { side_mm } => ("triangle", side_mm),
        Shape::FigureEight {
            diameter_mm,
            distance_mm,
        } => ("figure-eight", diameter_mm + distance_mm),
        ref other => panic!("the paper has no {other:?}"),
    };
    let [x, y] = load.centre_mm.map(|mm| mm * 1e-3);
    hand.press(shape, x, y, mm * 1e-3, load.loss)
        .await
        .expect("the load lies on the sheet");
}

/// The configuration with a model file in place of the method.
fn with_model(config: &str, file: &Path) -> String {
    let method = "method = \"one-step\"\nnoise_uv = 2.0\n";
    assert!(config.contains(method), "{config}");
    config.replace(method, &format!("file = \"{}\"\n", file.display()))
}
