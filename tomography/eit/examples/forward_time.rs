//! Time of the forward model and of the calculations that use it, at the paper's size:
//! `cargo run --release -p tactus-eit --example forward_time`.
//!
//! Minimum and median wall time of each; on a busy machine the minimum is the meaningful one. With `-- --python FILE`
//! (a Python that has scipy) the reference `scipy_reference.py` runs as well.

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use eit::{Case, Forward, Hyper, OneStep, OneStepOptions, PaperSheet, Parameters, Workspace};
use rayon::prelude::*;
use survey::{Dipole, Protocol};

fn show(what: &str, rounds: usize, mut work: impl FnMut(usize)) -> f64 {
    let before = processor();
    let mut times: Vec<f64> = (0..rounds)
        .map(|round| {
            let start = Instant::now();
            work(round);
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let each = 1e3 * (processor() - before) / rounds as f64;
    println!(
        "{what:44} {:9.3} {:9.3} {each:9.2}",
        times[0],
        times[rounds / 2]
    );
    times[0]
}

/// Solves 15,000 cases like those of Algorithm 1 on all cores: wall time and processor time, s.
fn cases(workspace: &Workspace<'_>, sigma0: &[f64], region: &[Vec<usize>]) -> [f64; 2] {
    const CASES: usize = 1500;
    let (start, before) = (Instant::now(), processor());
    let sum: f64 = (0..CASES)
        .into_par_iter()
        .map_init(
            || workspace.clone(),
            |workspace, case| {
                let mut sigma = sigma0.to_vec();
                for &t in &region[case % region.len()] {
                    sigma[t] *= 0.3;
                }
                workspace.readings(&sigma).expect("positive")[0]
            },
        )
        .sum();
    black_box(sum);
    [start.elapsed().as_secs_f64(), processor() - before].map(|s| 15_000.0 / CASES as f64 * s)
}

/// Processor time of all threads so far, s, without other processes' share; `None` where the system does not report it.
fn processor() -> f64 {
    let ticks = || {
        let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
        let fields: Vec<&str> = stat.rsplit(')').next()?.split_whitespace().collect();
        let count = |k: usize| fields.get(k)?.parse::<f64>().ok();
        Some(count(11)? + count(12)?)
    };
    ticks().unwrap_or(f64::NAN) / 100.0
}

/// Peak resident memory so far, MiB; `None` where the system does not report it.
fn memory() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / 1024.0)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sheet = PaperSheet::default();
    let mesh = Arc::new(sheet.mesh()?);
    let quality = mesh.quality();
    println!(
        "{} nodes, {} triangles, {} in the region, smallest angle {:.1} degrees",
        quality.nodes, quality.triangles, quality.region, quality.smallest_angle
    );
    println!(
        "{:44} {:>9} {:>9} {:>9}",
        "ms", "shortest", "median", "processor"
    );
    show("mesh", 3, |_| {
        black_box(sheet.mesh().expect("the default sheet"));
    });
    let contacts = sheet.contact_ohm_m();
    show("analysis, once", 5, |_| {
        black_box(Forward::new(Arc::clone(&mesh), &contacts).expect("the default sheet"));
    });
    let forward = Forward::new(Arc::clone(&mesh), &contacts)?;
    let protocol = Protocol::sheffield(sheet.electrodes())?;
    let drives: Vec<Dipole> = protocol.drives();
    // a different conductance each time, so that nothing can be reused
    let everywhere: Vec<Vec<f64>> = (0..64)
        .map(|round| {
            (0..mesh.triangles().len())
                .map(|t| 1e-3 * (1.0 - 0.5 * ((t * (round + 3)) as f64 * 0.618).fract()))
                .collect()
        })
        .collect();
    let sigma0 = vec![1e-3; mesh.triangles().len()];
    // a disc of 30 mm somewhere
    let pressed: Vec<Vec<f64>> = (0..64)
        .map(|round| {
            let centre = [0.04 + 0.0021 * round as f64, 0.05 + 0.0013 * round as f64];
            let mut sigma = sigma0.clone();
            for &t in mesh.region() {
                let p = mesh.centroid(t);
                if (p[0] - centre[0]).hypot(p[1] - centre[1]) < 0.03 {
                    sigma[t] *= 0.4;
                }
            }
            sigma
        })
        .collect();
    let expect = "the conductances are positive";
    show("all fields, refined", 200, |round| {
        black_box(
            forward
                .solve(&everywhere[round % 64], &drives)
                .expect(expect),
        );
    });
    let mut plain = forward.workspace(&protocol)?.plain();
    show("all fields, plain", 200, |round| {
        black_box(plain.fields(&everywhere[round % 64]).expect(expect));
    });
    let mut refined = forward.workspace(&protocol)?;
    let readings_ms = show("598 readings, refined", 200, |round| {
        black_box(refined.readings(&everywhere[round % 64]).expect(expect));
    });
    show("598 readings, plain", 200, |round| {
        black_box(plain.readings(&everywhere[round % 64]).expect(expect));
    });
    let mut about = forward.workspace(&protocol)?.plain().about(&sigma0)?;
    show("the same, a disc of 30 mm about a known", 200, |round| {
        black_box(about.readings(&pressed[round % 64]).expect(expect));
    });
    let jacobian_ms = show("Jacobian, 598 x all", 10, |round| {
        black_box(
            forward
                .jacobian(&everywhere[round % 64], &protocol)
                .expect(expect),
        );
    });
    let mut kept = nalgebra::DMatrix::zeros(0, 0);
    show("the same into a matrix used again", 10, |round| {
        forward
            .sensitivity_into(
                &everywhere[round % 64],
                &protocol,
                &Parameters::elements(),
                &mut kept,
            )
            .expect(expect);
    });
    let discs: Vec<Vec<usize>> = pressed
        .iter()
        .map(|sigma| (0..sigma.len()).filter(|&t| sigma[t] < 1e-3).collect())
        .collect();
    let all = cases(&forward.workspace(&protocol)?.plain(), &sigma0, &discs);
    let known = cases(
        &forward.workspace(&protocol)?.plain().about(&sigma0)?,
        &sigma0,
        &discs,
    );
    for (what, [wall, processors]) in [
        ("15,000 cases, all cores, s", all),
        ("the same, about a known conductance, s", known),
    ] {
        println!("{what:44} {wall:9.2} {:9} {processors:9.2}", "");
    }
    // the whole sheet as region: as many unknowns as triangles
    let whole = Arc::new(mesh.whole());
    let before = memory();
    show("one-step set-up, all triangles", 2, |_| {
        let options = OneStepOptions {
            hyper: Hyper::Lambda(1e-2),
            ..OneStepOptions::default()
        };
        black_box(
            OneStep::new(Arc::clone(&whole), &contacts, &sigma0, &protocol, options)
                .expect("the default sheet"),
        );
    });
    if let (Some(before), Some(after)) = (before, memory()) {
        println!(
            "memory, MiB                                  {before:9.0} before the set-up, {after:.0} at most in it"
        );
    }
    beside_scipy(&sheet, &forward, &protocol, [readings_ms, jacobian_ms])
}

fn beside_scipy(
    sheet: &PaperSheet,
    forward: &Forward,
    protocol: &Protocol,
    [readings_ms, jacobian_ms]: [f64; 2],
) -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().collect();
    let Some(python) = words.iter().position(|word| word == "--python") else {
        println!("scipy: skipped, no --python FILE was given");
        return Ok(());
    };
    let sigma0 = vec![sheet.conductance(); forward.mesh().triangles().len()];
    let case = Case {
        mesh: Arc::clone(forward.mesh()),
        contact_ohm_m: sheet.contact_ohm_m(),
        protocol: protocol.clone(),
        currents: vec![1.0; protocol.len()],
        sigma: [("homog".to_owned(), sigma0.clone())].into(),
        has_region: true,
    };
    let folder = tempfile::tempdir()?;
    case.write(folder.path(), outfile::Existing::Refuse)?;
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/scipy_reference.py");
    let output = std::process::Command::new(&words[python + 1])
        .args([script.as_ref(), folder.path()])
        .env("OMP_NUM_THREADS", "1")
        .env("OPENBLAS_NUM_THREADS", "1")
        .output()?;
    if !output.status.success() {
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        println!(
            "scipy: skipped, {}",
            message.lines().last().unwrap_or("it failed")
        );
        return Ok(());
    }
    let found: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    let number = |key: &str| found[key].as_f64().unwrap_or(f64::NAN);
    let ours = forward.readings(&sigma0, protocol)?;
    let theirs: Vec<f64> = serde_json::from_value(found["readings"].clone())?;
    let apart = ours
        .iter()
        .zip(&theirs)
        .fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
    for (what, ours, theirs) in [
        ("forward", readings_ms, number("forward_ms")),
        ("Jacobian", jacobian_ms, number("jacobian_ms")),
    ] {
        println!(
            "scipy {}, {what}: {theirs:.1} ms, {:.1} times ours",
            found["scipy"].as_str().unwrap_or("?"),
            theirs / ours
        );
    }
    println!(
        "readings apart by {:.1e} of the largest",
        apart / ours.amax()
    );
    Ok(())
}
