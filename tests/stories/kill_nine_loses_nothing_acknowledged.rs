//! What was acknowledged is on disk, whatever happens to the daemon; and the next one starts on the same record.

use bus::{Address, Session1Proxy};

use crate::scenery::{self, Needs, ask, baseline};

#[test]
fn a_killed_daemon_has_kept_every_acknowledged_frame() {
    let Some(stage) = scenery::set(Needs::ANY, scenery::NOISY) else {
        return;
    };
    for round in 1..=3_u64 {
        let keeper = scenery::start(&stage);
        if round == 1 {
            baseline(&stage, 2);
        }
        let id = ask(&stage, &["start", "--step"])[0]["session"]
            .as_str()
            .expect("an id")
            .to_owned();
        let acknowledged = scenery::runtime().block_on(async {
            let (connection, _) = bus::connect(Some(&Address::Unix(stage.peer_path())))
                .await
                .expect("the daemon listens");
            let path = bus::session_path(&id).expect("an id makes a path");
            let session = Session1Proxy::new(&connection, path)
                .await
                .expect("the session is there");
            session.step(5 * round).await.expect("frames are taken")
        });
        keeper.kill();
        assert_eq!(acknowledged, 5 * round);
        let sessions = ask(&stage, &["sessions"]);
        let session = sessions
            .iter()
            .find(|line| line["id"] == id.as_str())
            .expect("the session is listed");
        assert_eq!(session["closed"], false, "nobody closed it");
        assert!(
            scenery::number(session, "frames") as u64 >= acknowledged,
            "{session}"
        );
        let rows = scenery::export_csv(&stage, &id).lines().count() as u64 - 1;
        assert!(
            rows >= acknowledged,
            "{rows} rows, {acknowledged} acknowledged"
        );
    }
}
