//! Live topics of a real daemon: the broker shows what the commands show.

use std::process::Stdio;

use serde_json::Value;

use crate::mosquitto::Mosquitto;
use crate::test_rig::{self, Needs, PRESS_MM, ask, baseline, press};

const RULE: &str =
    "\n[[alarm]]\nname = \"heavy\"\nquantity = \"contact\"\nabove = 100.0\nfor_s = 0.0\n";
/// A catalogue that cannot be reached: live topics do not need it.
const ARCHIVE: &str = "[archive]\nsite = \"berlin\"\ndaq = \"bed3\"\nstore = \"store\"\ndsn = \"host=127.0.0.1 port=1 dbname=a user=b\"\n";

#[test]
fn broker_shows_what_the_commands_show() {
    let Some(broker) = Mosquitto::open() else {
        return;
    };
    let live = format!(
        "[mqtt]\nhost = \"127.0.0.1\"\nport = {}\nevery_s = 1.0\n",
        broker.port()
    );
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        format!("{config}{RULE}{ARCHIVE}{live}")
    }) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    let mut archive = stage
        .command("tactus-archive")
        .args(["run", "--config"])
        .arg(stage.config_path())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the program runs");
    let mut watcher = broker.watch();
    let topic = |name: &str| format!("tactus/1/berlin/bed3/{name}");
    watcher.wait(&topic("status"), |status| status["state"] == "idle");
    baseline(&stage, 3);
    let begun = ask(&stage, &["start", "--every", "500ms"]);
    let id = begun[0]["session"].as_str().expect("its id").to_owned();
    press(&stage, PRESS_MM, 20.0, 0.5);
    let (_, mut alarm) = watcher.wait(&topic("alarm/heavy"), |alarm| alarm["active"] == true);
    let (_, shown) = watcher.wait(&topic("quantities"), |shown| {
        let contact = shown["regions"][0]["values"]["contact"].as_f64();
        shown["session"] == id.as_str() && contact.is_some_and(|contact| contact > 100.0)
    });
    let listed = stage
        .tactus(&["--json", "alarms"])
        .expect("the program runs");
    let listed = listed.stdout.lines();
    let listed = listed.map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    let heavy = listed.into_iter().find(|alarm| alarm["name"] == "heavy");
    let mut heavy = heavy.expect("the rule is listed");
    // the topic states the value at the change, the list that of the last frame
    for cause in [&mut alarm["cause"], &mut heavy["cause"]] {
        let text = cause.take();
        let text = text.as_str().expect("a text");
        assert!(text.starts_with("contact of sheet ") && text.ends_with(", above 100 mm2"));
    }
    assert_eq!(heavy, alarm);
    ask(&stage, &["stop"]);
    watcher.wait(&topic("session"), Value::is_null);
    let keys = |value: &Value| {
        value
            .as_object()
            .expect("an object")
            .keys()
            .cloned()
            .collect::<Vec<_>>()
    };
    let (_, status) = watcher.wait(&topic("status"), |status| status["state"] == "idle");
    let printed = ask(&stage, &["status"]);
    assert_eq!(keys(&status), keys(&printed[0]));
    assert_eq!(keys(&status["health"]), keys(&printed[0]["health"]));
    assert_eq!(status["bus"], printed[0]["bus"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
    watcher.wait(&topic("status"), |status| status["state"] == "offline");
    archive.kill().expect("it runs");
    archive.wait().expect("it has ended");
    // the recorded frame gives the same numbers
    let each = ask(&stage, &["quantities", &id, "--each-frame"]);
    let same = each.iter().find(|frame| frame["frame"] == shown["frame"]);
    let same = same.expect("the frame is recorded");
    assert_eq!(same["regions"][0]["values"], shown["regions"][0]["values"]);
    assert_eq!(same["unit"], shown["unit"]);
    // the time in the table is truncated to microseconds
    let wall = same["wall"].as_str().expect("a time").trim_end_matches('Z');
    assert!(
        shown["wall"]
            .as_str()
            .is_some_and(|live| live.starts_with(wall))
    );
}
