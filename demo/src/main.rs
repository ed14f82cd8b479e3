//! `cargo demo`: the main use case, complete, on the simulated rig.
//!
//! Runs the real `tactusd` and `tactus`, each in a process of its own, connected by the peer socket: records a
//! baseline, presses the 16 positions of the paper's Test #1 one after another, reads every frame as SCPI text, records
//! it, and reconstructs it by the one-step method and by the two shipped RBF networks. This binary contains all the
//! programs and starts itself as each of them.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use dbus::{Address, Manager1Proxy, Session1Proxy, Simulation1Proxy};
use demo::{Stage, act_as};
use eit::{Mesh, Preset, Reconstructor};
use render::{Grid, Scale, Scales, Sheet, Style, TerminalColour, TerminalStyle, TruePlace};
use survey::{Baseline, Frame, Map};

type Failure = Box<dyn std::error::Error>;

/// The paper's Test #1: a 10 mm disc that takes half of the conductance (our interpretation, see the decisions).
const DIAMETER_M: f64 = 0.010;
const LOSS: f64 = 0.5;
/// One voltmeter range for all readings and 2 uV of noise.
const SCENE: &str = demo::TWO_MICROVOLTS;
/// Number of frames in the baseline.
const BASELINE_FRAMES: &str = "10";

fn main() -> ExitCode {
    if let Some(code) = act_as(std::env::args_os()) {
        return code;
    }
    match demo() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("\ndemo: {failure}");
            let mut cause = failure.source();
            while let Some(deeper) = cause {
                eprintln!("  because: {deeper}");
                cause = deeper.source();
            }
            ExitCode::FAILURE
        }
    }
}

/// One press: its position, and the position found by each method.
struct Press {
    truth: [f64; 2],
    found: Vec<Option<[f64; 2]>>,
}

/// A method with its maps of all presses.
struct Method {
    name: String,
    maps: Vec<Map>,
    milliseconds: f64,
}

fn demo() -> Result<(), Failure> {
    let begun = Instant::now();
    let out = out_folder()?;
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    println!(
        "Tactus demo, about 5 s: presses a SIMULATED sheet at 16 places, records every frame, shows the maps and their errors.\n\
         The paper's Test #1. A research instrument, not a medical device.\n"
    );

    say(
        begun,
        "starting tactusd on the simulated rig (instant time, 2 uV of voltmeter noise)",
    );
    let stage = Stage::new(demo::SIMULATED)?;
    std::fs::write(stage.path().join("scene.toml"), SCENE)?;
    let daemon = stage.start_daemon()?;

    say(begun, "tactus plan");
    let plan = stage.tactus(&["plan"])?.succeeded()?;
    indent(&plan.stdout);

    say(
        begun,
        &format!("tactus baseline record --frames {BASELINE_FRAMES}"),
    );
    let baseline = stage
        .tactus(&["baseline", "record", "--frames", BASELINE_FRAMES])?
        .succeeded()?;
    indent(&baseline.stdout);

    say(begun, "tactus start --step --count 16");
    let started = stage
        .tactus(&[
            "start",
            "--step",
            "--count",
            "16",
            "--note",
            "demo: Test #1, S1 at 16 places",
            "--json",
        ])?
        .succeeded()?;
    let session = started
        .json()
        .first()
        .and_then(|line| line["session"].as_str().map(str::to_owned));
    let session = session.ok_or("tactus start did not name the session")?;

    let mesh = Arc::new(Preset::default().mesh()?);
    let sheet = sheet_of(&mesh);
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()?;
    let truths = phantom::paper::test1_positions().map(|place| place.map(|mm| mm * 1e-3));
    let live = runtime.block_on(press_all(&stage, &session, &truths, &sheet, begun))?;

    say(begun, "tactus sessions");
    let sessions = stage.tactus(&["sessions"])?.succeeded()?;
    indent(&sessions.stdout);

    say(
        begun,
        "stopping tactusd: the source is off and verified, the record closed",
    );
    daemon.stop()?;

    let record = logbook::SessionReader::open(&logbook::find(stage.state_path(), &session)?)?;
    let frames: Vec<Frame> = record
        .frames()
        .map(|record| record.map(|record| record.frame))
        .collect::<Result<_, _>>()?;
    let against = record.baseline()?.ok_or("the session has no baseline")?;
    let mut methods = vec![Method {
        name: "one-step (live)".into(),
        maps: live,
        milliseconds: f64::NAN,
    }];
    for name in ["rbf-matched", "rbf-paper"] {
        say(
            begun,
            &format!("the same frames through models/{name}.safetensors"),
        );
        let model = eit::load_reconstructor(&root.join(format!("models/{name}.safetensors")))?;
        methods.push(recompute(name, model.as_ref(), &against, &frames)?);
    }
    let presses = compare(&mesh, &truths, &methods);
    report(&methods, &presses);

    say(begun, "tactus export: CSV of the voltages");
    let csv = out.join("frames.csv");
    let exported = stage
        .tactus(&[
            "export",
            &session,
            "--format",
            "csv",
            "--force",
            "--out",
            &csv.display().to_string(),
        ])?
        .succeeded()?;
    indent(&exported.stdout);
    let file = logbook::find(stage.state_path(), &session)?;
    let kept = out.join(file.file_name().ok_or("a session file has a name")?);
    std::fs::copy(&file, &kept)?;
    let mut pictures = Vec::new();
    for (index, method) in methods.iter().enumerate() {
        let name = if index == 0 {
            "maps.png".to_owned()
        } else {
            format!("maps-{}.png", method.name)
        };
        let path = out.join(name);
        std::fs::write(&path, grid(&sheet, method, &presses, index)?)?;
        pictures.push(path);
    }

    println!("\nWritten:");
    println!(
        "  {:<48} the session: voltages, baseline, settings, instruments",
        kept.display()
    );
    println!("  {:<48} the voltages as CSV", csv.display());
    for (path, method) in pictures.iter().zip(&methods) {
        println!("  {:<48} 16 maps, {}", path.display(), method.name);
    }
    println!("\nDone in {:.1} s.", begun.elapsed().as_secs_f64());
    Ok(())
}

/// Presses one position after another; the daemon takes a frame at each.
async fn press_all(
    stage: &Stage,
    session: &str,
    truths: &[[f64; 2]],
    sheet: &Sheet,
    begun: Instant,
) -> Result<Vec<Map>, Failure> {
    let (connection, _) = dbus::connect(Some(&Address::Unix(stage.peer_path()))).await?;
    let hand = Simulation1Proxy::new(&connection).await?;
    let manager = Manager1Proxy::new(&connection).await?;
    let recording = Session1Proxy::new(&connection, dbus::session_path(session)?).await?;
    let geometry = manager.geometry().await?;
    let mut maps = Vec::new();
    for (index, truth) in truths.iter().enumerate() {
        hand.press("disc", truth[0], truth[1], DIAMETER_M, LOSS)
            .await?;
        recording.step(1).await?;
        let latest = recording.latest_map().await?;
        if latest.mesh_hash != geometry.mesh_hash {
            return Err("the daemon's map is of another mesh than its geometry".into());
        }
        let map = Map::relative(latest.mesh_hash, latest.values, latest.method);
        let found = latest
            .more
            .found_x_m
            .zip(latest.more.found_y_m)
            .map(|(x, y)| [x, y]);
        say(
            begun,
            &format!("press {:>2}/16 {}", index + 1, places(*truth, found)),
        );
        if std::io::stdout().is_terminal() || index % 5 == 0 {
            let style = Style {
                title: format!("press {}", index + 1),
                simulated: true,
                true_position: Some(TruePlace {
                    centre: *truth,
                    radius: DIAMETER_M / 2.0,
                }),
                found,
                ..Style::default()
            };
            let style = TerminalStyle {
                width: 60,
                height: None,
                colour: colour(),
                style,
            };
            indent(&render::terminal(sheet, &map, &style)?);
        }
        maps.push(map);
    }
    hand.release().await?;
    Ok(maps)
}

fn recompute(
    name: &str,
    model: &dyn Reconstructor,
    against: &Baseline,
    frames: &[Frame],
) -> Result<Method, Failure> {
    let begun = Instant::now();
    let maps: Vec<Map> = frames
        .iter()
        .map(|frame| model.reconstruct(&against.readings, &frame.readings))
        .collect::<Result<_, _>>()?;
    let milliseconds = begun.elapsed().as_secs_f64() * 1e3 / frames.len() as f64;
    Ok(Method {
        name: name.to_owned(),
        maps,
        milliseconds,
    })
}

fn compare(mesh: &Mesh, truths: &[[f64; 2]], methods: &[Method]) -> Vec<Press> {
    let centroids = mesh.region_centroids();
    let areas = mesh.region_areas();
    truths
        .iter()
        .enumerate()
        .map(|(index, truth)| Press {
            truth: *truth,
            found: methods
                .iter()
                .map(|method| method.maps[index].found(&centroids, &areas))
                .collect(),
        })
        .collect()
}

/// Prints the table, with the mean and the worst error.
fn report(methods: &[Method], presses: &[Press]) {
    println!(
        "\nDistance from the true place, mm (a 10 mm disc, half its conductance lost, 2 uV of noise)\n"
    );
    print!("  {:>14}", "true place");
    for method in methods {
        print!("  {:>16}", method.name);
    }
    println!();
    for press in presses {
        print!(
            "  {:>6.1} {:>7.1}",
            press.truth[0] * 1e3,
            press.truth[1] * 1e3
        );
        for found in &press.found {
            match found {
                Some(found) => print!("  {:>16.2}", distance_mm(press.truth, *found)),
                None => print!("  {:>16}", "no loss found"),
            }
        }
        println!();
    }
    let column = |index: usize| -> Vec<f64> {
        presses
            .iter()
            .map(|press| {
                press.found[index].map_or(f64::INFINITY, |found| distance_mm(press.truth, found))
            })
            .collect()
    };
    let row = |name: &str, value: &dyn Fn(usize) -> f64| {
        print!("  {name:>14}");
        for index in 0..methods.len() {
            let value = value(index);
            if value.is_nan() {
                print!("  {:>16}", "-");
            } else {
                print!("  {value:>16.2}");
            }
        }
        println!();
    };
    row("mean", &|index| {
        column(index).iter().sum::<f64>() / presses.len() as f64
    });
    row("worst", &|index| {
        column(index).into_iter().fold(0.0, f64::max)
    });
    row("ms a frame", &|index| methods[index].milliseconds);
    println!(
        "\n  The RBF networks are the paper's: 100 centres, trained on polygons of up to 70 mm. They are too coarse for a\n  \
         10 mm disc, and the paper's jitter (rbf-paper) is larger than the 20 to 140 uV by which such a press changes\n  \
         the readings. The linear one-step method locates these presses."
    );
}

fn grid(
    sheet: &Sheet,
    method: &Method,
    presses: &[Press],
    index: usize,
) -> Result<Vec<u8>, Failure> {
    let panels: Vec<(Map, Style)> = method
        .maps
        .iter()
        .zip(presses)
        .enumerate()
        .map(|(number, (map, press))| {
            let style = Style {
                title: match press.found[index] {
                    Some(found) => format!(
                        "{}: {:.1} mm off",
                        number + 1,
                        distance_mm(press.truth, found)
                    ),
                    None => format!("{}: no loss found", number + 1),
                },
                scale: Scale::Own,
                simulated: true,
                true_position: Some(TruePlace {
                    centre: press.truth,
                    radius: DIAMETER_M / 2.0,
                }),
                found: press.found[index],
                ..Style::default()
            };
            (map.clone(), style)
        })
        .collect();
    Ok(render::png_grid(
        sheet,
        &panels,
        &Grid {
            columns: 4,
            title: &format!("Test #1, S1 at 16 places: {}", method.name),
            scales: Scales::Common,
        },
    )?)
}

fn sheet_of(mesh: &Mesh) -> Sheet {
    let corner = |node: usize| mesh.nodes()[node];
    Sheet {
        triangles: mesh
            .region()
            .iter()
            .map(|t| mesh.triangles()[*t].map(corner))
            .collect(),
        outline: mesh.outline(),
        electrodes: mesh.electrode_centres(),
    }
}

fn distance_mm(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1]) * 1e3
}

fn places(truth: [f64; 2], found: Option<[f64; 2]>) -> String {
    let truth_text = format!("at ({:.1}, {:.1}) mm", truth[0] * 1e3, truth[1] * 1e3);
    match found {
        Some(found) => format!(
            "{truth_text}, found ({:.1}, {:.1}), {:.1} mm off",
            found[0] * 1e3,
            found[1] * 1e3,
            distance_mm(truth, found)
        ),
        None => format!("{truth_text}, no loss found"),
    }
}

/// `--out DIR`, by default `target/demo` in the workspace.
fn out_folder() -> Result<PathBuf, Failure> {
    let mut args = std::env::args_os().skip(1);
    let folder = match (args.next(), args.next()) {
        (None, _) => PathBuf::from("target/demo"),
        (Some(flag), Some(folder)) if flag == "--out" => PathBuf::from(folder),
        _ => return Err("usage: cargo demo [--out DIR]".into()),
    };
    std::fs::create_dir_all(&folder)?;
    Ok(folder)
}

/// True colour if the terminal advertises it, 256 colours on another terminal, ASCII in a file.
fn colour() -> TerminalColour {
    if !std::io::stdout().is_terminal() || std::env::var_os("NO_COLOR").is_some() {
        TerminalColour::Plain
    } else if std::env::var("COLORTERM")
        .is_ok_and(|value| value.contains("truecolor") || value.contains("24bit"))
    {
        TerminalColour::TrueColour
    } else {
        TerminalColour::Ansi256
    }
}

fn say(begun: Instant, what: &str) {
    println!("[{:5.1} s] {what}", begun.elapsed().as_secs_f64());
    let _ = std::io::stdout().flush();
}

fn indent(text: &str) {
    for line in text.lines() {
        println!("          {line}");
    }
}
