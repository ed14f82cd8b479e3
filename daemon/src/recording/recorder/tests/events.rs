//! Events on a disk without space.

use logbook::Storage;
use rusqlite::Connection;

use crate::events::event::Event;
use crate::events::kind::EventKind;
use crate::recording::recorder::tests::*;

/// Page limit of the record.
const PAGES: u32 = 6400;

/// Data that fill the last page of the events, and all other pages of the record.
struct Filler(Connection);

impl Filler {
    fn load(path: &std::path::Path) -> Self {
        let other = Connection::open(path).unwrap();
        other
            .pragma_update_and_check(None, "max_page_count", PAGES, |_| Ok(()))
            .unwrap();
        // a row so large that no other fits on its page
        other
            .execute(
                "INSERT INTO event (at_ns, kind, text, checksum) VALUES (0, 'ballast', ?1, x'00')",
                ["x".repeat(440)],
            )
            .unwrap();
        other
            .execute("CREATE TABLE ballast (bytes BLOB)", [])
            .unwrap();
        for bytes in [16_000, 400] {
            let full = loop {
                let more = "INSERT INTO ballast VALUES (zeroblob(?1))";
                if let Err(refused) = other.execute(more, [bytes]) {
                    break refused.sqlite_error_code();
                }
            };
            assert_eq!(full, Some(rusqlite::ErrorCode::DiskFull));
        }
        Self(other)
    }

    fn remove(self) {
        self.0
            .execute_batch("DROP TABLE ballast; DELETE FROM event WHERE kind = 'ballast'")
            .unwrap();
    }
}

/// Lets the recorder continue in a session with the page limit.
fn limit_pages(scene: &Scene, recorder: &mut Recorder) {
    let setup = &scene.prepared.setup;
    let header = SessionHeader::new("m2", DateTime::UNIX_EPOCH, setup.protocol.clone());
    let storage = Storage {
        page_limit: Some(PAGES),
        ..Storage::default()
    };
    let mut writer = SessionWriter::create_with(&setup.record_directory, &header, storage).unwrap();
    let baseline = Baseline::from_frames("b1", &[frame(&scene.prepared, 0)]).unwrap();
    writer.baseline(&baseline).unwrap();
    scene.status.set_path(writer.path());
    recorder.logbook.writer = writer;
}

/// Waits until acquisition is held; panics if the end of the session is requested instead.
fn held(status: &SessionStatus) {
    let mut held = status.held();
    let mut over = status.stop_request();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .build()
        .unwrap();
    let held = runtime.block_on(async {
        tokio::select! {
            held = held.wait_for(|held| *held) => held.map(|held| *held).unwrap(),
            () = over.requested() => false,
        }
    });
    assert!(held, "it ended: {}", status.stop_reason());
}

#[test]
fn event_on_a_full_disk_waits_and_ends_no_session() {
    let (scene, mut recorder, queue, tell) = Scene::new();
    limit_pages(&scene, &mut recorder);
    let recording = std::thread::spawn(move || recorder.run(queue));
    tell.send(Do::Map).unwrap();
    scene.frame(1);
    until(scene.status.follow_durable(), |durable| *durable == 1);

    // an event of the recorder itself, written before the frame
    let ballast = Filler::load(&scene.status.path());
    tell.send(Do::Panic).unwrap();
    scene.frame(2);
    held(&scene.status);
    let error = scene.status.progress().last_error;
    assert!(error.contains("acquisition pauses"), "{error}");
    assert_eq!(scene.status.durable(), 1);
    ballast.remove();
    until(scene.status.follow_durable(), |durable| *durable == 2);
    until(scene.status.held(), |held| !held);

    // an event from another task, not followed by a frame: acquisition is released as well
    let ballast = Filler::load(&scene.status.path());
    let text = "a longer sentence than fits beside the ballast. ".repeat(4);
    scene.send(RecorderMessage::Event(Event::new(
        DateTime::UNIX_EPOCH,
        EventKind::Paused,
        &text,
        Some("m1"),
    )));
    held(&scene.status);
    ballast.remove();
    until(scene.status.held(), |held| !held);
    scene.close();
    recording.join().unwrap().unwrap();
    let (maps, events) = scene.recorded();
    assert_eq!(maps, [true, false]);
    assert_eq!(
        events,
        ["method-suspended", "disk-room", "paused", "disk-room"]
    );
    assert_eq!(
        scene.reported(),
        [
            "method-suspended",
            "disk-full",
            "disk-room",
            "disk-full",
            "disk-room"
        ]
    );
    assert!(
        SessionReader::open(scene.status.path())
            .unwrap()
            .closed()
            .is_some()
    );
}

#[test]
fn an_event_that_fails_counts_every_frame_of_its_batch() {
    let (scene, mut recorder, queue, tell) = Scene::new();
    limit_pages(&scene, &mut recorder);
    let _ballast = Filler::load(&scene.status.path());
    // the event about the method cannot be written, and the session must not wait for space
    tell.send(Do::Panic).unwrap();
    for number in 1..=3 {
        scene.frame(number);
    }
    scene.status.stop("a test");
    recorder.run(queue).unwrap_err();
    assert_eq!((scene.status.durable(), scene.status.dropped()), (0, 3));
}

#[test]
fn a_lock_during_a_pause_for_space_is_left_behind() {
    let (scene, mut recorder, queue, tell) = Scene::new();
    recorder.logbook.disk.lock_patience = Duration::from_nanos(1);
    let first = scene.status.path();
    tell.send(Do::Map).unwrap();
    scene.free.store(0, Ordering::SeqCst);
    scene.frame(1);
    let recording = std::thread::spawn(move || recorder.run(queue));
    until(scene.status.held(), |held| *held);
    let other = Connection::open(&first).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    scene.free.store(AMPLE_SPACE, Ordering::SeqCst);
    until(scene.status.follow_durable(), |durable| *durable == 1);
    scene.close();
    recording.join().unwrap().unwrap();
    assert_ne!(scene.status.path(), first);
    let reported = scene.reported();
    assert!(reported.contains(&"alarm"), "{reported:?}");
    drop(other);
}

#[test]
fn a_lock_that_lasts_is_left_behind_for_the_next_part() {
    let (scene, mut recorder, queue, tell) = Scene::new();
    recorder.logbook.disk.lock_patience = Duration::ZERO;
    let first = scene.status.path();
    let other = Connection::open(&first).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    tell.send(Do::Map).unwrap();
    scene.frame(1);
    let recording = std::thread::spawn(move || recorder.run(queue));
    until(scene.status.follow_durable(), |durable| *durable == 1);
    scene.close();
    recording.join().unwrap().unwrap();
    assert_eq!(scene.reported(), ["alarm"]);
    assert_ne!(scene.status.path(), first);
    let (maps, events) = scene.recorded();
    assert_eq!(maps, [true]);
    assert_eq!(events, [logbook::CONTINUED]);
    drop(other);
}
