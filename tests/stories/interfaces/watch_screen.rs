//! `tactus watch` on a terminal of 80 columns and 24 rows.

use rustix::process::Signal;

use super::terminal::Terminal;
use crate::test_rig::{self, Needs, ask, baseline};

const SIZE: [u16; 2] = [80, 24];
const ENTER: &str = "\x1b[?1049h";

/// The rows of the last complete picture.
fn rows(terminal: &Terminal) -> Vec<String> {
    let text = terminal.text();
    let picture = text.rsplit("\x1b[H").next().unwrap_or_default();
    let (picture, _) = picture.split_once("\x1b[J").expect("a complete picture");
    picture.lines().map(str::to_owned).collect()
}

#[test]
fn watch_shows_the_last_map_on_80_by_24_and_leaves_it() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 4);
    ask(&stage, &["start", "--step"]);
    let watch = ["watch", "--colour", "never"];
    let mut empty = Terminal::run(&stage, &watch, SIZE);
    empty.until("waiting for the first frame");
    empty.until("tactus step");
    let (code, text) = empty.end(Signal::INT);
    assert_eq!(code, Some(130), "{text:?}");
    ask(&stage, &["step", "1"]);
    // no further frame follows: the last one is displayed
    let mut terminal = Terminal::run(&stage, &watch, SIZE);
    terminal.until("frame 1");
    terminal.until("\x1b[J");
    let rows = rows(&terminal);
    assert!(
        rows.len() <= usize::from(SIZE[1]) - 2,
        "{} rows: {rows:#?}",
        rows.len()
    );
    assert!(
        rows.iter().any(|row| row.contains("frame 1  [SIMULATED]")),
        "{rows:#?}"
    );
    assert!(rows.iter().any(|row| row.contains("%")), "{rows:#?}");
    let (code, text) = terminal.end(Signal::TERM);
    assert_eq!(code, Some(143), "{text:?}");
    assert!(text.starts_with(ENTER), "{text:?}");
    ask(&stage, &["stop"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}
