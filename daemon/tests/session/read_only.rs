//! The record's disk becomes read-only during a session, as ext4 does after an error of its device.

use crate::endings::{assert_stays_ended, durable, recorded, resuming};
use crate::mounts::has_own_mounts;
use crate::mounts::loop_disk::{Disk, has_disks};
use crate::stage::{Stage, within};
use dbus::Options;

#[tokio::test(flavor = "multi_thread")]
async fn a_session_whose_disk_turns_read_only_stays_ended() {
    if !has_own_mounts("read_only::a_session_whose_disk_turns_read_only_stays_ended") {
        return;
    }
    let stage = Stage::new(&resuming());
    if !has_disks(stage.path()) {
        return;
    }
    let state = stage.path().join("state");
    let disk = Disk::mounted(stage.path().join("image"), state.clone());
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let session = daemon.start(Options::new().with("every_s", 0.02)).await;
    durable(&session, 3).await;
    disk.turn_read_only();
    let text = loop {
        let signal = within(dbus::next(&mut happened)).await.unwrap();
        let text = signal.args().unwrap().text.to_string();
        if text.contains("could not be closed") {
            break text;
        }
    };
    assert!(text.contains("only until this machine restarts"), "{text}");
    let ended = within(session.wait()).await;
    assert!(ended.is_err(), "the record failed: {ended:?}");
    assert_eq!(session.state().await.unwrap(), "faulted");
    let frames = session.frames_durable().await.unwrap();
    daemon.kill().await;
    disk.repair();
    let daemon = assert_stays_ended(&stage).await;
    // a frame whose sync failed may have reached the disk; no acknowledged frame is lost
    let kept = recorded(&state);
    assert!(kept.iter().copied().eq(1..=kept.len() as u64), "{kept:?}");
    assert!(
        kept.len() as u64 >= frames,
        "{kept:?}, acknowledged {frames}"
    );
    daemon.terminate().await;
}
