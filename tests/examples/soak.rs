//! Checks that a daemon does not grow over months: it takes frames of a static sheet without a pause, while resident
//! memory, descriptors and threads are sampled.
//!
//! ```text
//! cargo run --release -p tactus-tests --example soak [-- FRAMES]
//! ```
//!
//! A million frames by default (an hour on two cores): an 8-electrode tank whose transfer impedance is solved once, and
//! instruments that take no time. The resident memory is that of the process's own pages (RssAnon): pages of the
//! program file are loaded when its code is first run, and dropped when the system needs memory. The first tenth is
//! warm-up, at least 60,000 frames; after it memory may grow by less than 1 MB, and descriptors and threads only by
//! those of temporary clients. At the end `tactus sessions verify` reads the whole record.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use tactus_tests::{DaemonProcess, SIMULATED, Stage, act_as};

type Failure = Box<dyn std::error::Error>;

const SCENE: &str = "[disc-tank]\nelectrodes = 8\n";
/// Number of samples in a run.
const LOOKS: u64 = 50;
const MOST_GROWTH_KB: i64 = 1024;
/// Until then SQLite's page cache (2 MB) fills, at about 40 bytes per frame of a static sheet.
const WARM_UP: u64 = 60_000;
/// Descriptors and threads of the sampling client, and threads that end after an idle time.
const COMING_AND_GOING: usize = 4;

fn main() -> ExitCode {
    if let Some(code) = act_as(std::env::args_os()) {
        return code;
    }
    match soak() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("soak: {failure}");
            ExitCode::FAILURE
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct Look {
    frames: u64,
    resident_kb: i64,
    descriptors: usize,
    threads: usize,
}

fn soak() -> Result<(), Failure> {
    let frames: u64 = std::env::args()
        .nth(1)
        .map_or(Ok(1_000_000), |word| word.parse())?;
    let config = SIMULATED
        .replace("[survey]\n", "[survey]\nelectrodes = 8\n")
        .replace(
            "preset = \"paper-sheet\"",
            "preset = \"disc-tank\"\n[geometry.disc-tank]\nelectrodes = 8",
        );
    let stage = Stage::with_program(&config, std::env::current_exe()?)?;
    std::fs::write(stage.path().join("scene.toml"), SCENE)?;
    let daemon = stage.start_daemon()?;
    let ask = |args: &[&str]| -> Result<Vec<serde_json::Value>, Failure> {
        Ok(stage.tactus(args)?.succeeded()?.json())
    };
    ask(&["baseline", "record", "--frames", "2", "--json"])?;
    ask(&["start", "--json"])?;
    let began = Instant::now();
    let (mut looks, mut due): (Vec<Look>, u64) = (Vec::new(), frames / LOOKS);
    while looks.last().is_none_or(|last| last.frames < frames) {
        std::thread::sleep(Duration::from_millis(500));
        let durable = &ask(&["status", "--json"])?[0]["session"]["frames_durable"];
        let durable = durable.as_u64().ok_or("the session has ended")?;
        if durable >= due {
            due = durable + frames / LOOKS;
            let look = look(&daemon, durable)?;
            println!(
                "{} frames, {} kB resident, {} descriptors, {} threads, {:.0} s",
                look.frames,
                look.resident_kb,
                look.descriptors,
                look.threads,
                began.elapsed().as_secs_f64()
            );
            looks.push(look);
        }
    }
    ask(&["stop", "--json"])?;
    daemon.stop()?;
    stage
        .tactus(&["sessions", "verify", "--all"])?
        .succeeded()?;
    println!("the record is whole, and no frame is missing");
    let mut warm = looks
        .iter()
        .filter(|look| look.frames > WARM_UP.max(frames / 10));
    let first = *warm.next().ok_or("too few looks")?;
    // a single sample may be an outlier: the last tenth together
    let last = &looks[looks.len() - looks.len() / 10..];
    let resident = last.iter().map(|look| look.resident_kb).min().unwrap_or(0);
    let growth = resident - first.resident_kb;
    println!("after warm-up: {growth:+} kB resident");
    let least = |of: fn(&Look) -> usize| last.iter().map(of).min().unwrap_or(0);
    let (descriptors, threads) = (least(|look| look.descriptors), least(|look| look.threads));
    match (
        growth < MOST_GROWTH_KB,
        descriptors <= first.descriptors + COMING_AND_GOING,
        threads <= first.threads + COMING_AND_GOING,
    ) {
        (true, true, true) => Ok(()),
        (false, ..) => Err(format!("memory grew by {growth} kB").into()),
        (_, false, _) => Err(format!("{descriptors} descriptors are open at the end").into()),
        (.., false) => Err(format!("{threads} threads run at the end").into()),
    }
}

fn look(daemon: &DaemonProcess, frames: u64) -> Result<Look, Failure> {
    let process = PathBuf::from(format!("/proc/{}", daemon.id()));
    let status = std::fs::read_to_string(process.join("status"))?;
    let resident = status
        .lines()
        .find_map(|line| line.strip_prefix("RssAnon:"))
        .and_then(|line| line.split_whitespace().next())
        .ok_or("no resident memory in its status")?;
    let count = |what: &str| -> Result<usize, Failure> {
        Ok(std::fs::read_dir(process.join(what))?.count())
    };
    Ok(Look {
        frames,
        resident_kb: resident.parse()?,
        descriptors: count("fd")?,
        threads: count("task")?,
    })
}
