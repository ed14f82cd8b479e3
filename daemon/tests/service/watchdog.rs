//! Heartbeats for systemd.

use std::time::Duration;

use crate::stage::{SMALL, Stage, within};
use dbus::Options;
use tokio::net::UnixDatagram;

async fn next(socket: &UnixDatagram) -> String {
    let mut text = vec![0; 4096];
    let length = within(socket.recv(&mut text)).await.unwrap();
    String::from_utf8(text[..length].to_vec()).unwrap()
}

async fn expect_notification(socket: &UnixDatagram, word: &str) {
    while !next(socket).await.lines().any(|line| line == word) {}
}

#[tokio::test(flavor = "multi_thread")]
async fn systemd_is_notified_of_readiness_life_and_end() {
    let stage = Stage::new(SMALL);
    let (daemon, socket) = stage.start_watched(Duration::from_millis(300)).await;
    expect_notification(&socket, "READY=1").await;
    expect_notification(&socket, "WATCHDOG=1").await;
    daemon.baseline(1).await;
    // a session that takes frames, and one that waits for a user
    for options in [Options::new(), Options::new().with("step", true)] {
        let session = daemon.start(options).await;
        expect_notification(&socket, "STATUS=acquiring").await;
        for _ in 0..3 {
            expect_notification(&socket, "WATCHDOG=1").await;
        }
        session.stop().await.unwrap();
        expect_notification(&socket, "STATUS=idle").await;
    }
    daemon.hang_up();
    expect_notification(&socket, "RELOADING=1").await;
    expect_notification(&socket, "READY=1").await;
    let (status, log) = daemon.terminate().await;
    assert!(status.success(), "{log}");
    expect_notification(&socket, "STOPPING=1").await;
    assert!(!log.contains("overdue"), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_manager_that_does_not_read_stops_nothing() {
    let stage = Stage::new(SMALL);
    let (daemon, unread) = stage.start_watched(Duration::from_millis(300)).await;
    let other = std::os::unix::net::UnixDatagram::unbound().unwrap();
    other.connect(stage.path().join("notify")).unwrap();
    other.set_nonblocking(true).unwrap();
    while other.send(b"X_FULL=1").is_ok() {}
    within(async {
        daemon.baseline(1).await;
        let session = daemon.start(Options::new()).await;
        session.stop().await.unwrap();
    })
    .await;
    let (status, log) = within(daemon.terminate()).await;
    assert!(status.success(), "{log}");
    drop(unread);
}
