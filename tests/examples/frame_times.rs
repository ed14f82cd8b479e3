//! Time per map in the daemon by method: p50 and p99 for frames received as SCPI text, with the paper's times.
//!
//! ```text
//! cargo run --release -p tactus-tests --example frame_times [-- FRAMES [DEEP.safetensors]]
//! ```
//!
//! 200 frames per method by default. Without a file, a deep network of the paper's size is trained on a few cases:
//! its maps are useless, but its computing time is realistic. Times are measured by the daemon's recorder thread: for
//! the map alone, and from the last reading until frame and map are on disk.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use dbus::{Address, Manager1Proxy, Options, Session1Proxy, Simulation1Proxy};
use tactus_tests::{SIMULATED, Stage, act_as};

type Failure = Box<dyn std::error::Error>;

/// Lines of the configuration that name its method.
const METHOD: &str = "method = \"one-step\"\nnoise_uv = 2.0\n";
/// Frames not counted, because they fill caches.
const UNCOUNTED: usize = 5;

fn main() -> ExitCode {
    if let Some(code) = act_as(std::env::args_os()) {
        return code;
    }
    match measure() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("frame_times: {failure}");
            ExitCode::FAILURE
        }
    }
}

fn measure() -> Result<(), Failure> {
    let mut words = std::env::args().skip(1);
    let frames: usize = words.next().map_or(Ok(200), |word| word.parse())?;
    let folder = tempfile::tempdir()?;
    let models = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../models"));
    let trained = |name: &str, command: &str| -> Result<PathBuf, Failure> {
        let file = folder.path().join(name);
        let line = format!("tactus-lab {command} --out {}", file.display());
        let code = lab::run(line.split_whitespace().map(Into::into));
        match code == ExitCode::SUCCESS {
            true => Ok(file),
            false => Err(format!("{line} failed").into()),
        }
    };
    let (deep, of) = match words.next() {
        Some(file) => (PathBuf::from(&file).canonicalize()?, file),
        None => {
            let command = "train dnn --yes --profile paper --cases 64 --repeats 1 --epochs 1 --set held_out=8 --set batch=16";
            (
                trained("deep.safetensors", command)?,
                "trained on 64 cases".to_owned(),
            )
        }
    };
    let linear = trained(
        "linear.safetensors",
        "train linear --profile matched --cases 2000 --symmetric",
    )?;
    let file = |path: &Path| format!("file = \"{}\"\n", path.display());
    let methods = [
        ("one-step", METHOD.to_owned(), ""),
        (
            "one-step, losses only",
            format!("{METHOD}loss_only = true\n"),
            "",
        ),
        ("linear, 2,000 cases", file(&linear), ""),
        ("TV", "method = \"tv\"\nnoise_uv = 2.0\n".to_owned(), "650"),
        (
            "TV, losses only",
            "method = \"tv\"\nnoise_uv = 2.0\nloss_only = true\n".to_owned(),
            "650",
        ),
        (
            "RBF, paper",
            file(&models.join("rbf-paper.safetensors").canonicalize()?),
            "3",
        ),
        (
            "RBF, matched",
            file(&models.join("rbf-matched.safetensors").canonicalize()?),
            "3",
        ),
        ("deep", file(&deep), "5"),
    ];
    let stage = Stage::new(SIMULATED)?;
    std::fs::write(
        stage.path().join("scene.toml"),
        tactus_tests::TWO_MICROVOLTS,
    )?;
    let daemon = stage.start_daemon()?;
    stage
        .tactus(&["baseline", "record", "--frames", "10"])?
        .succeeded()?;
    println!("deep: {of}; {frames} frames a method, S1 at 16 places in turns");
    println!(
        "| method | map, p50 | p99 | last reading to disk, p50 | p99 | the paper's |\n|---|---|---|---|---|---|"
    );
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()?;
    for (name, method, paper) in methods {
        stage.configure(&SIMULATED.replace(METHOD, &method))?;
        let [map, disk] = runtime.block_on(times(&stage, frames))?;
        let paper = match paper {
            "" => "-".to_owned(),
            ms => format!("{ms} ms"),
        };
        println!(
            "| {name} | {:.3} ms | {:.3} ms | {:.2} ms | {:.2} ms | {paper} |",
            at(&map, 0.5),
            at(&map, 0.99),
            at(&disk, 0.5),
            at(&disk, 0.99)
        );
    }
    daemon.stop()?;
    Ok(())
}

/// Times of the map alone, and until it is on disk: ms, sorted.
async fn times(stage: &Stage, frames: usize) -> Result<[Vec<f64>; 2], Failure> {
    let (connection, _) = dbus::connect(Some(&Address::Unix(stage.peer_path()))).await?;
    let manager = Manager1Proxy::new(&connection).await?;
    manager.reload().await?;
    let hand = Simulation1Proxy::new(&connection).await?;
    let path = manager
        .start_session(&Options::new().with("step", true))
        .await?;
    let session = Session1Proxy::new(&connection, path).await?;
    let places = phantom::paper::test1_positions();
    let mut found = [Vec::new(), Vec::new()];
    for k in 0..frames + UNCOUNTED {
        let [x, y] = places[k % places.len()].map(|mm| mm * 1e-3);
        hand.press("disc", x, y, 0.01, 0.5).await?;
        let sequence = session.step(1).await?;
        let map = session.latest_map().await?;
        if map.sequence != sequence {
            return Err(format!(
                "frame {sequence} has no map: {}",
                session.last_error().await?
            )
            .into());
        }
        if k < UNCOUNTED {
            continue;
        }
        let times = [map.more.reconstruction_s, map.more.durable_s];
        for (list, time) in found.iter_mut().zip(times) {
            list.push(1e3 * time.ok_or("the daemon says no times")?);
        }
    }
    hand.release().await?;
    session.stop().await?;
    for list in &mut found {
        list.sort_by(f64::total_cmp);
    }
    Ok(found)
}

/// The quantile of sorted values.
fn at(sorted: &[f64], part: f64) -> f64 {
    let place = (part * sorted.len() as f64).ceil() as usize;
    sorted
        .get(place.saturating_sub(1))
        .or(sorted.last())
        .copied()
        .unwrap_or(f64::NAN)
}
