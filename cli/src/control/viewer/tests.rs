//! Tests of the viewer with constructed streams.

use crate::control::viewer::*;

fn watch(words: &[&str]) -> Watch {
    use clap::Parser;
    let words = ["tactus", "watch"].iter().chain(words);
    match crate::args::Arguments::try_parse_from(words)
        .unwrap()
        .command
    {
        crate::args::Command::Watch(watch) => watch,
        _ => unreachable!("watch was asked"),
    }
}

fn record(sequence: u64, gap: u64, body: Body) -> Record {
    Record {
        sequence,
        wall_ns: 1_000_000_000 * sequence as i64,
        gap,
        simulated: true,
        body,
    }
}

fn frame(sequence: u64, gap: u64) -> Record {
    let body = Body::Frame {
        volts: vec![-0.25, f64::NAN],
        flags: vec![0, 1],
    };
    record(sequence, gap, body)
}

fn map(sequence: u64) -> Record {
    let body = Body::Map {
        values: vec![-0.5, 0.0],
        mesh_hash: "m".into(),
        method: "one-step".into(),
    };
    record(sequence, 0, body)
}

fn field() -> Field {
    Field::from_bus(&dbus::Geometry {
        mesh_hash: "m".into(),
        nodes: vec![0.0, 0.0, 0.03, 0.0, 0.0, 0.03, 0.03, 0.03],
        triangles: vec![0, 1, 2, 1, 3, 2],
        outline: vec![0.0, 0.0, 0.03, 0.0, 0.03, 0.03, 0.0, 0.03],
        outline_lengths: vec![4],
        electrodes: vec![0.0, 0.0],
        more: dbus::GeometryDetails::default(),
    })
    .unwrap()
}

#[tokio::test]
async fn injections_are_shown_with_their_map_and_counted() {
    let after = |load: serde_json::Value| {
        let known = !load.is_null();
        let text = (!known).then_some("3 injections since the last pause; 7 are needed");
        serde_json::json!({"electrodes": [3, 4], "injections": 13, "known": known, "text": text, "load": load}).to_string()
    };
    let load = serde_json::json!({"centre_mm": [10.0, 10.0], "half_axes_mm": [0.5, 0.2], "angle_deg": 0.0,
        "velocity_mm_s": [3.0, 4.0], "diameter_mm": 20.0, "loss": 0.5});
    let injection = |load| Body::Injection {
        values: vec![-0.5, 0.0],
        json: after(load),
    };
    let records = [
        record(7, 0, injection(serde_json::Value::Null)),
        record(7, 2, injection(load)),
        record(
            8,
            0,
            Body::Injection {
                values: vec![],
                json: "{}".into(),
            },
        ),
    ];
    let words = ["--fast", "--count", "2"];
    let (text, ended) = shown(&words, None, &records).await;
    assert!(matches!(ended, Ok(None)), "{ended:?}");
    let lines: Vec<serde_json::Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(lines.len(), 2, "{text}");
    assert_eq!(lines[1]["gap"], 2);
    assert_eq!(lines[1]["after"]["load"]["velocity_mm_s"][1], 4.0);
    let (text, _) = shown_as(false, &words, Some(field()), &records).await;
    for wanted in [
        "m1 frame 7, after 3-4",
        "not known: 3 injections",
        "a load at (10.0, 10.0) mm within 0.5 mm (95 %), 5.0 mm/s  SIMULATED",
        "2 records were not shown",
    ] {
        assert!(text.contains(wanted), "{wanted}: {text}");
    }
}

#[tokio::test]
async fn deviations_are_lines_that_are_not_counted() {
    let body = Body::Deviation {
        values: vec![0.05, f64::NAN],
        mesh_hash: "m".into(),
    };
    let records = [frame(7, 0), record(7, 0, body), frame(8, 0), frame(9, 0)];
    let words = ["--sd", "--count", "2"];
    let (text, _) = shown(&words, None, &records).await;
    let lines: Vec<serde_json::Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let events: Vec<_> = lines.iter().map(|line| &line["event"]).collect();
    assert_eq!(events, ["frame", "deviation", "frame"], "{text}");
    assert_eq!(lines[1]["deviations"], serde_json::json!([0.05, null]));
    let (text, _) = shown_as(false, &words, None, &records).await;
    let wanted = "median 0.050 over 50 % of the triangles, not known for the others  SIMULATED";
    assert!(text.contains(wanted), "{text}");
}

async fn shown(
    words: &[&str],
    field: Option<Field>,
    records: &[Record],
) -> (String, Result<Option<String>, Failure>) {
    shown_with(true, Some(0.1), words, field, records).await
}

async fn shown_as(
    json: bool,
    words: &[&str],
    field: Option<Field>,
    records: &[Record],
) -> (String, Result<Option<String>, Failure>) {
    shown_with(json, None, words, field, records).await
}

async fn shown_with(
    json: bool,
    noise: Option<f64>,
    words: &[&str],
    field: Option<Field>,
    records: &[Record],
) -> (String, Result<Option<String>, Failure>) {
    let watch = watch(words);
    let mut printer = Printer::into(json, Vec::new());
    let bytes: Vec<u8> = records.iter().flat_map(Record::encode).collect();
    let shown_at = Cell::new(Instant::now());
    let ended = Viewer::new("m1".into(), &watch, field, None, &shown_at, &mut printer)
        .follow(bytes.as_slice(), None, async || noise)
        .await;
    (String::from_utf8(printer.sink()).unwrap(), ended)
}

fn end() -> Record {
    let reason = "count reached".into();
    record(9, 0, Body::End { reason })
}

#[tokio::test]
async fn a_frame_and_its_map_are_one_line() {
    let (text, ended) = shown(&[], Some(field()), &[frame(1, 0), map(1), end()]).await;
    assert_eq!(
        text,
        "{\"event\":\"frame\",\"session\":\"m1\",\"sequence\":1,\"wall\":\"1970-01-01T00:00:01.000000000Z\",\
         \"simulated\":true,\"gap\":0,\"readings\":2,\"overloads\":1,\"not_measured\":0,\
         \"method\":\"one-step\",\"largest_loss\":0.5,\"significant\":true,\"noise\":0.1,\"found_mm\":[10.0,10.0],\
         \"unit\":\"relative loss of conductance\",\"newtons\":null,\"largest_kpa\":null,\"quality\":null,\"tracked\":null,\"quantities\":null}\n"
    );
    assert_eq!(ended.unwrap().as_deref(), Some("count reached"));
}

#[tokio::test]
async fn what_noise_explains_is_not_found() {
    let records = [frame(1, 0), map(1), end()];
    let (text, _) = shown_with(true, Some(0.6), &[], Some(field()), &records).await;
    assert!(
        text.contains("\"largest_loss\":0.5,\"significant\":false,\"noise\":0.6,\"found_mm\":null"),
        "{text}"
    );
    let (text, _) = shown_with(false, Some(0.6), &[], Some(field()), &records).await;
    assert!(text.contains("nothing above the noise (60 %)"), "{text}");
    assert!(
        !text.contains("found") && !text.contains("hot spot"),
        "{text}"
    );
}

fn pressure(sequence: u64) -> Record {
    let body = Body::Pressure {
        kpa: vec![12.5, 0.0],
        newtons: 5.625,
    };
    record(sequence, 0, body)
}

#[tokio::test]
async fn with_a_calibration_everything_is_in_kilopascals_and_newtons() {
    let records = [frame(1, 0), pressure(1), map(1), end()];
    let (text, _) = shown_as(false, &[], Some(field()), &records).await;
    assert!(
        text.contains("5.6 N, largest pressure 12.5 kPa") && text.contains("pressure\n"),
        "{text}"
    );
    assert!(!text.contains("loss") && !text.contains(" %"), "{text}");
    let (text, _) = shown(&[], Some(field()), &records).await;
    assert!(
        text.contains("\"unit\":\"kPa\",\"newtons\":5.625,\"largest_kpa\":12.5,\"quality\":null,\"tracked\":null,\"quantities\":null}"),
        "{text}"
    );
    // a pressure of another frame is ignored
    let records = [pressure(1), frame(2, 0), map(2), end()];
    let (text, _) = shown(&[], Some(field()), &records).await;
    assert!(text.contains("\"newtons\":null"), "{text}");
}

#[tokio::test]
async fn without_a_calibration_nothing_is_in_kilopascals() {
    let (text, _) = shown_as(false, &[], Some(field()), &[frame(1, 0), map(1), end()]).await;
    assert!(
        text.contains("largest relative loss of conductance 0.500")
            && text.contains("relative loss of conductance\n"),
        "{text}"
    );
    assert!(!text.contains("kPa") && !text.contains(" N,"), "{text}");
}

#[tokio::test]
async fn gaps_and_frames_without_a_map_are_shown() {
    let (text, _) = shown(
        &[],
        Some(field()),
        &[frame(1, 0), frame(5, 7), map(5), end()],
    )
    .await;
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 2);
    assert!(
        lines[0].contains("\"sequence\":1,") && lines[0].contains("\"method\":null"),
        "{text}"
    );
    assert!(
        lines[1].contains("\"sequence\":5,") && lines[1].contains("\"gap\":7,"),
        "{text}"
    );
}

#[tokio::test]
async fn a_map_whose_frame_was_lost_is_shown_alone() {
    let (text, _) = shown(&[], Some(field()), &[map(4), end()]).await;
    assert!(
        text.contains("\"sequence\":4,") && text.contains("\"readings\":0,"),
        "{text}"
    );
}

#[tokio::test]
async fn watch_ends_after_count_frames() {
    let records = [frame(1, 0), frame(2, 0), frame(3, 0), end()];
    let (text, ended) = shown(&["--count", "2"], None, &records).await;
    assert_eq!(text.lines().count(), 2);
    assert_eq!(ended.unwrap(), None);
}

#[tokio::test]
async fn lost_daemon_is_reported() {
    let (text, ended) = shown(&[], Some(field()), &[frame(1, 0)]).await;
    assert_eq!(
        text.lines().count(),
        1,
        "the frame that waited for its map is not lost"
    );
    assert_eq!(ended.unwrap_err().code(), 3);
}

#[tokio::test(start_paused = true)]
async fn a_frame_is_not_held_back_for_a_map_that_does_not_come() {
    let watch = watch(&["--count", "1"]);
    let mut printer = Printer::into(true, Vec::new());
    let (mut daemon, client) = tokio::io::duplex(1024);
    tokio::io::AsyncWriteExt::write_all(&mut daemon, &frame(1, 0).encode())
        .await
        .unwrap();
    let shown_at = Cell::new(Instant::now());
    let mut viewer = Viewer::new(
        "m1".into(),
        &watch,
        Some(field()),
        None,
        &shown_at,
        &mut printer,
    );
    let ended = viewer.follow(client, None, async || None).await;
    assert_eq!(ended.unwrap(), None);
    assert_eq!(
        printer.sink().iter().filter(|&&byte| byte == b'\n').count(),
        1
    );
}
