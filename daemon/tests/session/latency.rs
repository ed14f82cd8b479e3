//! Latency from the last reading to the record and the signal, at the paper's size.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::stage::{Stage, within};
use dbus::Options;

const PAPER: &str = r#"
[rig]
profile = "PROFILE"
[record]
directory = "state"
[bus]
peer_path = "run/peer"
"#;

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_is_durable_before_its_signal() {
    let stage = Stage::new(PAPER);
    let daemon = stage.start().await;
    daemon.baseline(2).await;
    let session = daemon
        .start(Options::new().with("every_s", 0.25).with("count", 10_u64))
        .await;
    let mut signals = session.receive_frame_done().await.unwrap();
    let mut took = Vec::new();
    let ended = session.wait();
    let mut ended = std::pin::pin!(ended);
    // a frame every 250 ms: summaries are sent at least 200 ms apart, so that none is delayed. A machine that is too
    // slow skips some frames
    loop {
        let signal = tokio::select! {
            biased;
            signal = within(dbus::next(&mut signals)) => signal.unwrap(),
            _ = &mut ended => break,
        };
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
        let arguments = signal.args().unwrap();
        let on_disk = session.frames_durable().await.unwrap();
        assert!(
            on_disk >= arguments.sequence,
            "frame {} was said, {on_disk} are on disk",
            arguments.sequence
        );
        let duration_s = arguments.summary.quality.duration_s.unwrap();
        let last_reading =
            Duration::from_nanos(arguments.wall_ns as u64) + survey::duration(duration_s);
        took.push(now.saturating_sub(last_reading));
    }
    assert!(!took.is_empty(), "no frame was said");
    took.sort();
    let median = took[took.len() / 2];
    let durable: Vec<u64> = {
        let (_, log) = daemon.terminate().await;
        let mut us: Vec<u64> = log
            .lines()
            .filter_map(|line| {
                line.split("us=")
                    .nth(1)?
                    .split_whitespace()
                    .next()?
                    .parse()
                    .ok()
            })
            .collect();
        us.sort_unstable();
        us
    };
    println!(
        "last reading to signal: median {median:?} of {took:?}; to durable record {durable:?} us"
    );
}
