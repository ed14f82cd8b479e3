//! The uploader and the server are killed at random moments: nothing is lost or duplicated.

use std::collections::BTreeSet;
use std::process::Stdio;
use std::time::{Duration, Instant};

use rustix::process::Signal;

use crate::archive;

/// Number of kills of uploader and server each; `TACTUS_KILLS` sets another number.
fn kills() -> u64 {
    let set = std::env::var("TACTUS_KILLS").ok();
    set.map_or(20, |count| count.parse().expect("TACTUS_KILLS is a number"))
}

/// A fraction of one, different at each call.
fn random(state: &mut u64) -> f64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state as f64 / u64::MAX as f64
}

#[test]
fn kills_of_both_ends_lose_and_double_nothing() {
    let Some((mut server, site)) = archive("berlin") else {
        return;
    };
    let began = Instant::now();
    site.record_session("m0", 2);
    site.done(&["push"]);
    let whole = began.elapsed().as_secs_f64();
    let (mut state, mut interrupted) = (0x9e37_79b9_7f4a_7c15, 0);
    let (mut sessions, mut parts) = (1, 2);
    for round in 0..2 * kills() {
        site.record_session(&format!("m{}", round + 1), 2);
        (sessions, parts) = (sessions + 1, parts + 2);
        let mut push = site.command(&["push"]);
        let mut push = push
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_micros(
            (1.2e6 * whole * random(&mut state)) as u64,
        ));
        match round % 2 {
            0 => {
                let _ = push.kill();
                interrupted += u64::from(!push.wait().unwrap().success());
            }
            _ => {
                server.kill(Signal::KILL);
                interrupted += u64::from(!push.wait().unwrap().success());
                server.resume();
            }
        }
    }
    let before: u64 = server
        .sql("SELECT count(*) FROM tactus.part")
        .parse()
        .unwrap();
    site.done(&["push"]);
    println!(
        "{} kills of each end, {interrupted} of {} pushes interrupted, {before} of {parts} parts there before the last push",
        kills(),
        2 * kills()
    );
    assert!(
        interrupted > kills() / 20,
        "{interrupted} pushes were interrupted: the kills come too late"
    );
    let counts = "SELECT (SELECT count(*) FROM tactus.session), (SELECT count(*) FROM tactus.part), (SELECT sum(frames) FROM tactus.part),
        (SELECT count(*) FROM tactus.event WHERE kind = 'note'), (SELECT count(*) FROM tactus.alarm), (SELECT count(*) FROM tactus.quantity),
        (SELECT count(*) FROM tactus.session_summary WHERE complete)";
    let expected = [
        sessions,
        parts,
        3 * parts,
        3 * parts,
        parts,
        3 * parts,
        sessions,
    ];
    assert_eq!(
        server.sql(counts),
        expected.map(|count| count.to_string()).join("|")
    );
    // the store contains exactly the parts of the catalogue, intact, and no unfinished files
    site.done(&["verify"]);
    let listed = server.sql("SELECT stored_as FROM tactus.part");
    let listed: BTreeSet<_> = listed.lines().map(|name| site.store().join(name)).collect();
    assert_eq!(listed, site.stored().into_iter().collect());
    let unconfirmed = std::fs::read_dir(site.record())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|end| end == "tactus"))
        .filter(|path| logbook::archived(path).is_none());
    assert_eq!(unconfirmed.count(), 0);
}
