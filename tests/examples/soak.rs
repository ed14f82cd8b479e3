//! Whether a daemon that runs for months stays as it is: frames of a static sheet, one after the other, while its resident
//! memory, descriptors and threads are looked at.
//!
//! ```text
//! cargo run -p tactus-tests --example soak [-- FRAMES]
//! ```
//!
//! A million frames where no number is given (an hour on two cores): an 8-electrode tank whose transfer impedance is solved
//! once, instruments that take no time. Looked at is resident memory of the process's own (RssAnon): pages of the program's
//! file come as its code is first run, and go when the machine wants them back. The first tenth is warm-up, 60,000 frames at
//! least; after it memory may grow by less than 1 MB, and descriptors and threads not beyond those that come and go with
//! whoever looks. At the end `tactus sessions verify` reads the whole record.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use tactus_tests::{DaemonProcess, SIMULATED, Stage, act_as};

type Failure = Box<dyn std::error::Error>;

const SCENE: &str = "[disc-tank]\nelectrodes = 8\n";
/// Looks at the process over a whole run.
const LOOKS: u64 = 50;
const MOST_GROWTH_KB: i64 = 1024;
/// Until then SQLite's cache of pages (2 MB) fills, at some 40 bytes a frame of a sheet that stands still.
const WARM_UP: u64 = 60_000;
/// Of the client that looks, and of threads that end when they have had nothing to do for a while.
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
    // of one look it may be chance: the last tenth together
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
