//! Setup of the stories: a temporary rig, or the reason why the rig is unsuitable.

use std::path::Path;

use dbus::{Address, Session1Proxy, Simulation1Proxy};
use survey::Amps;
use tactus_tests::{DaemonProcess, SIMULATED, Stage};

/// Requirements of a story.
#[derive(Debug, Clone, Copy)]
pub struct Needs {
    /// A sheet that programs can press (or a fault that they can cause).
    pub simulated: bool,
    /// The largest current of the story.
    pub largest_current: Amps,
}

impl Needs {
    /// Any rig, at 1 mA or less.
    pub const ANY: Self = Self {
        simulated: false,
        largest_current: Amps(1e-3),
    };
    /// The simulated sheet, at 1 mA.
    pub const SIMULATED: Self = Self {
        simulated: true,
        largest_current: Amps(1e-3),
    };
}

/// A scene with 2 uV of voltmeter noise.
pub const NOISY: &str = tactus_tests::TWO_MICROVOLTS;
/// A scene without effects.
pub const QUIET: &str = "seed = 1\n";

/// A temporary rig, or `None` with the reason printed.
pub fn set(needs: Needs, scene: &str) -> Option<Stage> {
    set_with(needs, scene, |config| config.to_owned())
}

/// Like [`set`], with changes to the simulated rig's configuration.
pub fn set_with(needs: Needs, scene: &str, adjust: impl FnOnce(&str) -> String) -> Option<Stage> {
    let config = match std::env::var_os("TACTUS_RIG") {
        None => adjust(SIMULATED),
        Some(_) if needs.simulated => {
            needs::lacking(
                "SIMULATED",
                "this story needs the simulated sheet, TACTUS_RIG names a real rig",
            );
            return None;
        }
        Some(path) => real_rig(Path::new(&path), needs)?,
    };
    let stage = Stage::with_program(&config, env!("CARGO_BIN_EXE_programs"))
        .expect("a temporary folder can be made");
    std::fs::write(stage.path().join("scene.toml"), scene)
        .expect("the story's folder can be written");
    Some(stage)
}

/// The real rig's configuration with record and bus replaced by the story's own.
fn real_rig(path: &Path, needs: Needs) -> Option<String> {
    let text = std::fs::read_to_string(path)
        .unwrap_or_else(|fault| panic!("TACTUS_RIG={}: {fault}", path.display()));
    let mut config: toml::Table = text
        .parse()
        .unwrap_or_else(|fault| panic!("TACTUS_RIG={}: {fault}", path.display()));
    let current_ua = config
        .get("survey")
        .and_then(|survey| survey.get("current_ua"))
        .and_then(|current| {
            current
                .as_float()
                .or(current.as_integer().map(|whole| whole as f64))
        })
        .unwrap_or(1000.0);
    if current_ua * 1e-6 > needs.largest_current.0 * (1.0 + 1e-9) {
        let current = format!(
            "this story drives {} at most, {} asks for {current_ua} uA",
            needs.largest_current,
            path.display()
        );
        needs::lacking("CURRENT", &current);
        return None;
    }
    let own: toml::Table =
        "[record]\ndirectory = \"STAGE/state\"\n[bus]\npeer = true\npeer_path = \"STAGE/peer\"\n"
            .parse()
            .expect("written above");
    config.extend(own);
    Some(config.to_string())
}

/// Starts the daemon and waits until it is ready.
pub fn start(stage: &Stage) -> DaemonProcess {
    stage
        .start_daemon()
        .unwrap_or_else(|fault| panic!("{fault}"))
}

/// Runs `tactus`, which must succeed, and returns its lines of JSON.
pub fn ask(stage: &Stage, args: &[&str]) -> Vec<serde_json::Value> {
    let mut args = args.to_vec();
    args.push("--json");
    let spoken = stage.tactus(&args).and_then(|spoken| spoken.succeeded());
    spoken.unwrap_or_else(|fault| panic!("{fault}")).json()
}

/// The place of most presses, mm.
pub const PRESS_MM: [f64; 2] = [80.0, 135.0];

/// Presses the simulated sheet with a disc at a position, mm; `loss` is the lost share of the conductance.
pub fn press(stage: &Stage, at_mm: [f64; 2], diameter_mm: f64, loss: f64) {
    let [x, y] = at_mm.map(|mm| 1e-3 * mm);
    simulation(stage, async |hand| {
        hand.press("disc", x, y, 1e-3 * diameter_mm, loss).await
    });
}

/// Removes all loads from the simulated sheet.
pub fn release(stage: &Stage) {
    simulation(stage, async |hand| hand.release().await);
}

fn simulation(
    stage: &Stage,
    call: impl AsyncFnOnce(Simulation1Proxy<'_>) -> Result<(), dbus::Fault>,
) {
    runtime().block_on(async {
        let (connection, _) = dbus::connect(Some(&Address::Unix(stage.peer_path())))
            .await
            .expect("the daemon listens");
        let hand = Simulation1Proxy::new(&connection).await.expect("a proxy");
        call(hand).await.expect("the place is on the sheet");
    });
}

/// Records a baseline and waits for it.
pub fn baseline(stage: &Stage, frames: usize) -> Vec<serde_json::Value> {
    ask(
        stage,
        &["baseline", "record", "--frames", &frames.to_string()],
    )
}

/// Starts a session of `count` frames and waits for its end; returns its id.
pub fn measure(stage: &Stage, count: usize) -> String {
    let lines = ask(stage, &["start", "--count", &count.to_string(), "--wait"]);
    lines[0]["session"]
        .as_str()
        .expect("`start` names the session")
        .to_owned()
}

/// The frames of a session as written by `tactus export`: a header, then a row per frame.
pub fn export_csv(stage: &Stage, id: &str) -> String {
    let csv = stage.path().join(format!("{id}.csv"));
    let out = csv.display().to_string();
    ask(
        stage,
        &["export", id, "--format", "csv", "--force", "--out", &out],
    );
    std::fs::read_to_string(csv).expect("the export was written")
}

/// A number of a JSON object, or a panic that shows the object.
pub fn number(value: &serde_json::Value, field: &str) -> f64 {
    value[field]
        .as_f64()
        .unwrap_or_else(|| panic!("no number '{field}' in {value}"))
}

/// A runtime for stories that use D-Bus or instruments directly.
pub fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .expect("a runtime can be built")
}

/// A connection to the daemon's own socket, and a session there.
pub async fn session(peer: &Path, id: &str) -> (zbus::Connection, Session1Proxy<'static>) {
    let (connection, _) = dbus::connect(Some(&Address::Unix(peer.to_owned())))
        .await
        .expect("the daemon listens");
    let session = Session1Proxy::builder(&connection)
        .path(dbus::session_path(id).expect("an id"))
        .build()
        .await
        .expect("a proxy");
    (connection, session)
}

/// The output of `tactusd --check` for a configuration that it refuses with exit code 78.
pub fn refused_by_check(stage: &Stage) -> String {
    let path = stage.config_path().display().to_string();
    let output = stage
        .run("tactusd", &["--config", &path, "--check"])
        .unwrap_or_else(|fault| panic!("{fault}"));
    let text = format!("{}{}", output.stdout, output.stderr);
    assert_eq!(output.code, Some(78), "{text}");
    text
}
