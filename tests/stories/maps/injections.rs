//! The load after every injection, while its frame is measured: `tactus watch --fast` of a real daemon.

use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use dbus::{Address, Simulation1Proxy};
use serde_json::Value;
use tactus_tests::Stage;

use crate::test_rig::{self, Needs, ask, baseline, runtime};

/// Ends a hung test.
const LIMIT: Duration = Duration::from_secs(90);

/// Lines of `watch --fast --json`.
struct Lines {
    program: Child,
    lines: Receiver<Value>,
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
        let printed = BufReader::new(program.stdout.take().expect("its output"));
        let (to, lines) = channel();
        std::thread::spawn(move || {
            for line in printed.lines() {
                let line = line.expect("it can be read");
                let line = serde_json::from_str(&line).expect("JSON");
                if to.send(line).is_err() {
                    return;
                }
            }
        });
        Self { program, lines }
    }

    /// The first line that satisfies `wanted`.
    fn wait(&mut self, wanted: impl Fn(&Value) -> bool) -> Value {
        let limit = Instant::now() + LIMIT;
        let mut last = Value::Null;
        while let Ok(line) = self
            .lines
            .recv_timeout(limit.saturating_duration_since(Instant::now()))
        {
            last = line;
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
    // a position that is reported as known is within its 95 % ellipse, or close to it
    let at = |line: &Value, truth_mm: f64| {
        let load = &line["after"]["load"];
        let number = |value: &Value| value.as_f64().expect("a number");
        let [x, y] = [0, 1].map(|axis| number(&load["centre_mm"][axis]));
        let error_mm = (x - truth_mm).hypot(y - 135.0);
        eprintln!("{error_mm:.2} mm: {line}");
        error_mm < 3.0 * number(&load["half_axes_mm"][0])
    };
    press(0.080);
    let seen = lines.wait(|after| known(after) && !after["load"].is_null());
    assert!(at(&seen, 80.0), "{seen}");
    let used = seen["after"]["injections"].as_u64();
    assert!(used.is_some_and(|used| (7..=26).contains(&used)), "{seen}");
    press(0.090);
    let moved =
        lines.wait(|after| known(after) && after["load"]["centre_mm"][0].as_f64() > Some(86.0));
    assert!(at(&moved, 90.0), "{moved}");
    assert!(moved["frame"].as_u64() >= seen["frame"].as_u64(), "{moved}");
    runtime.block_on(hand.release()).expect("it is released");
    lines.wait(|after| known(after) && after["load"].is_null());
    ask(&stage, &["stop"]);
    assert!(lines.program.wait().expect("it ends").success());
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}

#[test]
fn sessions_without_injections_give_the_reason() {
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
