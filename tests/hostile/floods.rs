//! Floods of every permitted call, by one user and by eight: the session continues, no frame is missed, and root's
//! `tactus stop` ends it.

use std::collections::BTreeSet;
use std::time::Instant;

use crate::calls;
use crate::flood::{Counts, Flood, Width};
use crate::site::{SOON, STOPS_WITHIN, Site, frames};
use crate::users::User;

const WIDTH: Width = Width {
    connections: 4,
    at_once: 16,
};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_user_who_calls_everything_delays_no_frame_or_stop() {
    everything(1, &["system"]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn eight_users_who_call_everything_delay_no_frame_or_stop() {
    everything(8, &["system", "peer"]).await;
}

async fn everything(users: usize, ways: &[&str]) {
    let Some(site) = Site::prepare().await else {
        return;
    };
    let mut daemon = site.start().await;
    daemon.baseline().await;
    let strangers = User::strangers(users, site.stage.path());
    let instrument = daemon.manager.instruments().await.unwrap()[0].to_string();
    for way in ways {
        let session = daemon.measure().await;
        let path = session.inner().path().to_string();
        let before = daemon.size();
        let all = calls::all(&path, &instrument);
        let flood = Flood::begin(&site.bus, &strangers, WIDTH, all).await;
        let begun = Instant::now();
        let held = session.frames_durable().await.unwrap();
        frames(&session, held + 2).await;
        flood.has_gone_round().await;
        let took = daemon.stop_by_command(way, &session).await;
        let (answered, lasted) = (flood.answered(), begun.elapsed());
        let counts = flood.end().await;
        println!(
            "{users} users, {answered} answers in {lasted:.1?}: `tactus stop` on {way} took {took:.2?}"
        );
        print(&counts);
        let count = daemon.assert_nothing_missed(&session).await;
        assert!(count >= held + 2, "{count} frames");
        daemon.assert_unharmed();
        daemon.shrinks_to(before).await;
    }
    assert_eq!(daemon.manager.state().await.unwrap(), "idle");
    site.verify();
}

/// Testing each call alone takes minutes: only with `TACTUS_HOSTILE=all`.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_call_alone_delays_a_frame_or_stop() {
    if std::env::var("TACTUS_HOSTILE").as_deref() != Ok("all") {
        let why = "each call by itself takes minutes; TACTUS_HOSTILE=all has it";
        return needs::lacking("HOSTILE", why);
    }
    let Some(site) = Site::prepare().await else {
        return;
    };
    let mut daemon = site.start().await;
    daemon.baseline().await;
    let strangers = User::strangers(8, site.stage.path());
    let instrument = daemon.manager.instruments().await.unwrap()[0].to_string();
    let names = calls::all("/session", &instrument).into_iter();
    let names: BTreeSet<_> = names.map(|call| (call.interface, call.member)).collect();
    for (interface, member) in names {
        for users in [&strangers[..1], &strangers[..]] {
            let session = daemon.measure().await;
            let mut chosen = calls::all(session.inner().path().as_str(), &instrument);
            chosen.retain(|call| call.interface == interface && call.member == member);
            let flood = Flood::begin(&site.bus, users, WIDTH, chosen).await;
            let held = session.frames_durable().await.unwrap();
            frames(&session, held + 1).await;
            let took = daemon.stop_by_command("system", &session).await;
            let counts = flood.end().await;
            println!(
                "{} users, {interface}.{member}: `tactus stop` took {took:.2?}",
                users.len()
            );
            print(&counts);
            daemon.assert_nothing_missed(&session).await;
            daemon.assert_unharmed();
        }
    }
    site.verify();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_user_who_wants_no_answer_delays_no_frame_or_stop() {
    unanswered(1).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn eight_users_who_want_no_answer_delay_no_frame_or_stop() {
    unanswered(8).await;
}

/// The geometry is the largest reply, and shares the bus's single socket with the reply to a stop.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn eight_users_who_ask_for_the_geometry_delay_no_stop() {
    let Some(site) = Site::prepare().await else {
        return;
    };
    let mut daemon = site.start().await;
    daemon.baseline().await;
    let strangers = User::strangers(8, site.stage.path());
    let mut shortest = SOON;
    for _ in 0..3 {
        let session = daemon.measure().await;
        let call = calls::Call {
            path: dbus::ROOT_PATH.to_owned(),
            interface: dbus::MANAGER_INTERFACE.to_owned(),
            member: "Geometry".to_owned(),
            body: None,
        };
        let flood = Flood::begin(&site.bus, &strangers, WIDTH, vec![call]).await;
        let held = session.frames_durable().await.unwrap();
        frames(&session, held + 1).await;
        let took = daemon.stop_by_command("system", &session).await;
        let counts = flood.end().await;
        println!("8 users, Geometry: `tactus stop` took {took:.2?}");
        print(&counts);
        shortest = shortest.min(took);
        daemon.assert_nothing_missed(&session).await;
        daemon.assert_unharmed();
    }
    println!("the shortest: {shortest:.2?}");
    assert!(shortest < STOPS_WITHIN, "{shortest:?}");
}

/// The bus does not count calls without a requested reply, so only the daemon limits them. Calls that control the rig
/// are used, because others are discarded immediately.
async fn unanswered(users: usize) {
    let Some(site) = Site::prepare().await else {
        return;
    };
    let mut daemon = site.start().await;
    daemon.baseline().await;
    let strangers = User::strangers(users, site.stage.path());
    let width = Width {
        connections: 1,
        at_once: 16,
    };
    let mut shortest = SOON;
    for way in ["system", "system", "system", "peer"] {
        let session = daemon.measure().await;
        let call = calls::Call {
            path: session.inner().path().to_string(),
            interface: dbus::SESSION_INTERFACE.to_owned(),
            member: "Stop".to_owned(),
            body: None,
        };
        let flood = Flood::begin_unanswered(&site.bus, &strangers, width, &call).await;
        let begun = Instant::now();
        let held = session.frames_durable().await.unwrap();
        frames(&session, held + 2).await;
        let took = daemon.stop_by_command(way, &session).await;
        let (sent, lasted) = (flood.answered(), begun.elapsed());
        let counts = flood.end().await;
        println!(
            "{users} users, {sent} calls without an answer in {lasted:.1?}: `tactus stop` on {way} took {took:.2?}"
        );
        print(&counts);
        if way == "system" {
            shortest = shortest.min(took);
        }
        daemon.assert_nothing_missed(&session).await;
        daemon.assert_unharmed();
    }
    println!("the shortest: {shortest:.2?}");
    assert!(shortest < STOPS_WITHIN, "{shortest:?}");
}

fn print(counts: &Counts) {
    for (kind, count) in counts {
        println!("  {count:7} {kind}");
    }
}
