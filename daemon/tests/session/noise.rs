//! The noise that sets a method's regularisation is measured on the baseline; a configured one that contradicts it is
//! reported.

use dbus::{Fault, Options};
use logbook::SessionReader;

use crate::stage::{SMALL, Stage, within};

/// Scene with the noise of the voltmeter's table: 0.1 mV at 0.02 power-line cycles on the 1 V range.
const NOISY: &str = "[disc-tank]\nelectrodes = 16\n[effects.voltmeter-noise]\n";

fn noisy(more: &str) -> Stage {
    let quick = SMALL.replace("[record]", "nplc = 0.02\n[record]");
    let stage = Stage::new(&format!("{quick}{more}"));
    std::fs::write(stage.path().join("scene.toml"), NOISY).unwrap();
    stage
}

/// The noise in a session's configuration, uV, and the largest loss on the unloaded sheet.
async fn untouched(stage: &Stage) -> (f64, f64) {
    let daemon = stage.start().await;
    within(daemon.baseline(10).await.wait()).await.unwrap();
    let session = daemon.start(Options::new().with("count", 1_u64)).await;
    crate::stage::ended(&session).await.unwrap();
    let map = session.latest_map().await.unwrap();
    // the map of an unloaded sheet has no significant loss, at any noise that sets the regularisation
    assert_eq!(map.more.significant, Some(false));
    assert_eq!(map.more.found_x_m, None);
    let noise = map.more.noise.unwrap();
    assert!(map.more.largest_loss.unwrap_or(0.0) <= noise, "{noise}");
    let path = session.path().await.unwrap();
    let header = SessionReader::open(&path).unwrap().header().clone();
    let kept: toml::Table = toml::from_str(&header.config_toml).unwrap();
    let noise_uv = kept["model"]["noise_uv"].as_float().unwrap();
    assert!(daemon.terminate().await.0.success());
    (noise_uv, -map.values.iter().copied().fold(0.0, f64::min))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_method_is_set_by_the_noise_of_its_baseline() {
    let alone = "[model]\nchoose = \"noise\"\n";
    let (noise_uv, loss) = untouched(&noisy(alone)).await;
    assert!((50.0..200.0).contains(&noise_uv), "{noise_uv} uV");
    let (stated, drawn) = untouched(&noisy(&format!("{alone}noise_uv = 2.0\n"))).await;
    assert_eq!(stated, 2.0, "the configuration overrides it");
    assert!(
        loss < 0.5 * drawn,
        "an untouched sheet: {loss} by its own noise, {drawn} by 2 uV"
    );
    // a regularisation chosen for each frame reduces the map of noise alone to almost zero
    let (_, by_frame) = untouched(&noisy("")).await;
    assert!(
        by_frame < 0.5 * loss,
        "{by_frame} with a strength for each frame, {loss} with one for all"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_contradicted_noise_is_a_warning_everywhere() {
    let stage = noisy("[model]\nnoise_uv = 2.0\n");
    let message = stage.run(&["--check"]);
    let message = String::from_utf8_lossy(&message.stdout).into_owned();
    assert!(
        message.contains("warning: model.noise_uv is 2 uV for one reading, the voltmeter"),
        "{message}"
    );
    let daemon = stage.start().await;
    within(daemon.baseline(10).await.wait()).await.unwrap();
    let health = daemon.manager.health().await.unwrap();
    assert_eq!(health.well, Some(false));
    let troubles = health.troubles.unwrap().join("\n");
    assert!(
        troubles.contains("noise: model.noise_uv is 2 uV"),
        "{troubles}"
    );
    let remarks = daemon.manager.baseline().await.unwrap().more.remarks;
    assert!(remarks.unwrap()[0].contains("noise_uv"));
    assert!(daemon.terminate().await.0.success());
    // now the record has a baseline to compare the configured noise with
    let message = stage.run(&["--check"]);
    let message = String::from_utf8_lossy(&message.stdout).into_owned();
    assert!(message.contains(" shows "), "{message}");
}

/// A disc of 60 mm on the tank of 300 mm.
const LOADED: &str = "[disc-tank]\nelectrodes = 16\n[effects.voltmeter-noise]\nuv = 2.0\n[[load]]\nname = \"left behind\"\n\
    shape = \"disc\"\ndiameter_mm = 60.0\nx_mm = 60.0\ny_mm = 0.0\nloss_percent = 80.0\n";

#[tokio::test(flavor = "multi_thread")]
async fn a_baseline_with_a_load_on_the_sheet_is_remarked() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    for _ in 0..2 {
        within(daemon.baseline(3).await.wait()).await.unwrap();
    }
    let empty = daemon.manager.baseline().await.unwrap().more.remarks;
    assert_eq!(empty.unwrap(), Vec::<String>::new());
    assert!(daemon.terminate().await.0.success());
    std::fs::write(stage.path().join("scene.toml"), LOADED).unwrap();
    let daemon = stage.start().await;
    within(daemon.baseline(3).await.wait()).await.unwrap();
    let remarks = daemon.manager.baseline().await.unwrap().more.remarks;
    let remarks = remarks.unwrap();
    let loaded = daemon.manager.baseline_id().await.unwrap();
    let status = daemon.manager.status().await.unwrap();
    assert_eq!(status.baseline_remarks.as_ref(), Some(&remarks));
    let remarks = remarks.join("\n");
    assert!(remarks.contains("against baseline b"), "{remarks}");
    assert!(
        remarks.contains("against a uniform sheet it shows a loss of"),
        "{remarks}"
    );
    assert!(
        remarks.contains("take it off and record again"),
        "{remarks}"
    );
    // the previous baseline still exists
    let listed = daemon.manager.list_sessions(&Options::new()).await.unwrap();
    let before = listed
        .iter()
        .filter(|session| session.kind == "baseline")
        .nth(1)
        .unwrap();
    let used = daemon.manager.use_baseline(&before.id).await.unwrap();
    assert_eq!(used, before.id);
    assert_eq!(daemon.manager.baseline_id().await.unwrap(), before.id);
    // each baseline keeps its own remarks
    let loaded = daemon.manager.baseline_remarks(&loaded).await.unwrap();
    assert_eq!(loaded.join("\n"), remarks);
    let empty = daemon.manager.baseline_remarks(&before.id).await.unwrap();
    assert_eq!(empty, Vec::<String>::new());
    let refused = daemon
        .manager
        .baseline_remarks("nothing")
        .await
        .unwrap_err();
    assert!(matches!(refused, Fault::NoSession(_)), "{refused:?}");
    let refused = daemon.manager.use_baseline("nothing").await.unwrap_err();
    assert!(matches!(refused, Fault::NoSession(_)), "{refused:?}");
}

/// The settings of the method that are stored with a session, and the hash of its configuration.
async fn kept_model(session: &dbus::Session1Proxy<'_>) -> (toml::Table, String) {
    crate::stage::ended(session).await.unwrap();
    let path = session.path().await.unwrap();
    let header = SessionReader::open(&path).unwrap().header().clone();
    let kept: toml::Table = toml::from_str(&header.config_toml).unwrap();
    (
        kept["model"].as_table().unwrap().clone(),
        header.config_hash,
    )
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_keeps_the_method_it_was_started_with() {
    let tv = "[model]\nmethod = \"tv\"\nlambda = 1e-3\nmap_every = 100000\n";
    let stage = Stage::new(&format!("{SMALL}{tv}"));
    let daemon = stage.start().await;
    let baseline = daemon.baseline(3).await;
    let (configured, hash) = kept_model(&baseline).await;
    assert_eq!(configured["method"].as_str(), Some("tv"));

    let one_step = Options::new()
        .with("count", 1_u64)
        .with("model", "one-step");
    let session = daemon.start(one_step).await;
    let (kept, of_session) = kept_model(&session).await;
    let map = session.latest_map().await.unwrap();
    assert!(map.method.starts_with("one-step"), "{}", map.method);
    assert_eq!(kept["method"].as_str(), Some("one-step"));
    // the configured lambda of total variation has another unit and is not kept
    assert!(!kept.contains_key("lambda"), "{kept}");
    assert!(kept["noise_uv"].as_float().unwrap() > 0.0);
    assert_eq!(kept["map_every"], configured["map_every"]);
    assert_ne!(of_session, hash);

    let session = daemon.start(Options::new().with("count", 1_u64)).await;
    let (kept, of_session) = kept_model(&session).await;
    assert_eq!((kept, of_session), (configured, hash));
}
