//! Acknowledged frames are on disk, whatever happens to the daemon; and the next daemon starts with the same record.

use dbus::{Address, Session1Proxy};

use crate::test_rig::{self, Needs, ask, baseline};

#[test]
fn killed_daemon_keeps_every_acknowledged_frame() {
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let mut id = String::new();
    let mut before = 0;
    for round in 1..=3_u64 {
        let daemon = test_rig::start(&stage);
        if round == 1 {
            baseline(&stage, 2);
            id = ask(&stage, &["start", "--step"])[0]["session"]
                .as_str()
                .expect("an id")
                .to_owned();
        }
        // the killed daemon's session is resumed automatically
        let acknowledged = test_rig::runtime().block_on(async {
            let (connection, _) = dbus::connect(Some(&Address::Unix(stage.peer_path())))
                .await
                .expect("the daemon listens");
            let path = dbus::session_path(&id).expect("an id makes a path");
            let session = Session1Proxy::new(&connection, path)
                .await
                .expect("the session is there");
            session.step(5 * round).await.expect("frames are taken")
        });
        daemon.kill();
        assert!(
            acknowledged >= before + 5 * round,
            "{before}, then {acknowledged}"
        );
        let sessions = ask(&stage, &["sessions"]);
        let session = sessions
            .iter()
            .find(|line| line["id"] == id.as_str())
            .expect("the session is listed");
        assert_eq!(session["closed"], false, "nobody closed it");
        before = test_rig::number(session, "frames") as u64;
        assert!(before >= acknowledged, "{session}");
        let text = test_rig::export_csv(&stage, &id);
        let numbers = text
            .lines()
            .skip(1)
            .map(|row| row.split(',').next().unwrap_or_default().to_owned());
        assert!(
            numbers.eq((1..=before).map(|number| number.to_string())),
            "{text}"
        );
        std::fs::remove_dir_all(stage.path().join(format!("{id}.case"))).expect("written above");
    }
    let events = ask(&stage, &["events", &id]);
    let restarts = events
        .iter()
        .filter(|event| event["kind"] == "restarted")
        .count();
    assert_eq!(restarts, 2, "each gap has its event: {events:?}");
}
