//! The load after every injection, while its frame is measured: `tactus watch --fast` of a real daemon.

use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};

use dbus::{Address, Simulation1Proxy};
use serde_json::Value;
use tactus_tests::Stage;

use crate::test_rig::{self, Needs, ask, baseline, runtime};

/// Ends a hung test: more than a minute of injections.
const MOST_LINES: usize = 20_000;

/// Lines of `watch --fast --json`.
struct Lines {
    program: Child,
    lines: std::io::Lines<BufReader<std::process::ChildStdout>>,
}

impl Lines {
    fn of(stage: &Stage) -> Self {
        let mut program = stage
            .command("tactus")
            .env(
                "TACTUS_BUS",
                format!("unix:{}", stage.peer_path().display()),
            )
            .args(["--json", "watch", "--fast"])
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program runs");
        let lines = BufReader::new(program.stdout.take().expect("its output")).lines();
        Self { program, lines }
    }

    /// The first line with an answer as wanted.
    fn wait(&mut self, wanted: impl Fn(&Value) -> bool) -> Value {
        let mut last = Value::Null;
        for line in self.lines.by_ref().take(MOST_LINES) {
            last = serde_json::from_str(&line.expect("it can be read")).expect("JSON");
            if wanted(&last["after"]) {
                return last;
            }
        }
        panic!("never so; the last line: {last}")
    }
}

fn known(after: &Value) -> bool {
    after["known"] == true
}

#[test]
fn a_load_is_followed_within_the_frame() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 4);
    ask(&stage, &["start"]);
    let mut lines = Lines::of(&stage);
    let empty = lines.wait(|after| known(after) && after["load"].is_null());
    assert_eq!(empty["event"], "injection", "{empty}");
    assert_eq!(empty["simulated"], true, "{empty}");
    let runtime = runtime();
    let hand = runtime.block_on(async {
        let (connection, _) = dbus::connect(Some(&Address::Unix(stage.peer_path())))
            .await
            .expect("the daemon listens");
        Simulation1Proxy::new(&connection).await.expect("a proxy")
    });
    let press = |x_m: f64| {
        let pressed = runtime.block_on(hand.press("disc", x_m, 0.135, 0.030, 0.5));
        pressed.expect("a press");
    };
    press(0.080);
    let seen = lines.wait(|after| known(after) && !after["load"].is_null());
    let away_mm = |line: &Value, truth: f64| {
        let [x, y] = [0, 1].map(|axis| line["after"]["load"]["centre_mm"][axis].as_f64());
        (x.expect("a number") - truth).hypot(y.expect("a number") - 135.0)
    };
    let error = away_mm(&seen, 80.0);
    eprintln!("{error:.2} mm: {seen}");
    assert!(error < 1.0, "{seen}");
    let used = seen["after"]["injections"].as_u64();
    assert!(used.is_some_and(|used| (7..=26).contains(&used)), "{seen}");
    // the frame in which the load came is not complete yet, or has just ended
    press(0.081);
    let moved =
        lines.wait(|after| known(after) && after["load"]["centre_mm"][0].as_f64() > Some(80.7));
    let error = away_mm(&moved, 81.0);
    assert!(error < 1.0, "{moved}");
    runtime.block_on(hand.release()).expect("it is released");
    lines.wait(|after| known(after) && after["load"].is_null());
    ask(&stage, &["stop"]);
    assert!(lines.program.wait().expect("it ends").success());
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}

#[test]
fn sessions_without_injections_say_why() {
    let untracked = |config: &str| config.replace("[model]", "[model]\ntracking = false");
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, untracked) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 2);
    ask(&stage, &["start", "--step"]);
    let refused = stage
        .tactus(&["watch", "--fast"])
        .expect("the program runs");
    assert!(
        refused.stderr.contains("`tracking` in [model]"),
        "{refused:?}"
    );
    ask(&stage, &["stop"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}
