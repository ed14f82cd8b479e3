//! Power cuts, syncs that fail and disks that are full, at every point of a recording.
//!
//! One recording is made through a file layer that records all operations ([`vfs`]). Then every possible disk content
//! after each step is rebuilt ([`image`]) and opened: it contains everything acknowledged, in addition at most the
//! transaction in progress, and the session can continue. `TACTUS_CUTS=all` tests every sector of every write and
//! more seeds.

use std::collections::BTreeMap;
use std::path::Path;

use crate::example_frames::taken::{at, taken};
use crate::image::{Disk, Lost};
use crate::vfs::{self, Fault, Mark, Operation, Step};
use logbook::{LogbookError, RESUMED, SessionHeader, SessionReader, SessionWriter, Storage};
use survey::{Baseline, Frame, Protocol, Reading, Volts};

fn protocol() -> Protocol {
    Protocol::sheffield(8).unwrap()
}

/// A large frame, so that a few fill a page: random voltages, which do not compress.
fn frame(number: u64) -> Frame {
    let readings = (0..protocol().len() as u64)
        .map(|k| {
            let mut bits = (number * 64 + k + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            bits ^= bits >> 31;
            Reading::Ok(Volts(bits as f64 / u64::MAX as f64))
        })
        .collect();
    taken(&protocol(), number, number as i64, readings)
}

fn baseline() -> Baseline {
    Baseline::from_frames("b", &(1..4).map(frame).collect::<Vec<_>>()).unwrap()
}

fn header() -> SessionHeader {
    SessionHeader::new("m1", at(0), protocol())
}

/// Pages of the journal beyond which it is merged into the file: few, so that a short recording includes a merge.
const STORAGE: Storage = Storage {
    page_limit: None,
    journal_pages: Some(24),
};

/// A writer that marks, in the steps of the file layer, what has been acknowledged to it.
struct Recording<'a> {
    folder: &'a Path,
    writer: SessionWriter,
    reported: Mark,
}

impl<'a> Recording<'a> {
    fn begin(folder: &'a Path) -> Self {
        vfs::record();
        Self {
            folder,
            writer: SessionWriter::create_with(folder, &header(), STORAGE).unwrap(),
            reported: Mark::default(),
        }
    }

    fn hand(&mut self, change: impl FnOnce(&mut Mark)) {
        change(&mut self.reported);
        vfs::mark(self.folder, self.reported);
    }

    fn baseline(&mut self) {
        self.writer.baseline(&baseline()).unwrap();
        self.hand(|reported| reported.baseline = true);
    }

    fn event(&mut self) {
        self.hand(|reported| reported.events_handed += 1);
        let number = self.reported.events_handed as i64;
        self.writer
            .event(at(number), "test", &format!("event {number}"))
            .unwrap();
        self.hand(|reported| reported.events_kept += 1);
    }

    fn frames(&mut self, count: u64) -> Result<(), LogbookError> {
        self.hand(|reported| reported.handed = reported.kept + count);
        let frames: Vec<Frame> = (self.reported.kept + 1..=self.reported.handed)
            .map(frame)
            .collect();
        let kept = self
            .writer
            .append_all(frames.iter().map(|frame| (frame, None)))?;
        assert_eq!(kept, self.reported.handed);
        self.hand(|reported| reported.kept = kept);
        Ok(())
    }

    fn roll(&mut self) {
        self.writer.roll(at(self.reported.kept as i64)).unwrap();
    }
}

/// Records single frames and groups, events, a baseline, several parts, merges of the journal, and an end.
fn recording(folder: &Path, parts: u64) -> Vec<Step> {
    let mut recording = Recording::begin(folder);
    recording.event();
    recording.baseline();
    for part in 1..=parts {
        for _ in 0..6 {
            recording.frames(1).unwrap();
        }
        recording.frames(40).unwrap();
        recording.event();
        for _ in 0..4 {
            recording.frames(3).unwrap();
        }
        if part < parts {
            recording.roll();
        }
    }
    recording.hand(|reported| reported.events_handed += 1);
    recording.writer.close(at(1000), "done").unwrap();
    recording.reported.closed = true;
    vfs::mark(folder, recording.reported);
    vfs::steps(folder)
}

/// The content of a folder of parts. A frame in two parts counts once: the newer part's copy.
fn held(folder: &Path) -> (BTreeMap<u64, Frame>, Vec<String>, Option<Baseline>, bool) {
    let listing = logbook::list(folder).unwrap();
    for unreadable in &listing.unreadable {
        assert!(
            matches!(*unreadable.why, LogbookError::NotASession { .. }),
            "{}",
            unreadable.why
        );
    }
    let (mut frames, mut events) = (BTreeMap::new(), Vec::new());
    let (mut baseline, mut closed) = (None, false);
    let mut parts = listing.sessions;
    parts.sort_by_key(|part| part.id.clone());
    for part in parts {
        let session = SessionReader::open(&part.path).unwrap();
        for record in session.frames() {
            let frame = record.unwrap().frame;
            frames.insert(frame.sequence, frame);
        }
        let reported = session.events().unwrap();
        events.extend(
            reported
                .into_iter()
                .filter(|event| event.kind == "test")
                .map(|event| event.text),
        );
        baseline = session.baseline().unwrap().or(baseline);
        closed = session
            .closed()
            .is_some_and(|closing| closing.reason == "done");
    }
    (frames, events, baseline, closed)
}

/// Opens an image and compares it with what had been acknowledged to the writer.
fn check(folder: &Path, reported: Mark) {
    let (frames, events, kept_baseline, closed) = held(folder);
    let count = frames.len() as u64;
    assert!(
        (reported.kept..=reported.handed.max(reported.kept)).contains(&count),
        "{count} frames where {reported:?}"
    );
    assert!(
        count == reported.kept || count == reported.handed,
        "a group of frames is there whole or not at all: {count} where {reported:?}"
    );
    for (number, found) in (1..).zip(frames.values()) {
        assert_eq!(*found, frame(number));
    }
    let expected: Vec<String> = (1..=events.len())
        .map(|number| format!("event {number}"))
        .collect();
    assert_eq!(events, expected);
    assert!((reported.events_kept..=reported.events_handed).contains(&events.len()));
    match kept_baseline {
        Some(found) => assert_eq!(found, baseline()),
        None => assert!(!reported.baseline),
    }
    assert!(closed || !reported.closed);

    let open = logbook::interrupted(folder).unwrap();
    assert!(open.len() <= 1, "{open:?}");
    let Some(session) = open.first() else {
        assert!(closed || reported == Mark::default());
        return;
    };
    let (mut writer, resumed) = SessionWriter::resume(&session.path).unwrap();
    assert_eq!(resumed.acknowledged, count);
    writer.event(at(2000), RESUMED, "power cut").unwrap();
    assert_eq!(writer.append(&frame(count + 1), None).unwrap(), count + 1);
    writer.close(at(2001), "done").unwrap();
    let (again, ..) = held(folder);
    assert_eq!(again.len() as u64, count + 1);
    assert!(logbook::interrupted(folder).unwrap().is_empty());
}

/// A folder in memory if the system has one: an image needs no disk.
fn scratch() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm")
        .or_else(|_| tempfile::tempdir())
        .unwrap()
}

/// Checks every image of a recording; returns their number.
fn every_cut(steps: &[Step], all: bool) -> usize {
    let mut disk = Disk::default();
    let mut images = 0;
    for (index, step) in steps.iter().enumerate() {
        disk.take(step);
        let sectors = disk.last_sectors(step);
        let mut ways = vec![Lost::Nothing, Lost::Everything];
        match sectors {
            0 | 1 => {}
            _ if all => ways.extend((1..sectors).map(Lost::TornAfter)),
            _ => ways.extend([1, sectors / 2, sectors - 1].map(Lost::TornAfter)),
        }
        let seeds = if all { 12 } else { 2 };
        ways.extend(
            (0..seeds).map(|seed| Lost::Some((index as u64 * 131 + seed + 1) * 0x9e37_79b9)),
        );
        for lost in ways {
            let folder = scratch();
            disk.write_to(folder.path(), lost, &step.file);
            let outcome = std::panic::catch_unwind(|| check(folder.path(), disk.reported));
            if let Err(cause) = outcome {
                eprintln!(
                    "after step {index} of {} ({} {}), {lost:?}",
                    steps.len(),
                    step.file,
                    match &step.operation {
                        Operation::Write { offset, bytes } =>
                            format!("write of {} at {offset}", bytes.len()),
                        other => format!("{other:?}"),
                    }
                );
                std::panic::resume_unwind(cause);
            }
            images += 1;
        }
    }
    images
}

#[test]
fn whatever_a_power_cut_leaves_holds_what_was_acknowledged() {
    let folder = scratch();
    let all = std::env::var("TACTUS_CUTS").is_ok_and(|cuts| cuts == "all");
    let steps = recording(folder.path(), if all { 3 } else { 2 });
    let images = every_cut(&steps, all);
    println!("{images} images of {} steps", steps.len());
    assert!(images > 1000, "{images}");
}

#[test]
fn a_recording_that_does_not_sync_is_found_out() {
    let folder = scratch();
    let mut steps = recording(folder.path(), 2);
    steps.retain(|step| step.operation != Operation::Sync || !step.file.ends_with("-wal"));
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let outcome = std::panic::catch_unwind(|| every_cut(&steps, false));
    std::panic::set_hook(hook);
    assert!(outcome.is_err(), "images without a sync passed for sound");
}

#[test]
fn after_a_failed_sync_the_next_writer_goes_on() {
    let folder = scratch();
    let mut recording = Recording::begin(folder.path());
    recording.baseline();
    for _ in 0..5 {
        recording.frames(1).unwrap();
    }
    vfs::fail(
        folder.path(),
        Some(Fault::Sync {
            of: "m1.tactus-wal",
            after: 0,
        }),
    );
    let refusal = recording.frames(2).unwrap_err();
    assert!(refusal.is_broken() && !refusal.is_full(), "{refusal:?}");
    assert!(recording.writer.is_broken());
    // Syncs succeed again, but the writer stays broken: the state of the file is uncertain.
    vfs::fail(folder.path(), None);
    assert!(recording.frames(1).unwrap_err().is_broken());
    assert!(
        recording
            .writer
            .event(at(1), "test", "event 1")
            .unwrap_err()
            .is_broken()
    );
    assert!(recording.writer.roll(at(1)).unwrap_err().is_broken());
    assert_eq!(recording.writer.acknowledged(), 5);

    let before = vfs::steps(folder.path()).len();
    let left = recording.writer.successor(at(6), "fsync failed").unwrap();
    recording.frames(2).unwrap();
    let steps = vfs::steps(folder.path());
    assert!(
        steps[before..]
            .iter()
            .all(|step| !step.file.starts_with("m1.")),
        "the old file was touched again"
    );
    // The old file may contain the two unacknowledged frames too: each counts once.
    let (frames, ..) = held(folder.path());
    assert_eq!(
        frames.into_values().collect::<Vec<_>>(),
        (1..=7).map(frame).collect::<Vec<_>>()
    );
    let old = SessionReader::open(&left).unwrap();
    assert!((5..=7).contains(&old.len().unwrap()));
    // A power cut at this point: all writes since the last syncs are lost.
    let mut disk = Disk::default();
    for step in &steps {
        disk.take(step);
    }
    let image = scratch();
    disk.write_to(image.path(), Lost::Everything, "");
    check(image.path(), disk.reported);
}

#[test]
fn full_disk_tears_nothing_and_writing_continues() {
    let folder = scratch();
    let mut recording = Recording::begin(folder.path());
    recording.baseline();
    let mut refused = 0;
    for space in (0..400_000).step_by(9_973) {
        vfs::fail(folder.path(), Some(Fault::Full { space }));
        let refusal = loop {
            if let Err(refusal) = recording.frames(7) {
                break refusal;
            }
        };
        assert!(refusal.is_full() && !refusal.is_broken(), "{refusal:?}");
        assert!(!recording.writer.is_broken());
        refused += 1;
        assert_eq!(held(folder.path()).0.len() as u64, recording.reported.kept);
        vfs::fail(folder.path(), None);
        recording.frames(1).unwrap();
        recording.event();
    }
    println!("{refused} times full, {} frames", recording.reported.kept);
    let (frames, ..) = held(folder.path());
    for (number, found) in (1..).zip(frames.values()) {
        assert_eq!(*found, frame(number));
    }
    recording.writer.close(at(1), "done").unwrap();
    assert_eq!(held(folder.path()).0.len() as u64, recording.reported.kept);
}
