//! A night of logging: every frame is recorded, the numbers have no gap, and the session closes itself.

use crate::test_rig::{self, Needs, ask, baseline, measure};

#[test]
fn every_frame_is_recorded_without_a_gap() {
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let frames = if std::env::var_os("TACTUS_RIG").is_some() {
        20
    } else {
        200
    };
    let id = measure(&stage, frames);
    let status = &ask(&stage, &["status"])[0];
    assert_eq!(status["state"], "idle", "{status}");
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));

    let sessions = ask(&stage, &["sessions"]);
    let session = sessions
        .iter()
        .find(|session| session["id"] == id.as_str())
        .expect("the session is listed");
    assert_eq!(session["frames"], frames);
    assert_eq!(session["closed"], true);
    assert_eq!(session["readings"], 598);

    let text = test_rig::export_csv(&stage, &id);
    let rows: Vec<&str> = text.lines().skip(1).collect();
    assert_eq!(rows.len(), frames);
    let mut last = f64::NEG_INFINITY;
    for (row, expected) in rows.iter().zip(1_u64..) {
        let fields: Vec<&str> = row.split(',').collect();
        assert_eq!(fields[0].parse(), Ok(expected), "sequence");
        let monotonic: f64 = fields[2].parse().expect("monotonic seconds");
        assert!(monotonic > last, "time goes on: {monotonic} after {last}");
        last = monotonic;
    }
}

#[test]
fn schedule_ends_by_itself_and_daemon_stops_within_one() {
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 2);
    ask(&stage, &["start", "--every", "50ms", "--for", "10h"]);
    // the session is running: wait for a few frames before the daemon is stopped
    ask(&stage, &["watch", "--count", "3", "--no-map"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
    let sessions = ask(&stage, &["sessions"]);
    let last = sessions.last().expect("a session is listed");
    assert!(test_rig::number(last, "frames") >= 3.0, "{last}");
    // the session is not complete: the next daemon resumes it until it is stopped
    assert_eq!(last["closed"], false, "{last}");
    let daemon = test_rig::start(&stage);
    let status = &ask(&stage, &["status"])[0];
    assert_eq!(status["session"]["id"], last["id"], "{status}");
    ask(&stage, &["stop"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
    let sessions = ask(&stage, &["sessions"]);
    assert_eq!(
        sessions.last().map(|last| &last["closed"]),
        Some(&true.into())
    );
}
