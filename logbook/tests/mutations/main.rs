//! A session file with one thing in it changed: either a reader returns exactly what was written, or
//! [`logbook::verify`] reports a finding. Bytes of the file and of its journal are flipped, overwritten, moved and
//! cut off; tables are changed by SQL. Checksums are never computed again: they detect damage, not forgery.

mod bytes;
mod sql;
#[path = "../example_frames/taken.rs"]
mod taken;
mod view;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use logbook::{MapRecord, RESUMED, SessionHeader, SessionWriter, Storage};
use survey::{Baseline, Frame, Protocol, Reading, Volts};
use taken::{at, taken};
use view::View;

/// Numbers of byte mutations of a closed file, and of an interrupted session's file and journal; `TACTUS_MUTATIONS` is
/// their sum (default 1,000).
fn of_bytes() -> [u64; 2] {
    let all: u64 = std::env::var("TACTUS_MUTATIONS").map_or(1000, |text| text.parse().unwrap());
    let closed = 7 * all / 10;
    [closed, all - closed]
}

const FRAMES: u64 = 64;

/// Name endings of the files of an interrupted session.
const ENDS: [&str; 3] = ["", "-wal", "-shm"];

struct Dice(u64);

impl Dice {
    fn throw(&mut self, sides: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % sides as u64) as usize
    }
}

fn protocol() -> Protocol {
    Protocol::sheffield(12).unwrap()
}

/// Readings in steps of 0.1 uV. A load after frame 33 makes the writer store a new reference.
fn frame(number: u64) -> Frame {
    let load = u64::from(number > 33) * 12_345;
    let readings = (0..protocol().len() as u64)
        .map(|k| {
            let mut noise = (number * 64 + k + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            noise ^= noise >> 29;
            let counts = 7919 * k * k + load * (k % 17) + (noise & 15);
            match (number + k) % 97 {
                7 => Reading::Overload,
                _ => Reading::Ok(Volts(format!("{counts}e-7").parse().unwrap())),
            }
        })
        .collect();
    let mut frame = taken(&protocol(), number, number as i64, readings);
    if number > 50 {
        frame.settings.wiring = "swapped".into();
    }
    frame
}

fn map(number: u64) -> MapRecord {
    MapRecord {
        hash: format!("{:064x}", number.wrapping_mul(0x9e37_79b9_7f4a_7c15)),
        sum: (!number.is_multiple_of(5)).then_some(number as f32),
        method: if number > 60 {
            "gauss-newton"
        } else {
            "one-step"
        }
        .into(),
        model_hash: Some("ab12".into()),
        build: "0.1.0".into(),
        cpu: "avx2".into(),
    }
}

fn written(dir: &Path) -> SessionWriter {
    let header = SessionHeader {
        note: "a note".into(),
        asked: "{\"every_s\":1.0}".into(),
        config_toml: "# a configuration\n".repeat(20),
        ..SessionHeader::new("m1", at(0), protocol())
    };
    // few pages, so that a part of the session is merged and the rest is in the journal
    let storage = Storage {
        journal_pages: Some(24),
        ..Storage::default()
    };
    let mut writer = SessionWriter::create_with(dir, &header, storage).unwrap();
    let unloaded: Vec<Frame> = (1..=4).map(frame).collect();
    writer
        .baseline(&Baseline::from_frames("b1", &unloaded).unwrap())
        .unwrap();
    for number in 1..=FRAMES {
        let now = (!number.is_multiple_of(3)).then(|| map(number));
        writer.append(&frame(number), now.as_ref()).unwrap();
        if number % 6 == 3 {
            writer.late_map(number, &map(number)).unwrap();
        }
        if number % 9 == 0 {
            let text = format!("what happened at {number}");
            writer.event(at(number as i64), "note", &text).unwrap();
        }
    }
    writer
        .event(at(FRAMES as i64), RESUMED, "for a test")
        .unwrap();
    writer
}

/// Files by the endings of their names.
type Files = BTreeMap<&'static str, Vec<u8>>;

fn files(path: &Path) -> Files {
    ENDS.into_iter()
        .filter_map(|end| Some((end, std::fs::read(with(path, end)).ok()?)))
        .collect()
}

fn write_files(path: &Path, files: &Files) {
    for end in ENDS.into_iter().chain(["-journal"]) {
        let _ = std::fs::remove_file(with(path, end));
    }
    for (end, bytes) in files {
        std::fs::write(with(path, end), bytes).unwrap();
    }
}

fn with(path: &Path, end: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(end);
    name.into()
}

/// A closed session, and one whose writer was killed.
fn originals() -> [Files; 2] {
    let closed = scratch();
    let writer = written(closed.path());
    let path = writer.path().to_owned();
    let killed = files(&path);
    writer.close(at(100), "done").unwrap();
    [files(&path), killed]
}

fn scratch() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm")
        .or_else(|_| tempfile::tempdir())
        .unwrap()
}

#[derive(Default)]
struct RowCounts {
    mutations: usize,
    same: usize,
    reported: usize,
    /// Mutations of an interrupted session that look like an earlier kill: the remaining frames could be all that was
    /// written.
    shorter: usize,
    missed: Vec<String>,
}

impl RowCounts {
    fn judge(&mut self, path: &Path, original: &View, what: &str) {
        self.mutations += 1;
        let view = View::of(path);
        if view == *original {
            self.same += 1;
            return;
        }
        let verified = logbook::verify(path, |_| {});
        if verified.is_ok_and(|verified| !verified.findings.is_empty()) {
            self.reported += 1;
        } else if original.closed.is_none() && view.is_beginning_of(original) {
            self.shorter += 1;
        } else {
            self.missed.push(what.to_owned());
        }
    }

    fn conclude(&self, of: &str) {
        println!(
            "{of}: {} mutations: {} change nothing, {} reported, {} may have been all, {} missed",
            self.mutations,
            self.same,
            self.reported,
            self.shorter,
            self.missed.len()
        );
    }
}

/// Applies `count` byte mutations and all SQL mutations to the files of a session; no mutation may be missed.
fn none_is_missed(files: &Files, of: &str, count: u64) {
    let folder = scratch();
    let path = folder.path().join("m1.tactus");
    write_files(&path, files);
    let original = View::of(&path);
    assert_eq!(original.frames.len() as u64, FRAMES);
    let findings = logbook::verify(&path, |_| {}).unwrap().findings;
    assert!(findings.is_empty(), "{findings:?}");

    let mut by_bytes = RowCounts::default();
    let mut dice = Dice(0x5eed_0001);
    for _ in 0..count {
        let mut mutated = files.clone();
        let what = bytes::mutate(&mut mutated, &mut dice);
        write_files(&path, &mutated);
        by_bytes.judge(&path, &original, &what);
    }
    by_bytes.conclude(&format!("{of}, bytes"));

    let mut by_sql = RowCounts::default();
    write_files(&path, files);
    for what in sql::mutations(&path) {
        write_files(&path, files);
        if sql::apply(&path, &what) {
            by_sql.judge(&path, &original, &what);
        }
    }
    by_sql.conclude(&format!("{of}, SQL"));
    assert!(by_sql.mutations > 400, "{}", by_sql.mutations);
    let missed: Vec<_> = [by_bytes, by_sql]
        .into_iter()
        .flat_map(|tally| tally.missed)
        .collect();
    assert!(
        missed.is_empty(),
        "{of}: {} missed:\n{}",
        missed.len(),
        missed.join("\n")
    );
}

#[test]
fn no_mutation_of_a_closed_session_goes_unreported() {
    none_is_missed(&originals()[0], "closed", of_bytes()[0]);
}

#[test]
fn no_mutation_of_an_interrupted_session_goes_unreported() {
    none_is_missed(&originals()[1], "interrupted", of_bytes()[1]);
}
