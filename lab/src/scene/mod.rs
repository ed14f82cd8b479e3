//! `tactus-lab scene`: explains, checks, runs and lists scenes.

mod explain;
mod record;
mod run;

use std::time::Duration;

use phantom::{Phantom, Repeat, Scan, Scene};
use survey::{Amps, Bounds, LONGEST_S, Volts};

use crate::args::{SceneCommand, SessionOptions};
use crate::output::print_line;
use studies::Failure;

pub(crate) fn scene(command: &SceneCommand) -> Result<(), Failure> {
    match command {
        SceneCommand::Explain(options) => explain::explain(options),
        SceneCommand::Check { scenes } => check(scenes),
        SceneCommand::Run(options) => run::run(options),
        SceneCommand::List { json } => {
            list(*json);
            Ok(())
        }
    }
}

fn open(name: &str) -> Result<Scene, Failure> {
    Scene::open(name).map_err(|fault| Failure::because(fault.to_string()))
}

/// Reads and starts each scene; reports all errors, not only the first.
fn check(scenes: &[String]) -> Result<(), Failure> {
    let mut wrong = 0;
    for name in scenes {
        let checked = open(name).and_then(|scene| {
            let effects: Vec<&str> = scene.effects.names().collect();
            let again =
                |repeat: Option<Repeat>| repeat.map_or(1, |repeat| u64::from(repeat.times()));
            let loads: u64 = scene.loads.iter().map(|load| again(load.repeat)).sum();
            let faults: u64 = scene.faults.iter().map(|fault| again(fault.repeat)).sum();
            Phantom::new(scene)
                .and_then(|mut phantom| phantom.transfer_impedance(Duration::ZERO).map(|_| ()))
                .map_err(|fault| Failure::of(name, &fault))?;
            let effects = match &effects[..] {
                [] => "no effects".to_owned(),
                some => some.join(", "),
            };
            print_line!("{name}: {loads} loads, {faults} faults, {effects}");
            Ok(())
        });
        if let Err(fault) = checked {
            let text = fault.to_string();
            eprintln!("tactus-lab: {}", survey::printable_lines(&text));
            wrong += 1;
        }
    }
    match wrong {
        0 => Ok(()),
        _ => Err(Failure::because(format!(
            "{wrong} of {} scenes cannot be loaded",
            scenes.len()
        ))),
    }
}

fn list(json: bool) {
    for (name, text) in Scene::shipped() {
        let what = Scene::what(text);
        if json {
            print_line!("{}", serde_json::json!({ "name": name, "what": what }));
        } else {
            print_line!("{name:28} {what}");
        }
    }
}

/// The scan of a session with these settings.
fn scan(scene: &Scene, options: &SessionOptions) -> Result<Scan, Failure> {
    for (key, value, most) in [
        ("--current-ua", options.current_ua, 105_000.0),
        ("--nplc", options.nplc, 200.0),
        ("--range-v", options.range_v, 300.0),
        ("--line-hz", options.line_hz, 440.0),
    ] {
        if !(value > 0.0 && value <= most) {
            return Err(Failure::usage(format!(
                "{key} is {value}, it must be more than 0 and at most {most}"
            )));
        }
    }
    let seconds = |key: &str, value: f64| {
        let bounds = Bounds::Within(0.0, LONGEST_S);
        let checked = bounds.check(value).map(survey::duration);
        checked.map_err(|_| Failure::usage(format!("{key} is {value}, it must be {bounds}")))
    };
    let usual = Scan::usual(scene.sheet.electrodes())
        .map_err(|fault| Failure::of("a protocol for these electrodes cannot be made", &fault))?;
    let current = Amps(options.current_ua * 1e-6);
    let ranges = keithley_6221::RANGES.map(|range| range.full_scale);
    let holds = ranges.into_iter().find(|range| *range >= current.abs());
    let mut scan = Scan {
        current,
        source_range: holds.unwrap_or(ranges[ranges.len() - 1]),
        nplc: options.nplc,
        resolution: keysight_34980a::resolution(options.nplc),
        range: Volts(options.range_v),
        line_hz: options.line_hz,
        settle: seconds("--settle-ms", options.settle_ms)? / 1000,
        every: seconds("--every", options.every_s.unwrap_or(0.0))?,
        ..usual
    };
    scan.frames = match options.frames {
        Some(0) => return Err(Failure::usage("--frames 0: a scene needs a frame")),
        Some(frames) => frames,
        None => {
            let ends = scene
                .loads
                .iter()
                .map(|timed| timed.end().unwrap_or(timed.from));
            let last = ends.max().unwrap_or_default();
            let step = scan.begin(1).as_secs_f64();
            ((last.as_secs_f64() / step).ceil() as usize + 1).max(2)
        }
    };
    let (frames, step_s) = (scan.frames, scan.begin(1).as_secs_f64());
    let lasts_s = frames as f64 * step_s;
    if lasts_s > LONGEST_S {
        return Err(Failure::usage(format!(
            "{frames} frames, {step_s:.1} s apart, last {lasts_s:.1e} s, more than a century: take fewer --frames or a shorter --every"
        )));
    }
    Ok(scan)
}

/// A scan in words.
fn in_words(scan: &Scan) -> String {
    format!(
        "{} electrodes, {} readings, {} at {} PLC on {}; {} frames of {:.1} s, {:.1} s apart",
        scan.protocol.electrodes(),
        scan.protocol.len(),
        scan.current,
        scan.nplc,
        scan.range,
        scan.frames,
        scan.frame_time().as_secs_f64(),
        scan.begin(1).as_secs_f64(),
    )
}
