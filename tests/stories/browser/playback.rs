//! Playback of a recorded session on the page: positions of loads, the numbers of the command line, comparison,
//! regions.

use std::path::Path;

use serde_json::Value;

use super::driver::Browser;
use super::live_page::{Page, brightest};
use crate::test_rig::{self, Needs, PRESS_MM, ask, baseline, press};

const REGION_AND_ALARM: &str = "\n[[region]]\nname = \"corner\"\nrectangle_mm = [50.0, 100.0, 110.0, 170.0]\n\
    [[alarm]]\nname = \"pressed\"\nquantity = \"contact\"\nabove = 100.0\nseverity = \"minor\"\n";

/// Waits until the exact map of a frame is shown.
pub(super) fn exact(browser: &Browser, sequence: u64) {
    browser.value(&format!("show('frame', {sequence}), 0"));
    browser.until(&format!(
        "document.body.dataset.sequence === '{sequence}' && document.body.dataset.kind === 'exact'"
    ));
}

#[test]
fn a_session_is_played_in_a_browser() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        format!("{config}{REGION_AND_ALARM}")
    }) else {
        return;
    };
    let profile = stage.path().join("browser");
    let Some(browser) = Browser::start(&profile, 1500, 1300) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let page = Page::serve(&stage, &[]);
    browser.open(&page.url);
    browser.value("location.reload()");
    ask(&stage, &["start", "--every", "300ms"]);
    browser.until("latest && latest.frame && latest.frame.map && latest.frame.sequence > 2");
    press(&stage, PRESS_MM, 30.0, 0.5);
    browser.until("latest.frame.quantities && latest.frame.quantities.spots.length === 1");
    let pressed = browser
        .value("latest.frame.sequence")
        .as_u64()
        .expect("a frame");
    browser.until(&format!("latest.frame.sequence > {pressed} + 2"));
    browser.until("latest.alarms.some(alarm => alarm.name === 'pressed' && alarm.active)");
    ask(&stage, &["stop"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));

    std::fs::write(stage.path().join("state/x.tactus"), "not a session").expect("written");

    // no daemon is needed
    browser.value("document.querySelector('nav a').click(), 0");
    browser
        .until("location.pathname === '/playback' && session && course && course.progress === 1");
    assert_eq!(
        browser.value("session.simulated && !byId('simulated').hidden"),
        true
    );
    let left_out = browser.value("byId('left-out').hidden || byId('left-out').textContent");
    let left_out = left_out.as_str().expect("it is shown");
    assert!(left_out.contains("x.tactus is left out"), "{left_out}");
    let frames = ask(&stage, &["quantities", "last", "--each-frame"]);
    let of = |sequence: u64| -> &Value {
        let frame = frames.iter().find(|frame| frame["frame"] == sequence);
        frame.expect("it is recorded")
    };
    exact(&browser, pressed);
    browser.value("map.draw()");
    let [x, y] = brightest(&browser);
    let away = (x - PRESS_MM[0]).hypot(y - PRESS_MM[1]);
    assert!(away < 15.0, "the map's largest value is {away} mm off");
    for (region, name) in [(0, "load"), (0, "contact"), (1, "ppi"), (1, "dispersion")] {
        let shown = browser.value(&format!(
            "shown.quantities.regions[{region}].values['{name}']"
        ));
        assert_eq!(
            of(pressed)["regions"][region]["values"][name],
            shown,
            "{name}"
        );
    }
    // the rows equal those of the record
    let rows = ask(&stage, &["quantities", "last", "--quantity", "load"]);
    let shown = browser.value(
        "course.rows.filter(row => row.quantity === 'load').map(row => [row.region, row.min, row.mean, row.max, row.frames])",
    );
    let shown = shown.as_array().expect("rows");
    assert_eq!(rows.len(), shown.len());
    for (row, shown) in rows.iter().zip(shown) {
        assert_eq!(row["region"], shown[0]);
        for (place, key) in ["min", "mean", "max", "frames"].iter().enumerate() {
            // JavaScript writes 0.0 as 0
            assert_eq!(row[*key].as_f64(), shown[place + 1].as_f64(), "{key}");
        }
    }

    // the first frame, without load, is compared with the pressed one
    exact(&browser, 1);
    browser.value("byId('compare').click(), 0");
    exact(&browser, pressed);
    browser.until("difference.values !== null && !byId('other').hidden");
    let most = browser.value("difference.values.reduce((most, v) => Math.max(most, v), 0)");
    assert!(most.as_f64().is_some_and(|most| most > 0.2), "{most}");
    browser.screenshot(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("playback-page.png"));

    // keys, unrelieved time, an event
    browser.value("document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'End', bubbles: true })), 0");
    browser.until("document.body.dataset.sequence === String(session.last_frame)");
    browser.value(
        "byId('view').value = 'unrelieved', byId('view').dispatchEvent(new Event('change')), 0",
    );
    browser.until("shown.unit === 's' && map.values.some(value => value > 0.3)");
    browser
        .value("byId('view').value = 'load', byId('view').dispatchEvent(new Event('change')), 0");
    let went = "(() => { const button = [...byId('events').children].find(event => event.textContent.includes('alarm-active')); \
        button.querySelector('button').click(); return session.events.find(event => event.kind === 'alarm-active').wall_ms; })()";
    let alarm_ms = browser.value(went).as_i64().expect("its time");
    // on a busy machine the page may still show the frame before
    browser.until(&format!(
        "at === Math.min({alarm_ms}, session.last_ms) && !busy && shown.unit !== 's' && document.body.dataset.kind === 'exact'"
    ));
    let [sequence, shown_ms, last] = ["shown.sequence", "shown.wall_ms", "session.last_frame"]
        .map(|number| browser.value(number).as_i64().expect("a number"));
    assert!(shown_ms <= alarm_ms, "{shown_ms} {alarm_ms}");
    if sequence < last {
        exact(&browser, sequence.unsigned_abs() + 1);
        let after_ms = browser.value("shown.wall_ms").as_i64().expect("a time");
        assert!(after_ms > alarm_ms, "{after_ms} {alarm_ms}");
    }

    // a region drawn with the mouse is shown in the syntax of config.toml
    let drawn = browser.value(
        "(() => { byId('draw').click(); const box = map.canvas.getBoundingClientRect(); \
         const at = (type, x, y) => map.canvas.dispatchEvent(new PointerEvent(type, { pointerId: 1, bubbles: true, \
           clientX: box.left + map.x(x) / map.pixels, clientY: box.top + map.y(y) / map.pixels })); \
         map.canvas.setPointerCapture = () => {}; \
         at('pointerdown', 60, 80); at('pointermove', 120, 150); at('pointerup', 120, 150); \
         return byId('drawn').textContent; })()",
    );
    let drawn = drawn.as_str().expect("text");
    let (_, lines) = drawn.split_once("\n\n").expect("lines to add");
    let parsed: toml::Table = lines.parse().expect("TOML");
    let corners = parsed["region"][0]["rectangle_mm"]
        .as_array()
        .expect("corners");
    for (corner, wanted) in corners.iter().zip([60.0, 80.0, 120.0, 150.0]) {
        let corner = corner.as_float().expect("mm");
        // a pixel is about half a millimetre
        assert!((corner - wanted).abs() < 1.0, "{drawn}");
    }
    browser.value("play(true), 0");
    browser.until("byId('play').textContent === 'Play' && document.body.dataset.sequence === String(session.last_frame)");
    step_while_a_session_is_opened(&browser);
    chosen_session_stays_when_one_before_it_opens(&browser);
}

/// A session that opens slowly is not shown if the user has chosen another one meanwhile.
fn chosen_session_stays_when_one_before_it_opens(browser: &Browser) {
    let stays = browser.asynchronous(
        "const done = arguments[0], usual = ask, list = byId('sessions'), id = session.id; \
         let go; const held = new Promise(resolve => { go = resolve; }); \
         ask = async path => { if (path !== '/api/sessions/slow') return usual(path); await held; return usual(`/api/sessions/${id}`); }; \
         list.prepend(new Option('slow', 'slow')); list.value = 'slow'; const slow = open('slow'); list.value = id; \
         open(id).then(async () => { const chosen = session; go(); await slow; ask = usual; done(session === chosen); });",
    );
    assert_eq!(stays, true);
}

/// The map of a single step arrives after another session was chosen, but before that is open: neither the map nor an
/// error is shown.
fn step_while_a_session_is_opened(browser: &Browser) {
    browser.until("document.body.dataset.kind === 'exact' && !busy && !wanted");
    let verdict = browser.value("byId('verdict').textContent");
    let after = browser.asynchronous(
        "const done = arguments[0], usual = ask; let go; const held = new Promise(resolve => { go = resolve; }); \
         ask = async path => { if (!path.includes('/maps/')) await held; return usual(path); }; \
         const id = session.id; step(-1); open(id); \
         const check = () => { if (busy) return setTimeout(check, 20); ask = usual; go(); done(byId('verdict').textContent); }; \
         check();",
    );
    assert_eq!(verdict, after);
    browser.until("session && shown && shown.sequence === session.first_frame");
}
