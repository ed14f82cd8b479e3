//! An offline or frozen broker loses messages, receives no stale ones, and blocks nothing.

use rustix::process::Signal;
use serde_json::Value;

use crate::live::daemon::{Daemon, report};
use crate::live::mosquitto::{Mosquitto, signal_to};
use crate::live::publisher::{Publisher, machine, mqtt};
use crate::server::{DATABASE, Server};
use crate::site::Site;

const SESSION: &str = "tactus/1/berlin/bed3/session";

fn frames(session: &Value) -> u64 {
    session["frames_durable"].as_u64().unwrap_or_default()
}

#[test]
fn broker_that_comes_back_gets_the_newest_only() {
    let Some(mut broker) = Mosquitto::open() else {
        return;
    };
    let machine = machine();
    let daemon = Daemon::start(&machine.path().join("peer"), report(1));
    let lines = mqtt(&broker, 1.0);
    let publisher = Publisher::start(machine.path(), &lines);
    broker.watch().wait(SESSION, |session| frames(session) == 1);
    broker.kill();
    publisher.wait_for("tried again until it succeeds");
    // each report replaces the previous one
    for count in 2..=6 {
        let before = daemon.requests();
        daemon.change(|report| *report = crate::live::daemon::report(count));
        daemon.wait_until_requested(before + 2);
    }
    // the publisher pauses until a client has subscribed, so that no message is missed
    signal_to(&publisher.child, Signal::STOP);
    broker.resume();
    let mut watcher = broker.watch();
    signal_to(&publisher.child, Signal::CONT);
    watcher.wait(SESSION, |session| frames(session) == 6);
    let sessions = watcher.seen.iter().filter(|(topic, _)| topic == SESSION);
    let old = sessions.filter(|(_, text)| frames(&serde_json::from_str(text).unwrap()) < 6);
    assert_eq!(old.count(), 0, "{:?}", watcher.seen);
}

#[test]
fn frozen_broker_delays_no_upload() {
    let Some(broker) = Mosquitto::open() else {
        return;
    };
    let Some(server) = Server::start() else {
        return;
    };
    let owner = Site::new(&server, "owner");
    assert!(owner.owner(&server, &["migrate"]).status.success());
    let site = Site::added(&server, "berlin");
    let dsn = format!(
        "host={} port={} dbname={DATABASE} user=berlin",
        server.socket().display(),
        server.port()
    );
    let more = format!(
        "[bus]\npeer_path = \"peer\"\n[mqtt]\nhost = \"127.0.0.1\"\nport = {}\nevery_s = 1.0\n",
        broker.port()
    );
    site.configure(&dsn, &more);
    let daemon = Daemon::start(&site.folder.path().join("peer"), report(1));
    let publisher = Publisher::with_config(site.folder.path());
    let mut watcher = broker.watch();
    watcher.wait(SESSION, |session| frames(session) == 1);
    broker.signal(Signal::STOP);
    let memory = || resident(publisher.child.id());
    let before = memory();
    for count in 1..=10 {
        site.record_session(&format!("m{count}"), 1);
        let asked = daemon.requests();
        daemon.change(|report| *report = crate::live::daemon::report(1 + count));
        daemon.wait_until_requested(asked + 2);
    }
    // uploads do not wait for the broker
    server.wait_for("SELECT count(*) FROM tactus.part", "10");
    let grown = memory().saturating_sub(before);
    assert!(grown < 8 << 20, "memory has grown by {grown} bytes");
    broker.signal(Signal::CONT);
    watcher.wait(SESSION, |session| frames(session) == 11);
    // only messages in flight at the freeze, and the newest ones, arrive
    let old: std::collections::BTreeSet<u64> = watcher
        .seen
        .iter()
        .filter(|(topic, _)| topic == SESSION)
        .map(|(_, text)| frames(&serde_json::from_str(text).unwrap()))
        .filter(|count| (3..11).contains(count))
        .collect();
    assert!(old.is_empty(), "old messages were sent: {old:?}");
}

/// Memory of a process, bytes.
fn resident(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes: u64 = line
        .unwrap()
        .trim()
        .trim_end_matches(" kB")
        .parse()
        .unwrap();
    1024 * kilobytes
}
