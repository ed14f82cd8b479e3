//! Methods that are slower than the frames, and maps of every n-th frame.

use crate::stage::{SMALL, Stage, within};
use dbus::{Fault, Options};
use logbook::SessionReader;

/// Frames of 20 readings, and a mesh so fine that a map takes many times longer than a frame.
fn slow(more: &str) -> Stage {
    let config = SMALL
        .replace("electrodes = 16", "electrodes = 8")
        .replace(
            "[geometry.disc-tank]\n",
            "[geometry.disc-tank]\nfineness = 2.0\n",
        )
        .replace("[survey]\n", "[survey]\nnplc = 0.02\nhalf = true\n");
    let stage = Stage::new(&format!("{config}\n[model]\nmethod = \"tv\"\n{more}"));
    let scene = "[disc-tank]\nelectrodes = 8\n[effects.voltmeter-noise]\nuv = 2.0\n";
    std::fs::write(stage.path().join("scene.toml"), scene).unwrap();
    stage
}

#[tokio::test(flavor = "multi_thread")]
async fn a_method_slower_than_frames_is_refused_at_start() {
    let stage = slow("");
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let refused = daemon
        .manager
        .start_session(&Options::new())
        .await
        .unwrap_err();
    let Fault::Configuration(text) = &refused else {
        panic!("{refused:?}")
    };
    for words in ["total variation takes", "s for a map", "set map_every ="] {
        assert!(text.contains(words), "{words}: {text}");
    }
    // with pauses between frames the method is fast enough
    let slowly = Options::new().with("every_s", 600.0).with("count", 1_u64);
    let session = daemon.start(slowly).await;
    within(session.wait()).await.unwrap();
    assert_eq!(session.frames_durable().await.unwrap(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_method_may_make_a_map_of_every_nth_frame() {
    let stage = slow("map_every = 100000\n");
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("count", 4_u64)).await;
    within(session.wait()).await.unwrap();
    let record = SessionReader::open(session.path().await.unwrap()).unwrap();
    assert_eq!(record.len().unwrap(), 4);
    for sequence in 2..=4 {
        assert!(record.frame(sequence).unwrap().map.is_none());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_second_frame_has_a_map_and_all_are_recorded() {
    let stage = Stage::new(&format!("{SMALL}\n[model]\nmap_every = 2\n"));
    let daemon = stage.start().await;
    daemon.baseline(2).await;
    let session = daemon.start(Options::new().with("count", 5_u64)).await;
    within(session.wait()).await.unwrap();
    let record = SessionReader::open(session.path().await.unwrap()).unwrap();
    let with_map: Vec<u64> = (1..=5)
        .filter(|sequence| record.frame(*sequence).unwrap().map.is_some())
        .collect();
    assert_eq!(with_map, [1, 3, 5]);
}
