//! `tactus top` on terminals of 80 x 24 and 120 x 40: the map, and an alarm acknowledged by keys.

use rustix::process::Signal;

use super::terminal::Terminal;
use crate::test_rig::{self, Needs, ask, baseline};

/// The contact area of a map without a load is below this limit: the alarm is active from the first frame on.
const RULE: &str =
    "\n[[alarm]]\nname = \"empty\"\nquantity = \"contact\"\nbelow = 100.0\nseverity = \"major\"\n";
const ENTER_KEY: &str = "\r";

#[test]
fn top_shows_the_map_and_acknowledges_an_alarm_by_keys() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        format!("{config}{RULE}")
    }) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 4);
    ask(&stage, &["start", "--every", "300ms"]);
    let alarm = || {
        let listed = stage.tactus(&["--json", "alarms", "--all"]);
        let listed = listed.expect("the program runs").json();
        let found = listed.into_iter().find(|alarm| alarm["name"] == "empty");
        found.expect("it is listed")
    };
    let top = ["top", "--colour", "never"];
    let mut small = Terminal::run(&stage, &top, [80, 24]);
    small.until_shown("Map of frame");
    small.until_shown("SIMULATED");
    small.until_shown("ALARM empty");
    small.until_shown("not a medical device");
    small.keys("?");
    small.until_shown("Keys");
    small.keys("?a");
    small.until_shown("Enter acknowledges");
    // built-in alarms may be listed before the rule: move the selection to its row
    for _ in 0..40 {
        if small.screen().iter().any(|row| row.contains("> empty:")) {
            break;
        }
        small.keys("\x1b[B");
        let before = chosen(&small);
        while chosen(&small) == before {
            small.receive("another alarm");
        }
    }
    small.keys(ENTER_KEY);
    small.until_shown("acknowledge empty? y: yes");
    small.keys("n");
    small.until_shown("Enter acknowledges");
    assert_eq!(alarm()["acknowledged"], false, "another key is no");
    small.keys(ENTER_KEY);
    small.until_shown("acknowledge empty? y: yes");
    small.keys("y");
    small.until_shown("empty is acknowledged");
    let after = alarm();
    assert_eq!(
        (&after["active"], &after["acknowledged"]),
        (&true.into(), &true.into())
    );
    small.keys("q");
    let (code, text) = small.ended();
    assert_eq!(code, Some(0), "{text:?}");

    let mut large = Terminal::run(&stage, &top, [120, 40]);
    large.until_shown("Map of frame");
    large.until_shown("peak of one triangle");
    let (code, text) = large.end(Signal::TERM);
    assert_eq!(code, Some(143), "{text:?}");
    ask(&stage, &["stop"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}

/// The row of the chosen alarm.
fn chosen(terminal: &Terminal) -> Option<String> {
    let screen = terminal.screen();
    let row = screen.into_iter().find(|row| row.contains("\u{2502}> "))?;
    let (_, row) = row.split_once("> ")?;
    row.split(':').next().map(str::to_owned)
}
