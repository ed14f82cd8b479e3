//! Network cuts, for a week and in the middle of a push: nothing is lost or duplicated, and each cut is reported.

use rustix::process::Signal;

use crate::archive;
use crate::frames::at;
use crate::proxy::{Far, Proxy, ProxyMode};
use crate::server::{DATABASE, Server};
use crate::site::{Site, add_minute, begun, more_frames};

const COUNTS: &str = "SELECT (SELECT count(*) FROM tactus.session), (SELECT count(*) FROM tactus.part), (SELECT sum(frames) FROM tactus.part),
    (SELECT count(*) FROM tactus.event), (SELECT count(*) FROM tactus.alarm), (SELECT count(*) FROM tactus.quantity),
    (SELECT count(*) FROM tactus.session_summary WHERE complete)";

/// A proxy to the server, used by the site.
fn linked(server: &Server, site: &Site) -> Proxy {
    let socket = server.socket().join(format!(".s.PGSQL.{}", server.port()));
    let proxy = Proxy::to(Far::Socket(socket));
    let dsn = format!(
        "host=127.0.0.1 port={} dbname={DATABASE} user=berlin",
        proxy.port()
    );
    site.configure(&dsn, "");
    proxy
}

#[test]
fn week_without_link_is_archived_in_one_pass() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    let proxy = linked(&server, &site);
    proxy.set(ProxyMode::Cut);
    let mut writer = begun(&site.record(), "m1", 1);
    for day in 1..=7 {
        for minute in 1..=10 {
            add_minute(&site.record(), "m1", 1440 * (day - 1) + minute);
        }
        writer.roll(at(86_400 * day as i64)).unwrap();
        more_frames(&mut writer, 1 + day);
        // a nightly push fails
        let error = site.refused(&["push"], 75);
        assert!(
            error.contains("cannot reach PostgreSQL at 127.0.0.1"),
            "{error}"
        );
        assert!(site.stored().is_empty());
    }
    proxy.set(ProxyMode::Open);
    let status = site.run(&["status", "--json"]);
    let status: serde_json::Value = serde_json::from_slice(&status.stdout).unwrap();
    assert_eq!(status["missing"].as_array().unwrap().len(), 7, "{status}");
    assert_eq!(status["missing_lines"], 70, "{status}");
    assert_eq!(site.done(&["push"]).matches(": archived as").count(), 7);
    writer.close(at(8 * 86_400), "asked to stop").unwrap();
    site.done(&["push"]);
    // each part has 3 notes and an alarm; 7 events name the next part
    assert_eq!(server.sql(COUNTS), "1|8|24|39|8|70|1");
    site.done(&["verify"]);
    assert_eq!(site.done(&["push"]), "");
}

#[test]
fn link_cut_at_any_statement_loses_and_doubles_nothing() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    let proxy = linked(&server, &site);
    let statements: [&[u8]; 8] = [
        b"SELECT part, encode",
        b"synchronous_commit",
        b"INSERT INTO tactus.session",
        b"INSERT INTO tactus.part",
        b"INSERT INTO tactus.event",
        b"INSERT INTO tactus.alarm",
        b"INSERT INTO tactus.quantity",
        b"COMMIT",
    ];
    let mut sessions = 0;
    for statement in statements {
        for cut in [
            ProxyMode::CutBefore(statement),
            ProxyMode::CutAfter(statement),
        ] {
            sessions += 1;
            site.record_session(&format!("m{sessions}"), 1);
            proxy.set(cut.clone());
            let output = site.run(&["push"]);
            let error = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(75), "{cut:?}: {error}");
            assert!(
                error.contains("PostgreSQL at 127.0.0.1"),
                "{cut:?}: {error}"
            );
            let there = server.sql("SELECT count(*) FROM tactus.part");
            // after COMMIT only the reply was lost: the part is committed
            let committed = cut == ProxyMode::CutAfter(b"COMMIT");
            let expected = if committed { sessions } else { sessions - 1 };
            assert_eq!(there, expected.to_string(), "{cut:?}");
            let confirmed = site.record().join(format!("m{sessions}.archived.json"));
            assert!(
                !confirmed.exists(),
                "{cut:?}: a receipt without a known commit"
            );
            proxy.set(ProxyMode::Open);
            site.done(&["push"]);
            assert!(confirmed.exists(), "{cut:?}");
            let expected = [1, 1, 3, 4, 1, 3, 1].map(|count| (count * sessions).to_string());
            assert_eq!(server.sql(COUNTS), expected.join("|"), "{cut:?}");
        }
    }
    site.done(&["verify"]);
    assert_eq!(site.stored().len(), sessions);
}

#[test]
fn restart_of_the_server_in_mid_push_loses_nothing() {
    let Some((mut server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 2);
    // this lock blocks the first part in the middle of its transaction
    let mut lock =
        server.session("BEGIN; LOCK TABLE tactus.alarm IN EXCLUSIVE MODE; SELECT pg_sleep(600)");
    server.wait_for("SELECT count(*) FROM pg_locks WHERE mode = 'ExclusiveLock' AND granted AND relation = 'tactus.alarm'::regclass", "1");
    let mut push = site.command(&["push"]);
    let push = push
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    server.wait_for("SELECT count(*) FROM pg_stat_activity WHERE usename = 'berlin' AND wait_event_type = 'Lock'", "1");
    // as `systemctl restart postgresql` does
    server.kill(Signal::INT);
    server.resume();
    let output = push.wait_with_output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(75), "{error}");
    assert!(error.contains("PostgreSQL at"), "{error}");
    let _ = lock.wait();
    assert_eq!(server.sql("SELECT count(*) FROM tactus.session"), "0");
    site.done(&["push"]);
    assert_eq!(server.sql(COUNTS), "1|2|6|9|2|6|1");
    site.done(&["verify"]);
}
