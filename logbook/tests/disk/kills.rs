//! A process that writes a session is killed at random times and restarted (20 times, or `TACTUS_KILLS`). All
//! acknowledged frames are on disk, in addition at most the group in progress, and the session continues.
//!
//! The killed process is a second run of the test itself.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use crate::example_frames::taken::{at, taken};
use logbook::{RESUMED, SessionHeader, SessionReader, SessionWriter, Storage};
use survey::{Baseline, Frame, Protocol, Reading, Volts};

/// Frames after which a new session is begun, so that checking stays quick.
const LONG: u64 = 1500;
/// Ends a hung test.
const DEADLINE: Duration = Duration::from_secs(120);

fn protocol() -> Protocol {
    Protocol::sheffield(12).unwrap()
}

fn frame(number: u64) -> Frame {
    let readings = (0..protocol().len() as u64)
        .map(|k| match (number + k) % 61 {
            7 => Reading::Overload,
            noise => Reading::Ok(Volts((7919 * k + noise) as f64 / 1e7)),
        })
        .collect();
    Frame {
        monotonic: Duration::from_millis(500 * number),
        duration: Duration::from_millis(400),
        ..taken(&protocol(), number, number as i64, readings)
    }
}

fn baseline() -> Baseline {
    Baseline::from_frames("b", &(1..4).map(frame).collect::<Vec<_>>()).unwrap()
}

struct Dice(u64);

impl Dice {
    fn throw(&mut self, sides: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % sides
    }
}

/// Name of the test, and the environment variables that make a run of it the writer.
const TEST: &str = "kills::a_killed_writer_loses_no_acknowledged_frame";
const FOLDER: &str = "TACTUS_TEST_WRITES_TO";
const SEED: &str = "TACTUS_TEST_SEED";

/// Writes until it is killed. Prints the last frame handed over (`> 7`) and acknowledged (`= 7`) on standard error,
/// because the test harness prints nothing there.
fn write(folder: &Path, seed: u64) {
    let mut dice = Dice(seed | 1);
    // A small journal is merged every few frames, so that some kills interrupt the merge.
    let storage = Storage {
        journal_pages: Some(16),
        ..Storage::default()
    };
    let say = |sign: char, number: u64| {
        let mut output = std::io::stderr();
        writeln!(output, "{sign} {number}").unwrap();
        output.flush().unwrap();
    };
    let mut writer = match logbook::interrupted(folder).unwrap().first() {
        Some(session) => {
            let (mut writer, resumed) = SessionWriter::resume_with(&session.path, storage).unwrap();
            writer
                .event(at(resumed.acknowledged as i64), RESUMED, "killed")
                .unwrap();
            writer
        }
        None => {
            // A session killed during its creation is empty, and its name is not used again.
            let id = format!("m{}", std::fs::read_dir(folder).unwrap().count());
            let header = SessionHeader::new(id, at(0), protocol());
            SessionWriter::create_with(folder, &header, storage).unwrap()
        }
    };
    if SessionReader::open(writer.path())
        .unwrap()
        .baseline()
        .unwrap()
        .is_none()
    {
        writer.baseline(&baseline()).unwrap();
    }
    say('=', writer.acknowledged());
    loop {
        let count = [1, 1, 1, 7, 40][dice.throw(5) as usize];
        let first = writer.acknowledged() + 1;
        let frames: Vec<Frame> = (first..first + count).map(frame).collect();
        say('>', first + count - 1);
        let kept = writer.append_all(frames.iter().map(|frame| (frame, None)));
        say('=', kept.unwrap());
        match dice.throw(30) {
            0 => drop(writer.roll(at(first as i64)).unwrap()),
            1 => writer.event(at(first as i64), "test", "an event").unwrap(),
            _ => {}
        }
    }
}

/// Runs the writer for a while and kills it; returns the last frame handed over and the last one acknowledged.
fn killed(folder: &Path, dice: &mut Dice) -> (u64, u64) {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", TEST, "--nocapture"])
        .env(FOLDER, folder)
        .env(SEED, dice.throw(u64::MAX).to_string())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let output = BufReader::new(child.stderr.take().unwrap());
    let (lines, reported) = mpsc::channel();
    let reading = std::thread::spawn(move || {
        for line in output.lines() {
            // a read error ends the output
            let Ok(line) = line else { return };
            if lines.send(line).is_err() {
                return;
            }
        }
    });
    // One in four is killed at its start, the others in the middle of writing.
    let wanted = match dice.throw(4) {
        0 => 0,
        _ => 1 + dice.throw(60),
    };
    let moment = Duration::from_micros(dice.throw(12_000));
    let mut received = Vec::new();
    let begun = Instant::now();
    while (received.len() as u64) < wanted {
        let line = reported.recv_timeout(DEADLINE);
        received.push(line.expect("the writer writes until it is killed"));
    }
    while begun.elapsed() < moment {
        std::hint::spin_loop();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    reading.join().unwrap();
    received.extend(reported.try_iter());
    let (mut handed, mut kept) = (0, 0);
    let count = received.len();
    for (at, line) in received.into_iter().enumerate() {
        let parsed = line.split_once(' ');
        match parsed.map(|(mark, number)| (mark, number.parse())) {
            Some((">", Ok(number))) => handed = number,
            Some(("=", Ok(number))) => kept = number,
            // a kill can cut the last line, even before its number
            _ => assert_eq!(at + 1, count, "{line}"),
        }
    }
    (handed, kept)
}

fn held(folder: &Path) -> BTreeMap<u64, Frame> {
    let mut frames = BTreeMap::new();
    for part in logbook::list(folder).unwrap().sessions {
        let session = SessionReader::open(&part.path).unwrap();
        for record in session.frames() {
            let frame = record.unwrap().frame;
            assert!(frames.insert(frame.sequence, frame).is_none());
        }
        session.events().unwrap();
        if let Some(kept) = session.baseline().unwrap() {
            assert_eq!(kept, baseline());
        }
    }
    frames
}

#[test]
fn a_killed_writer_loses_no_acknowledged_frame() {
    if let Some(folder) = std::env::var_os(FOLDER) {
        let seed = std::env::var(SEED).unwrap().parse().unwrap();
        return write(Path::new(&folder), seed);
    }
    let kills: u64 = std::env::var("TACTUS_KILLS")
        .ok()
        .and_then(|kills| kills.parse().ok())
        .unwrap_or(20);
    let mut dice = Dice(0x5eed);
    let mut folder = tempfile::tempdir().unwrap();
    let (mut before, mut all, mut parts, mut under_way) = (0, 0, 0, 0);
    for kill in 0..kills {
        let (handed, kept) = killed(folder.path(), &mut dice);
        // A writer that was killed before its first message has changed nothing.
        let kept = kept.max(before);
        let frames = held(folder.path());
        let count = frames.len() as u64;
        assert!(
            count == kept || count == handed,
            "kill {kill}: {count} frames, {kept} acknowledged, {handed} handed over"
        );
        for (number, found) in (1..).zip(frames.values()) {
            assert_eq!(*found, frame(number), "kill {kill}");
        }
        under_way += u64::from(count > kept);
        before = count;
        if count > LONG {
            parts += std::fs::read_dir(folder.path())
                .unwrap()
                .filter(|entry| {
                    let path = entry.as_ref().unwrap().path();
                    path.extension().is_some_and(|end| end == "tactus")
                })
                .count();
            all += count;
            before = 0;
            folder = tempfile::tempdir().unwrap();
        }
    }
    all += before;
    println!(
        "{kills} kills, {all} frames in {parts} parts of finished sessions; {under_way} times the frames under way were there, too"
    );
    assert!(all > 0, "nothing was written");
}
