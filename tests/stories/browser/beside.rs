//! Additions of the page to the daemon's maps: a provisional map while a slow method computes, and the uncertainty,
//! live and in playback.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};

use super::driver::Browser;
use super::live_page::Page;
use super::playback::exact;
use crate::test_rig::{self, Needs, PRESS_MM, ask, baseline, press};

/// Pixels of the map that have the colour of the uncertainty's lines.
const LINES: &str = "(() => { map.draw(); const { width, height } = map.canvas; \
    const pixels = new Uint32Array(map.canvas.getContext('2d').getImageData(0, 0, width, height).data.buffer); \
    return pixels.filter(pixel => pixel === LINE_COLOUR).length; })()";

fn number(browser: &Browser, expression: &str) -> f64 {
    let value = browser.value(expression);
    value
        .as_f64()
        .unwrap_or_else(|| panic!("{expression}: {value}"))
}

/// The uncertainty that is shown: lines on the map, a legend, a table, and the line below the map.
fn uncertainty_is_shown(browser: &Browser) {
    let wide = number(browser, "map.deviations.length");
    assert_eq!(wide, number(browser, "map.values.length"));
    assert!(number(browser, LINES) > 1000.0);
    let legend = browser.value("byId('uncertainty-legend').innerText");
    let legend = legend.as_str().expect("text");
    assert!(
        legend.contains("standard deviation of ln conductance"),
        "{legend}"
    );
    // the uncertainty is larger in the middle of the sheet than near the electrodes
    let mean = |near: &str| {
        number(
            browser,
            &format!(
                "(() => {{ const {{ nodes, triangles }} = map.geometry; const centre = [0, 1].map(axis => (map.low[axis] + map.high[axis]) / 2); \
                 const here = [...map.deviations].filter((sd, t) => {{ const [x, y] = [0, 1].map(axis => [0, 1, 2].reduce((sum, k) => \
                 sum + nodes[2 * triangles[3 * t + k] + axis], 0) / 3); const away = Math.hypot(x - centre[0], y - centre[1]); \
                 return !Number.isNaN(sd) && {near}; }}); return here.reduce((sum, sd) => sum + sd, 0) / here.length; }})()"
            ),
        )
    };
    let (middle, rim) = (mean("away < 25"), mean("away > 75"));
    assert!(middle > rim, "{middle} in the middle, {rim} at the rim");
    browser.value("byId('uncertainty-as-table').open = true");
    browser.until("byId('uncertainty-table').rows.length === 7");
    let cells = browser
        .value("[...byId('uncertainty-table').rows].slice(1).flatMap(row => [...row.cells].slice(1).map(cell => cell.textContent))");
    let cells = cells.as_array().expect("cells");
    let known = cells.iter().filter_map(|cell| cell.as_str());
    let known = known
        .filter(|text| text.parse::<f64>().is_ok_and(|sd| sd > 0.0) || *text == "in part unknown");
    assert!(known.count() > 20, "{cells:?}");
}

/// A new session may have begun after the page received its state.
fn uncertainty_of_another_session_is_refused(browser: &Browser) {
    let words = browser.asynchronous(
        "const done = arguments[0], usual = unpacked; \
         unpacked = async answer => { const found = await usual(answer); found.head.session = 'another'; return found; }; \
         uncertainty.load().then(() => 'shown', error => error.message).then(words => { unpacked = usual; done(words); });",
    );
    assert_eq!(words, "another session runs now");
}

/// Limits a process to a tenth of the time until this is dropped.
struct Slowed {
    over: Arc<AtomicBool>,
    pulses: Option<JoinHandle<()>>,
}

impl Slowed {
    fn begin(id: u32) -> Self {
        let pid = i32::try_from(id).ok().and_then(Pid::from_raw);
        let pid = pid.expect("the number of a process");
        let over = Arc::new(AtomicBool::new(false));
        let until = Arc::clone(&over);
        let pulses = std::thread::spawn(move || {
            while !until.load(Ordering::Relaxed) {
                for (signal, ms) in [(Signal::STOP, 180), (Signal::CONT, 20)] {
                    kill_process(pid, signal).expect("the daemon runs");
                    std::thread::sleep(Duration::from_millis(ms));
                }
            }
        });
        Self {
            over,
            pulses: Some(pulses),
        }
    }
}

impl Drop for Slowed {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        let ended = self.pulses.take().map(JoinHandle::join);
        if !std::thread::panicking() {
            ended.transpose().expect("the daemon runs");
        }
    }
}

#[test]
fn a_slow_map_follows_a_provisional_one_in_a_browser() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        config.replace("method = \"one-step\"", "method = \"tv\"")
    }) else {
        return;
    };
    let profile = stage.path().join("browser");
    let Some(browser) = Browser::start(&profile, 1500, 1300) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    press(&stage, PRESS_MM, 30.0, 0.5);
    let page = Page::serve(&stage, &[]);
    browser.open(&page.url);
    browser.value("location.reload()");
    browser.until("typeof map !== 'undefined' && latest !== null");
    browser.value(
        // centre of the triangles above half of the largest value
        "window.centre = values => { const { nodes, triangles } = map.geometry; const half = 0.5 * values.reduce((most, value) => Math.max(most, value)); \
         let sum = [0, 0, 0]; values.forEach((value, t) => { if (value > half) for (const k of [0, 1, 2]) { const n = 2 * triangles[3 * t + k]; \
         sum = [sum[0] + nodes[n], sum[1] + nodes[n + 1], sum[2] + 1]; } }); return [sum[0] / sum[2], sum[1] / sum[2]]; }, window.shownMaps = [], window.verdicts = new Set(), window.showWords = showVerdict, showVerdict = frame => { \
         showWords(frame); verdicts.add(byId('verdict').textContent); }, window.set = map.setMap.bind(map), map.setMap = (...all) => { const [values, frame] = all; \
         shownMaps.push({ sequence: frame.sequence, provisional: frame.provisional, method: frame.method, centre: centre(values) }); set(...all); }, 0",
    );
    ask(&stage, &["start", "--step"]);
    // slow the daemon down, so that even on a busy machine its map takes several times as long as the provisional one
    // of the page's server; both are awaited before the next frame
    let slowed = Slowed::begin(daemon.id());
    let pair = "shownMaps.map(first => [first, shownMaps.find(second => second.sequence === first.sequence && !second.provisional)]) \
        .find(([first, second]) => first.provisional && second)";
    let both = (1..=10).any(|frame| {
        ask(&stage, &["step"]);
        browser.until(&format!(
            "shownMaps.some(map => map.sequence === {frame} && !map.provisional)"
        ));
        browser.value(&format!("{pair} !== undefined")) == true
    });
    assert!(both, "{}", browser.value("shownMaps"));
    drop(slowed);
    let found = browser.value(pair);
    let (first, second) = (&found[0], &found[1]);
    let words = first["provisional"].as_str().expect("text");
    assert!(words.starts_with("provisional: one-step"), "{words}");
    let verdicts = browser.value("[...verdicts]");
    let verdicts = verdicts.as_array().expect("texts");
    assert!(verdicts.contains(&first["provisional"]), "{verdicts:?}");
    let mut own = verdicts.iter().filter_map(|text| text.as_str());
    assert!(
        own.any(|text| text.starts_with("known to be true")),
        "{verdicts:?}"
    );
    assert_ne!(second["method"], first["method"], "{found}");
    for shown in [first, second] {
        let [x, y] = [0, 1].map(|axis| shown["centre"][axis].as_f64().expect("mm"));
        let away = (x - PRESS_MM[0]).hypot(y - PRESS_MM[1]);
        assert!(away < 15.0, "{away} mm from the press: {shown}");
    }
    let pictures = Path::new(env!("CARGO_TARGET_TMPDIR"));

    browser.value("byId('uncertainty').click(), 0");
    browser.until("uncertainty.of !== null");
    uncertainty_is_shown(&browser);
    uncertainty_of_another_session_is_refused(&browser);
    browser.value("byId('uncertainty').scrollIntoView({ block: 'center' }), 0");
    browser.screenshot(&pictures.join("uncertainty-live.png"));
    let live = browser.value("[uncertainty.of.sequence, ...map.deviations]");
    ask(&stage, &["stop"]);
    browser.until("byId('session').textContent === 'no session runs'");
    browser.value("uncertainty.refresh(), 0");
    browser.until(
        "byId('uncertainty-legend').textContent === 'Uncertainty not known: no session runs'",
    );
    assert_eq!(number(&browser, LINES), 0.0);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));

    browser.value("document.querySelector('nav a').click(), 0");
    browser
        .until("location.pathname === '/playback' && session && course && course.progress === 1");
    let sequence = live[0].as_u64().expect("a frame");
    exact(&browser, sequence);
    browser.value("byId('uncertainty').click(), 0");
    browser.until(&format!(
        "uncertainty.of && uncertainty.of.sequence === {sequence}"
    ));
    uncertainty_is_shown(&browser);
    browser.screenshot(&pictures.join("uncertainty-playback.png"));
    // the same frame and baseline give the same uncertainty
    let played = browser.value("[uncertainty.of.sequence, ...map.deviations]");
    assert_eq!(live, played);
    exact(&browser, 1);
    browser.until("uncertainty.of && uncertainty.of.sequence === 1");
    browser.value("byId('uncertainty').click(), 0");
    assert_eq!(number(&browser, LINES), 0.0);
    drop(page);
}
