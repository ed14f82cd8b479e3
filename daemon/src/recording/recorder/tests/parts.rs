//! Tests of the parts of a session.

use crate::recording::recorder::tests::*;

#[test]
fn part_of_a_new_day_begins_when_a_lock_is_released() {
    let (scene, recorder, queue, tell) = Scene::daily();
    for _ in 0..3 {
        tell.send(Do::Map).unwrap();
    }
    let first = scene.status.path();
    let recording = std::thread::spawn(move || recorder.run(queue));
    let durable = |number: u64| until(scene.status.follow_durable(), |durable| *durable == number);
    scene.frame(99);
    durable(1);
    let lock = rusqlite::Connection::open(&first).unwrap();
    lock.execute_batch("BEGIN IMMEDIATE").unwrap();
    // a frame of the next day
    scene.frame(100);
    until(scene.status.held(), |held| *held);
    lock.execute_batch("ROLLBACK").unwrap();
    drop(lock);
    durable(2);
    scene.frame(101);
    durable(3);
    scene.close();
    recording.join().unwrap().unwrap();
    let last = |path: &std::path::Path| {
        let session = SessionReader::open(path).unwrap();
        session.last().unwrap().unwrap().frame.sequence
    };
    assert_eq!((last(&first), last(&scene.status.path())), (2, 3));
    assert_ne!(first, scene.status.path());
}

#[test]
fn a_refused_part_is_reported_at_its_start_and_end() {
    let (scene, recorder, queue, tell) = Scene::daily();
    for _ in 0..4 {
        tell.send(Do::Map).unwrap();
    }
    let first = scene.status.path();
    // every name that the next part could have is taken
    let taken = |number| first.with_file_name(format!("m1_p{number}.tactus"));
    let taken: Vec<PathBuf> = (2..=1001).map(taken).collect();
    for path in &taken {
        std::fs::write(path, "").unwrap();
    }
    let recording = std::thread::spawn(move || recorder.run(queue));
    // each frame is on another day
    for (durable, number) in (1..).zip([99, 100, 200, 300]) {
        if number == 300 {
            for path in &taken {
                std::fs::remove_file(path).unwrap();
            }
        }
        scene.frame(number);
        until(scene.status.follow_durable(), |now| *now == durable);
    }
    scene.close();
    recording.join().unwrap().unwrap();
    assert_ne!(scene.status.path(), first);
    let mut reported = scene.reported();
    reported.retain(|kind| kind.starts_with("part-"));
    assert_eq!(reported, ["part-refused", "part-created"]);
}
