//! A recording as the source of frames: sessions and records are the same as with a rig.

use std::fmt::Write;

use crate::stage::{SMALL, Stage, within};
use dbus::{Fault, Options};
use logbook::SessionReader;
use survey::Protocol;

const PLAYED: &str = r#"
[rig]
kind = "recording"
[recording]
case = "case"
frames = "frames.csv"
baseline = "first:2"
negate = true
frames_per_s = 1000.0
[geometry]
preset = "disc-tank"
[record]
directory = "state"
[bus]
peer_path = "run/peer"
"#;

/// A case folder of 16 electrodes without a mesh, with magnitudes that fit a disc well enough to be reconstructed.
fn stage(config: &str, frames: usize) -> Stage {
    let stage = Stage::new(config);
    let folder = stage.path().join("case");
    std::fs::create_dir(&folder).unwrap();
    let protocol = Protocol::sheffield(16).unwrap();
    let mut text = String::from("meas,source,sink,v_plus,v_minus\n");
    let mut magnitudes = Vec::new();
    for (reading, measurement) in protocol.measurements().iter().enumerate() {
        let [a, b, c, d] = [
            measurement.drive.plus,
            measurement.drive.minus,
            measurement.sense.plus,
            measurement.sense.minus,
        ];
        writeln!(text, "{reading},{},{},{},{}", a.0, b.0, c.0, d.0).unwrap();
        // logarithm of the distance between two electrodes on the edge of a disc, from which the voltages follow
        let chord = |p: survey::Electrode, q: survey::Electrode| {
            (std::f64::consts::PI * (p.0 as f64 - q.0 as f64) / 16.0)
                .sin()
                .abs()
                .ln()
        };
        magnitudes.push((chord(a, d) + chord(b, c) - chord(a, c) - chord(b, d)).abs());
    }
    std::fs::write(folder.join("protocol.csv"), text).unwrap();
    let mut csv = String::new();
    for frame in 0..frames {
        let row: Vec<String> = magnitudes
            .iter()
            .enumerate()
            .map(|(reading, volts)| {
                (volts * (1.0 + 1e-3 * ((frame * reading) % 3) as f64)).to_string()
            })
            .collect();
        writeln!(csv, "{}", row.join(",")).unwrap();
    }
    std::fs::write(folder.join("frames.csv"), csv).unwrap();
    stage
}

#[tokio::test(flavor = "multi_thread")]
async fn a_played_recording_is_recorded_and_can_be_played_again() {
    let first = stage(PLAYED, 12);
    let daemon = first.start().await;
    assert_eq!(daemon.manager.source().await.unwrap(), "recording");
    assert!(!daemon.manager.simulated().await.unwrap());
    assert_eq!(daemon.manager.baseline_id().await.unwrap(), "recording");
    let refused = daemon.manager.plan().await.unwrap_err();
    assert!(matches!(refused, Fault::Unsupported(_)), "{refused:?}");
    let session = daemon.start(Options::new()).await;
    let reason = crate::stage::ended(&session).await.unwrap();
    assert_eq!(reason, "the recording is over");
    assert_eq!(session.frames_durable().await.unwrap(), 12);
    let frame = session.latest_frame().await.unwrap();
    assert!(frame.volts.iter().all(|volts| *volts < 0.0), "negated");
    let map = session.latest_map().await.unwrap();
    let path = session.path().await.unwrap();
    let record = SessionReader::open(&path).unwrap();
    assert_eq!(record.len().unwrap(), 12);
    let kept: toml::Table = toml::from_str(&record.header().config_toml).unwrap();
    let noise_uv = kept["model"]["noise_uv"].as_float().unwrap();
    assert!(
        noise_uv > 2.0,
        "two baseline frames that differ by a thousandth: {noise_uv}"
    );
    assert_eq!(
        kept["survey"]["current_ua"].as_float(),
        Some(1e6),
        "a case without currents is taken as measured at 1 A"
    );
    assert!(daemon.terminate().await.0.success());

    let config = PLAYED
        .replace("case = \"case\"", &format!("session = \"{path}\""))
        .replace("frames = \"frames.csv\"\nbaseline = \"first:2\"\nnegate = true\nframes_per_s = 1000.0\n", "speed = 0.0\n");
    let again = Stage::new(&config);
    let daemon = again.start().await;
    let session = daemon.start(Options::new().with("step", true)).await;
    assert_eq!(within(session.step(5)).await.unwrap(), 5);
    // more frames than available were requested: the session ends with the recording
    assert_eq!(within(session.step(50)).await.unwrap(), 12);
    let same = crate::stage::map_of(&session, 12).await;
    assert_eq!(
        same.values, map.values,
        "the same map from the record, to the bit"
    );
}

#[test]
fn a_wrong_column_count_names_file_and_line() {
    let stage = stage(PLAYED, 3);
    let frames = stage.path().join("case/frames.csv");
    let text = std::fs::read_to_string(&frames).unwrap();
    let mut lines: Vec<&str> = text.lines().collect();
    let short = lines[1].rsplit_once(',').unwrap().0;
    lines[1] = short;
    std::fs::write(&frames, lines.join("\n")).unwrap();
    let output = stage.run(&["--check"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(78));
    assert!(
        message.contains("frames.csv")
            && message.contains('2')
            && message.contains("recording.frames"),
        "{message}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rig_after_a_recording_has_its_own_last_baseline() {
    let stage = stage(PLAYED, 4);
    stage.configure(SMALL);
    let daemon = stage.start().await;
    let of_rig = daemon.baseline(2).await.id().await.unwrap();
    for (config, baseline) in [(PLAYED, "recording"), (SMALL, of_rig.as_str())] {
        stage.configure(config);
        within(daemon.manager.reload()).await.unwrap();
        assert_eq!(daemon.manager.baseline_id().await.unwrap(), baseline);
    }
}
