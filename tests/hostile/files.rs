//! A session's file becomes unavailable while it is written: locked by another program, deleted, moved.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use dbus::Session1Proxy;
use rusqlite::{Connection, TransactionBehavior};

use crate::site::{Daemon, SOON, Site, frames, is_alive, within};
use crate::users::User;

/// How long another program holds a lock: longer than any timeout for one.
const LOCKED: Duration = Duration::from_secs(12);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lock_held_on_the_file_ends_no_session() {
    let Some(site) = Site::prepare().await else {
        return;
    };
    let mut daemon = site.start().await;
    daemon.baseline().await;
    let session = daemon.measure().await;
    let file = session.path().await.unwrap();
    let mut browser = Connection::open(&file).unwrap();
    let lock = browser
        .transaction_with_behavior(TransactionBehavior::Immediate)
        .unwrap();
    let begun = Instant::now();
    while begun.elapsed() < LOCKED {
        let state = session.state().await.unwrap();
        assert!(
            is_alive(&state),
            "after {:.1?} the session is {state}: {}",
            begun.elapsed(),
            session.last_error().await.unwrap()
        );
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    lock.rollback().unwrap();
    drop(browser);
    let held = session.frames_durable().await.unwrap();
    frames(&session, held + 1).await;
    daemon.stop_by_command("system", &session).await;
    daemon.assert_unharmed();
    assert_continuous(&site, &session).await;
    site.verify();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_session_stopped_under_a_lock_ends_with_the_source_off() {
    let Some(site) = Site::prepare().await else {
        return;
    };
    let daemon = site.start().await;
    daemon.baseline().await;
    let session = daemon.measure().await;
    let id = session.id().await.unwrap();
    let file = session.path().await.unwrap();
    let mut browser = Connection::open(&file).unwrap();
    let lock = browser
        .transaction_with_behavior(TransactionBehavior::Immediate)
        .unwrap();
    // the record waits for its file; the source does not
    let begun = Instant::now();
    let stopped = tokio::spawn({
        let session = session.clone();
        async move { session.stop().await }
    });
    within(async {
        while daemon.manager.source_state().await.unwrap() != "off" {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    })
    .await;
    println!(
        "under a lock the source was off after {:.2?}",
        begun.elapsed()
    );
    assert!(begun.elapsed() < SOON);
    let answer = within(stopped).await.unwrap();
    let took = begun.elapsed();
    println!("and the answer came after {took:.2?}: {answer:?}");
    assert!(answer.is_ok() && took < SOON, "{took:?}: {answer:?}");
    lock.rollback().unwrap();
    drop(browser);
    daemon.daemon.stop().unwrap();
    assert_does_not_go_on(&site, &id).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_deleted_file_is_noticed_and_the_session_goes_on_in_another() {
    taken_away(|file| {
        for name in [file.to_owned(), beside(file, "-wal"), beside(file, "-shm")] {
            let _ = std::fs::remove_file(name);
        }
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_moved_file_is_noticed_and_the_session_goes_on_in_another() {
    taken_away(|file| std::fs::rename(file, file.with_extension("moved")).unwrap()).await;
}

async fn taken_away(take: impl FnOnce(&Path)) {
    let Some(site) = Site::prepare().await else {
        return;
    };
    let mut daemon = site.start().await;
    daemon.baseline().await;
    let session = daemon.measure().await;
    let file = PathBuf::from(session.path().await.unwrap());
    let lost = session.frames_durable().await.unwrap();
    take(&file);
    let next = another_file(&daemon, &session, &file).await;
    let held = session.frames_durable().await.unwrap();
    frames(&session, held + 2).await;
    daemon.stop_by_command("system", &session).await;
    daemon.assert_unharmed();
    let reader = logbook::SessionReader::open(&next).unwrap();
    assert!(reader.closed().is_some());
    let first = reader.frames().next().unwrap().unwrap().frame.sequence;
    // frames between the loss and its detection are lost with the file
    assert!(
        first <= held + 1,
        "{} begins with frame {first}",
        next.display()
    );
    println!(
        "frames up to {lost} were in the file, {} begins with frame {first}",
        next.display()
    );
}

/// Waits until the session is written to an existing file, and this is reported.
async fn another_file(daemon: &Daemon<'_>, session: &Session1Proxy<'_>, file: &Path) -> PathBuf {
    let begun = Instant::now();
    loop {
        let now = PathBuf::from(session.path().await.unwrap());
        let state = session.state().await.unwrap();
        if now != file {
            println!("noticed after {:.1?}", begun.elapsed());
            assert!(now.exists(), "{} is not there", now.display());
            assert!(is_alive(&state), "the session is {state}");
            assert!(
                daemon.daemon.log().contains(&file.display().to_string()),
                "nothing is said"
            );
            return now;
        }
        assert!(
            begun.elapsed() < NOTICED && is_alive(&state),
            "{:.0?} after the loss {} frames count as durable, the session is {state} in {}: {}",
            begun.elapsed(),
            session.frames_durable().await.unwrap(),
            now.display(),
            session.last_error().await.unwrap()
        );
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// A loss is detected within a few seconds.
const NOTICED: Duration = Duration::from_secs(30);

/// The name of a companion file of SQLite.
fn beside(file: &Path, suffix: &str) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// Every frame from the first to the last acknowledged is in one of the session's files.
async fn assert_continuous(site: &Site, session: &Session1Proxy<'_>) {
    let durable = session.frames_durable().await.unwrap();
    let last = PathBuf::from(session.path().await.unwrap());
    let mut sequences = Vec::new();
    for part in logbook::parts(&last).unwrap() {
        let reader = logbook::SessionReader::open(part).unwrap();
        sequences.extend(reader.frames().map(|record| record.unwrap().frame.sequence));
    }
    sequences.sort_unstable();
    sequences.dedup();
    let whole = sequences.iter().copied().eq(1..=durable);
    assert!(
        whole,
        "{durable} frames were acknowledged in {}, found: {sequences:?}",
        site.stage.state_path().display()
    );
}

/// The next daemon has no active session, and leaves the source off.
pub async fn assert_does_not_go_on(site: &Site, id: &str) {
    let daemon = site.start().await;
    // a session is resumed before a daemon reports that it is ready
    let active = daemon.manager.active_session().await.unwrap();
    assert_eq!(
        active.as_str(),
        "/",
        "session {id} goes on\n{}",
        daemon.daemon.log()
    );
    assert_eq!(daemon.manager.source_state().await.unwrap(), "off");
    daemon.daemon.stop().unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn another_user_can_open_no_file_of_the_record() {
    let Some(site) = Site::prepare().await else {
        return;
    };
    let daemon = site.start().await;
    daemon.baseline().await;
    let session = daemon.measure().await;
    let strangers = User::strangers(1, site.stage.path());
    let folder = site.stage.state_path();
    let files = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    for path in files.chain([folder.clone()]) {
        let read = strangers[0]
            .command("head")
            .arg("-c1")
            .arg(&path)
            .output()
            .unwrap();
        assert!(
            !read.status.success(),
            "another user reads {}",
            path.display()
        );
    }
    daemon.stop_by_command("peer", &session).await;
}
