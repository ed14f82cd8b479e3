//! Conversion of loss to pressure: only with a calibration for this method and this mesh.

use crate::stage::{SMALL, Stage, within};
use dbus::stream::{Body, Decoder};
use dbus::{Fault, Options, Session1Proxy};
use imaging::quantities::{FrameQuantities, Quantity};
use tokio::io::AsyncReadExt;

fn calibration(mesh: &str, method: &str) -> String {
    format!(
        "kind = \"tactus-calibration-1\"\nmesh = \"{mesh}\"\nmethod = \"{method}\"\nloss = [0.01, 0.5, 1.0]\nkpa = [0.0, 25.0, 100.0]\n\
         frame = [0.0, 0.0, 0.1, 0.1]\ngain = [0.0, 0.0, 0.0, 0.0, 0.0]\npresses = 12\nrms = 0.1\n"
    )
}

#[tokio::test(flavor = "multi_thread")]
async fn a_calibrated_method_reports_newtons() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(2).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    within(session.step(1)).await.unwrap();
    let map = crate::stage::map_of(&session, 1).await;
    assert_eq!(map.unit, "relative change of conductance");
    assert_eq!(map.more.newtons, None);
    match session.latest_pressure().await.unwrap_err() {
        Fault::Unsupported(why) => assert!(why.contains("tactus-lab calibrate"), "{why}"),
        other => panic!("{other:?}"),
    }
    within(session.stop()).await.unwrap();
    daemon.terminate().await;

    // the calibration of another mesh is rejected before anything moves
    let with = SMALL.replace(
        "[survey]",
        "[model]\ncalibration = \"sheet.toml\"\n[survey]",
    );
    stage.configure(&with);
    let file = stage.path().join("sheet.toml");
    std::fs::write(&file, calibration("another", &map.method)).unwrap();
    let checked = stage.run(&["--check"]);
    let message = String::from_utf8_lossy(&checked.stderr).into_owned();
    assert_eq!(checked.status.code(), Some(78), "{message}");
    assert!(
        message.contains("sheet.toml") && message.contains("fitted on mesh"),
        "{message}"
    );
    std::fs::write(&file, calibration(&map.mesh_hash, "total variation")).unwrap();
    let checked = stage.run(&["--check"]);
    let message = String::from_utf8_lossy(&checked.stderr).into_owned();
    assert!(message.contains("maps of 'total variation'"), "{message}");

    std::fs::write(&file, calibration(&map.mesh_hash, &map.method)).unwrap();
    let daemon = stage.start().await;
    let press = daemon.simulation().await;
    press.press("disc", 0.06, 0.02, 0.05, 0.8).await.unwrap();
    let session = daemon.start(Options::new().with("step", true)).await;
    let mut stream = opened(
        &session,
        Options::new().with("pressure", true).with("quality", true),
    )
    .await;
    let mut plain = opened(&session, Options::new()).await;
    within(session.step(1)).await.unwrap();
    let (map, pressure) = (
        crate::stage::map_of(&session, 1).await,
        session.latest_pressure().await.unwrap(),
    );
    assert_eq!(pressure.sequence, map.sequence);
    assert_eq!(pressure.kpa.len(), map.values.len());
    // each triangle follows the curve of the calibration file
    for (kpa, value) in pressure.kpa.iter().zip(&map.values) {
        let loss = -value;
        let wanted = match loss {
            loss if loss < 0.01 => 0.0,
            loss if loss < 0.5 => 25.0 * (loss - 0.01) / 0.49,
            loss => 25.0 + 150.0 * (loss - 0.5),
        };
        assert!((kpa - wanted).abs() < 1e-9, "{loss}: {kpa}, not {wanted}");
    }
    assert!(pressure.newtons > 1.0, "{} N", pressure.newtons);
    assert_eq!(map.more.newtons, Some(pressure.newtons));
    assert!(map.more.quality.is_some(), "{:?}", map.more);
    let latest = session.quantities().await.unwrap();
    assert_eq!(
        (latest.sequence, Some(&latest.json)),
        (map.sequence, map.more.quantities.as_ref())
    );
    let quantities: FrameQuantities = serde_json::from_str(&latest.json).unwrap();
    let load = quantities.regions[0].values.get(Quantity::Load).unwrap();
    assert!((load - pressure.newtons).abs() < 1e-9, "{load} N");
    let took = map.more.reconstruction_s.unwrap();
    let whole = map.more.durable_s.unwrap();
    assert!(0.0 < took && took < whole, "{took} of {whole} s");
    within(session.stop()).await.unwrap();
    // on request, the stream sends the pressure before its map
    let reported = within(kinds(&mut stream)).await;
    assert_eq!(
        reported,
        ["frame", "pressure", "quality", "quantities", "map", "end"]
    );
    let reported = within(kinds(&mut plain)).await;
    assert_eq!(reported, ["frame", "map", "end"]);
}

async fn opened(session: &Session1Proxy<'_>, options: Options) -> tokio::net::UnixStream {
    let descriptor = session.open_stream(&options).await.unwrap();
    let stream = std::os::unix::net::UnixStream::from(std::os::fd::OwnedFd::from(descriptor));
    stream.set_nonblocking(true).unwrap();
    tokio::net::UnixStream::from_std(stream).unwrap()
}

async fn kinds(stream: &mut tokio::net::UnixStream) -> Vec<&'static str> {
    let (mut bytes, mut decoder, mut kinds) = (Vec::new(), Decoder::new(), Vec::new());
    stream.read_to_end(&mut bytes).await.unwrap();
    decoder.push(&bytes);
    while let Some(record) = decoder.next_record().unwrap() {
        kinds.push(match record.body {
            Body::Frame { .. } => "frame",
            Body::Map { .. } => "map",
            Body::Pressure { .. } => "pressure",
            Body::Quality { .. } => "quality",
            Body::Tracked { .. } => "tracked",
            Body::Quantities { .. } => "quantities",
            Body::Injection { .. } => "injection",
            Body::Deviation { .. } => "deviation",
            Body::End { .. } => "end",
        });
    }
    kinds
}
