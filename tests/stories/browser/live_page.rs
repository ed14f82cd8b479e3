//! `tactus web` shows a press at its position, with its numbers and the state of the session.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Stdio};

use tactus_tests::Stage;

use super::driver::Browser;
use crate::test_rig::{self, Needs, PRESS_MM, ask, baseline, press};

/// `tactus web`, ended when dropped.
pub(super) struct Page {
    process: Child,
    pub(super) url: String,
}

impl Page {
    pub(super) fn serve(stage: &Stage, options: &[&str]) -> Self {
        let mut process = stage
            .command("tactus")
            .args([
                "--json",
                "--bus",
                &format!("unix:{}", stage.peer_path().display()),
            ])
            .args(["web", "--no-browser"])
            .args(options)
            .env("XDG_CACHE_HOME", stage.path().join("cache"))
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut line = String::new();
        BufReader::new(process.stdout.take().expect("it is piped"))
            .read_line(&mut line)
            .expect("it prints the address");
        let line: serde_json::Value = serde_json::from_str(&line).expect("JSON");
        let url = line["url"].as_str().expect("the address").to_owned();
        Self { process, url }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Centroid of the largest value on the page's map, mm.
pub(super) fn brightest(browser: &Browser) -> [f64; 2] {
    let place = browser.value(
        "(() => { let best = 0; map.values.forEach((v, t) => { if (v > map.values[best]) best = t; }); \
         const { nodes, triangles } = map.geometry; const n = [0, 1, 2].map(k => 2 * triangles[3 * best + k]); \
         return [0, 1].map(axis => n.reduce((sum, i) => sum + nodes[i + axis], 0) / 3); })()",
    );
    [0, 1].map(|axis| place[axis].as_f64().expect("a place"))
}

/// Colour of the canvas at a place in mm.
fn colour(browser: &Browser, [x, y]: [f64; 2]) -> Vec<i64> {
    let pixel = browser.value(&format!(
        "Array.from(map.canvas.getContext('2d').getImageData(Math.round(map.x({x})), Math.round(map.y({y})), 1, 1).data)"
    ));
    let parts = pixel.as_array().expect("a pixel");
    parts
        .iter()
        .map(|part| part.as_i64().expect("a byte"))
        .collect()
}

#[test]
fn a_press_is_seen_in_a_browser_at_its_place() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        format!("{config}{REGION}")
    }) else {
        return;
    };
    let profile = stage.path().join("browser");
    let Some(browser) = Browser::start(&profile, 1500, 1000) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    ask(&stage, &["start", "--every", "500ms"]);
    let page = Page::serve(&stage, &[]);

    // without the token nothing is shown
    let (bare, _) = page.url.split_once('#').expect("the token");
    browser.open(bare);
    browser.until("byId('trouble').textContent.includes('token is missing')");

    browser.open(&page.url);
    // the browser does not load the same document again if only the fragment differs
    browser.value("location.reload()");
    browser.until("typeof map !== 'undefined' && map.values !== null");
    assert_eq!(
        browser.value("location.hash"),
        "",
        "the token stays in no history"
    );
    let before = colour(&browser, PRESS_MM);
    press(&stage, PRESS_MM, 30.0, 0.5);
    // a load that comes near the end of a frame enters the tracked baseline in part: the maps then have further hot
    // spots, lower ones
    browser.until("latest.frame.quantities && latest.frame.quantities.spots.length > 0 && map.frame.sequence === latest.frame.sequence");
    browser.until("map.values.reduce((most, v) => Math.max(most, v), 0) > 0.2");
    browser.value("map.draw()");
    let [x, y] = brightest(&browser);
    let away = (x - PRESS_MM[0]).hypot(y - PRESS_MM[1]);
    assert!(away < 15.0, "the map's largest value is {away} mm off");
    let after = colour(&browser, [x + 8.0, y]);
    let distance: i64 = before.iter().zip(&after).map(|(a, b)| (a - b).abs()).sum();
    assert!(
        distance > 60,
        "the press has the colour {after:?}, before {before:?}"
    );

    assert_eq!(browser.value("byId('simulated').hidden"), false);
    let text = browser.value("document.body.innerText");
    let text = text.as_str().expect("text");
    for words in [
        "SIMULATED",
        "not a medical device",
        "Load",
        "Peak pressure index",
        "current source",
        "lost share",
    ] {
        assert!(text.contains(words), "{words} in {text}");
    }
    // the spot has the 95 % ellipse of its centre and the interval of its load
    browser.until("byId('spots').rows.length > 1 && parseFloat(byId('spots').rows[1].cells[3].textContent) > 0 && byId('spots').rows[1].cells[6].textContent.includes(' to ')");
    let spot = browser
        .value("Array.from(byId('spots').rows[1].cells).map(cell => parseFloat(cell.textContent))");
    let place = [1, 2].map(|cell| spot[cell].as_f64().expect("a number"));
    assert!(
        (place[0] - PRESS_MM[0]).hypot(place[1] - PRESS_MM[1]) < 15.0,
        "{spot}"
    );
    let corners = browser.value("map.regions.map(region => [region.name, region.corners_mm])");
    assert_eq!(
        corners,
        serde_json::json!([["hip", [[60, 100], [110, 100], [110, 170], [60, 170]]]])
    );
    read_by_keys_and_as_a_table(&browser);
    // the page's number equals that of the commands; both values are read at once, because a new frame may arrive
    // between two queries
    browser.until("latest.frame.quantities && (window.read = [latest.frame.sequence, latest.frame.quantities.regions[0].values.load])");
    let [sequence, shown] = ["read[0]", "read[1]"].map(|value| browser.value(value));
    let pictures = Path::new(env!("CARGO_TARGET_TMPDIR"));
    browser.screenshot(&pictures.join("live-page.png"));
    live_values_have_one_unit(&browser);
    live_frames_without_a_map_are_counted(&browser);

    ask(&stage, &["stop"]);
    let frames = ask(&stage, &["quantities", "last", "--each-frame"]);
    let same = frames
        .iter()
        .find(|frame| frame["frame"] == sequence)
        .expect("it is recorded");
    assert_eq!(same["regions"][0]["values"]["load"], shown);
    browser.until("byId('session').textContent === 'no session runs'");
    stored_rows_are_drawn(&stage, &browser);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
    browser.until("!byId('trouble').hidden && byId('trouble').textContent.includes('no daemon')");
    drop(page);
    browser.until("byId('trouble').textContent.includes('no connection to tactus web')");
}

const REGION: &str = "\n[[region]]\nname = \"hip\"\nrectangle_mm = [60.0, 100.0, 110.0, 170.0]\n";

/// Access to the map by keyboard, and as a table for screen readers.
fn read_by_keys_and_as_a_table(browser: &Browser) {
    // because of the press, the check of the map may name an electrode
    browser.until("/electrodes\\s+26(, all used|: )/.test(byId('state').innerText)");
    browser.value("byId('map').focus()");
    // from the middle, (107, 115) mm, to the press by steps of 5 mm; right, left and up arrow
    browser.keys(
        "\u{E014}\u{E012}\u{E012}\u{E012}\u{E012}\u{E012}\u{E012}\u{E013}\u{E013}\u{E013}\u{E013}",
    );
    browser.until("byId('pointer').textContent.startsWith('(82.0, 135.0) mm: ')");
    let read = browser.value("parseFloat(byId('pointer').textContent.split(': ')[1])");
    assert!(read.as_f64().is_some_and(|loss| loss > 0.1), "{read}");
    browser.value("byId('map-as-table').open = true");
    browser.until("byId('map-table').rows.length === 7");
    let table = browser.value(
        "[...byId('map-table').rows].slice(1).flatMap((row, y) => [...row.cells].slice(1).map((cell, x) => [x, y, parseFloat(cell.textContent)])).sort((a, b) => b[2] - a[2])[0]",
    );
    // columns of 36 mm, rows of 38 mm from above: the press lies in the third column and the third row
    assert_eq!([&table[0], &table[1]], [2, 2], "{table}");
    let unnamed = browser.value(
        "[...document.querySelectorAll('button, input, select, canvas:not([aria-hidden])')].filter(at => \
         !(at.labels && at.labels.length) && !at.getAttribute('aria-label') && !at.textContent.trim()).map(at => at.id)",
    );
    assert_eq!(unnamed, serde_json::json!([]), "controls without a name");
}

/// A session with a calibration follows one without, and its last frame has no quantities.
fn live_values_have_one_unit(browser: &Browser) {
    let shown = browser.value(
        "(() => { const usual = [charts.frames, charts.pressure]; charts.frames = []; \
         const frame = (second, unit, load) => charts.add({ wall_ms: 1000 * second, quantities: unit && { unit, \
           regions: ['sheet', 'hip'].map(name => ({ name, values: { load } })) } }); \
         frame(1, 'relative-loss', 900); frame(2, 'pressure', 5); frame(3, null); charts.draw(true); \
         const shown = byId('charts').innerText + byId('charts-note').textContent; \
         [charts.frames, charts.pressure] = usual; return shown; })()",
    );
    let shown = shown.as_str().expect("text");
    for words in [
        "Load: not known; scale up to 5.00 N",
        "1 frames in another unit than the newest are left out.",
    ] {
        assert!(shown.contains(words), "{words} in {shown}");
    }
}

/// The page receives frames 1, 2 and 5 of `m1`, then the map of frame 3, after those of later frames.
fn live_frames_without_a_map_are_counted(browser: &Browser) {
    let counted = browser.value(
        "(() => { const usual = charts.arrived; charts.arrived = []; \
         const frame = (session, sequence, second) => charts.count(session, { sequence, wall_ms: 1000 * second }); \
         frame('m1', 1, 1); frame('m1', 2, 2); frame('m1', 5, 5); frame('m1', 3, 3); frame('m2', 1, 6); frame('m2', 2, 64); \
         const counted = charts.perMinute().map(point => [point.timeMs / 1000, point.value]); \
         charts.arrived = usual; return counted; })()",
    );
    // the minute up to the last one begins at second 4
    let expected = serde_json::json!([[1, 1], [2, 2], [5, 5], [6, 6], [64, 3]]);
    assert_eq!(counted, expected);
    browser.until("charts.arrived.some(frame => frame.session === latest.session.id)");
}

/// The charts of an hour have the rows of `tactus quantities`.
fn stored_rows_are_drawn(stage: &Stage, browser: &Browser) {
    browser.value("byId('span').value = '1', byId('span').dispatchEvent(new Event('change')), 0");
    browser.until("charts.stored && charts.stored.rows.length > 0");
    let rows = ask(
        stage,
        &[
            "quantities",
            "last",
            "--quantity",
            "load",
            "--region",
            "sheet",
        ],
    );
    let shown = browser.value(
        "charts.stored.rows.filter(row => row.quantity === 'load').map(row => [row.min, row.mean, row.max, row.frames])",
    );
    let shown = shown.as_array().expect("rows");
    assert_eq!(rows.len(), shown.len());
    for (row, shown) in rows.iter().zip(shown) {
        for (place, key) in ["min", "mean", "max", "frames"].iter().enumerate() {
            assert_eq!(row[*key].as_f64(), shown[place].as_f64(), "{key}");
        }
    }
    browser.until("byId('charts').innerText.includes('Load') && byId('charts-note').textContent.includes('stored with the sessions')");
    let note = browser.value(
        "(charts.stored = { ...charts.stored, other_unit: 2 }, charts.drawStored(), byId('charts-note').textContent)",
    );
    let note = note.as_str().expect("text");
    assert!(
        note.ends_with(" 2 rows in another unit than the newest are left out."),
        "{note}"
    );
    // the load is unknown in the newest minute
    let captions = browser.value(
        "(() => { const row = name => charts.stored.rows.find(row => row.quantity === name), known = row('known'); \
         charts.stored = { ...charts.stored, rows: [{ ...row('load'), begin_s: known.begin_s - 60 }, known] }; charts.drawStored(); \
         return byId('charts').innerText; })()",
    );
    let captions = captions.as_str().expect("text");
    assert!(captions.contains("Load: not known here"), "{captions}");
    assert_eq!(
        browser.value("[...byId('chart-region').options].map(option => option.value)"),
        serde_json::json!(["sheet", "hip"])
    );
}

#[test]
fn the_page_fits_a_phone_the_dark_and_a_slow_link() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let profile = stage.path().join("browser");
    let Some(browser) = Browser::start(&profile, 1500, 1000) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    ask(&stage, &["start", "--every", "100ms"]);
    press(&stage, PRESS_MM, 30.0, 0.5);
    let page = Page::serve(&stage, &["--control"]);
    browser.open(&page.url);
    browser.until("typeof map !== 'undefined' && map.values !== null");
    let pictures = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let light = browser.value("getComputedStyle(document.body).backgroundColor");
    let dark = serde_json::json!({"features": [{"name": "prefers-color-scheme", "value": "dark"}]});
    browser.command("Emulation.setEmulatedMedia", &dark);
    browser.until(&format!(
        "getComputedStyle(document.body).backgroundColor !== {light}"
    ));
    browser.value("map.draw()");
    browser.screenshot(&pictures.join("dark-page.png"));
    let phone =
        serde_json::json!({"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": true});
    browser.command("Emulation.setDeviceMetricsOverride", &phone);
    browser.until("innerWidth === 390 && map.canvas.width > 600");
    let wide = browser.value(
        "[...document.querySelectorAll('body *')].filter(at => at.getBoundingClientRect().right > 391 && !at.closest('.wide')).map(at => at.id || at.tagName)",
    );
    assert_eq!(wide, serde_json::json!([]), "wider than a phone");
    assert_eq!(browser.value("document.documentElement.scrollWidth"), 390);
    browser.value("map.draw()");
    browser.screenshot(&pictures.join("phone-page.png"));

    // a map has 15 kB, and the link needs at least four frames for one: the page skips maps and never queues requests
    let frame = "[latest.frame.sequence, performance.now()]";
    browser.value(&format!("window.first = {frame}, 0"));
    browser.until("latest.frame.sequence >= first[0] + 3");
    let period_ms = browser.value(&format!(
        "((now) => (now[1] - first[1]) / (now[0] - first[0]))({frame})"
    ));
    let period_ms = period_ms.as_f64().expect("a number");
    let bytes_per_s = (15_000.0 / (4e-3 * period_ms)).min(8_000.0);
    browser.value("performance.clearResourceTimings(), window.slow = [latest.frame.sequence], 0");
    browser.value(
        "window.behind = [], window.set = map.setMap.bind(map), map.setMap = (...all) => { slow.push(all[1].sequence); \
         behind.push(latest.frame.sequence - all[1].sequence); set(...all); }, 0",
    );
    browser.slow_link(bytes_per_s as u32, 100);
    browser.until("slow.length > 6");
    let left_out = browser
        .value("slow.some((sequence, index) => index > 1 && sequence > slow[index - 1] + 1)");
    assert_eq!(left_out, true, "{}", browser.value("slow"));
    let overlap = browser.value(
        "performance.getEntriesByType('resource').filter(entry => entry.name.includes('/api/map/')).sort((a, b) => a.startTime - b.startTime) \
         .some((entry, index, all) => index > 0 && entry.startTime < all[index - 1].responseEnd)",
    );
    assert_eq!(
        overlap, false,
        "a map is asked for when the one before has arrived"
    );
    // if requests were queued, each map would be some 20 frames later than the one before
    let late = browser.value("Math.min(...behind.slice(3)) - behind[1]");
    assert!(
        late.as_i64().is_some_and(|frames| frames < 30),
        "{late}, {}",
        browser.value("behind")
    );
    drop(page);
    ask(&stage, &["stop"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}

#[test]
fn a_map_is_shown_under_the_name_of_its_own_session() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let profile = stage.path().join("browser");
    let Some(browser) = Browser::start(&profile, 1500, 1000) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let page = Page::serve(&stage, &[]);
    browser.open(&page.url);
    browser.until("typeof latest !== 'undefined' && latest && latest.daemon");
    ask(&stage, &["start", "--step"]);
    ask(&stage, &["step"]);
    browser.until("latest.frame && map.frame && map.frame.sequence === 1 && !fetching");
    let first = browser.value("latest.session.id");

    // delay the request of the next map, then each further state, too
    browser.value(
        "window.usual = ask, window.maps = new Promise(go => { window.passMaps = go; }), window.states = null, \
         ask = async path => { if (path.startsWith('/api/map/')) await maps; const answer = await usual(path); \
         if (path.startsWith('/api/state')) await states; return answer; }, 0",
    );
    ask(&stage, &["step"]);
    browser.until("latest.frame.sequence === 2 && latest.frame.map && fetching");
    browser.value("window.states = new Promise(go => { window.passStates = go; }), 0");
    ask(&stage, &["stop"]);
    ask(&stage, &["start", "--step"]);
    ask(&stage, &["step"]);
    ask(&stage, &["step"]);
    let other = browser.asynchronous(&format!(
        "const done = arguments[0]; const look = async () => {{ const {{ session, frame }} = await (await usual('/api/state')).json(); \
         if (session && session.id !== {first} && frame && frame.sequence === 2 && frame.map) done(session.id); else setTimeout(look, 20); }}; \
         look();"
    ));
    browser.value(
        "window.drawn = [], window.set = map.setMap.bind(map), map.setMap = (...all) => { drawn.push(shownSession); set(...all); }, \
         passMaps(), 0",
    );
    browser.until("!fetching");
    assert_eq!(browser.value("latest.session.id"), first);
    assert_eq!(browser.value("drawn"), serde_json::json!([]));
    browser.value("passStates(), 0");
    browser.until(&format!(
        "latest.session && latest.session.id === {other} && drawn.length > 0 && map.frame.sequence === 2"
    ));
    let drawn = browser.value("drawn.every(id => id === latest.session.id)");
    assert_eq!(drawn, true, "{}", browser.value("drawn"));

    // the map of the old session is not shown for the new one, which has no frame yet
    ask(&stage, &["stop"]);
    ask(&stage, &["start", "--step"]);
    browser.until(&format!(
        "latest.session && latest.session.id !== {other} && !latest.frame && map.values === null"
    ));
    ask(&stage, &["step"]);
    browser.until("map.frame && map.frame.sequence === 1 && shownSession === latest.session.id");
    ask(&stage, &["stop"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}

/// If no period is entered, the configured one applies; a press needs its numbers.
fn empty_fields_are_not_sent_as_numbers(browser: &Browser) {
    let sent = browser.value(
        "(() => { const usual = send, sent = [], size = byId('press-size').value; send = command => sent.push(command); \
         byId('every').value = ''; byId('start').click(); byId('every').value = '0'; byId('start').click(); \
         byId('press-size').value = ''; press({ x: 100, y: 100 }); byId('press-size').value = size; send = usual; return sent; })()",
    );
    let wanted = serde_json::json!([{"call": "start"}, {"call": "start", "every_s": 0}]);
    assert_eq!(sent, wanted);
    let answer = browser.value("byId('answer').textContent");
    assert_eq!(answer, "press: size and loss must be numbers");
}

const RULE: &str = "\n[[alarm]]\nname = \"pressed\"\nquantity = \"contact\"\nabove = 100.0\nfor_s = 0.5\nseverity = \"major\"\n\
    guidance = \"lift it\"\n";

#[test]
fn an_alarm_is_seen_and_acknowledged_in_a_browser() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        format!("{config}{RULE}")
    }) else {
        return;
    };
    let profile = stage.path().join("browser");
    let Some(browser) = Browser::start(&profile, 1500, 1000) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let page = Page::serve(&stage, &["--control"]);
    browser.open(&page.url);
    browser.until("latest && latest.daemon && !byId('control').hidden");
    empty_fields_are_not_sent_as_numbers(&browser);
    browser.value("byId('every').value = '0.3', byId('start').click()");
    browser.until("latest.frame && latest.frame.map && map.values !== null");
    // by the page's own control: a click on the map
    browser.value("byId('press').checked = true, byId('press-loss').value = '50', byId('map').scrollIntoView({ block: 'center' }), 0");
    let at = browser.value(&format!(
        "(box => [map.x({0}) / map.pixels - box.width / 2, map.y({1}) / map.pixels - box.height / 2].map(Math.round))(map.canvas.getBoundingClientRect())",
        PRESS_MM[0], PRESS_MM[1]
    ));
    let [x, y] = [0, 1].map(|axis| at[axis].as_i64().expect("a pixel"));
    browser.value(
        "window.sent = [], window.post = send, send = call => (sent.push(call), post(call)), 0",
    );
    browser.click("#map", x, y);
    browser.until("byId('answer').textContent === 'press: done'");
    let sent = browser.value("[1000 * sent[0].x_m, 1000 * sent[0].y_m]");
    for (axis, asked) in PRESS_MM.iter().enumerate() {
        let place = sent[axis].as_f64().expect("a place");
        assert!((place - asked).abs() < 2.0, "pressed at {sent}");
    }
    // the frame during which the press began mixes two states of the sheet, and a map arrives after its frame
    let pressed = browser.value("latest.frame.sequence");
    browser.until(&format!(
        "map.frame.sequence > {pressed} + 2 && map.values.reduce((most, v) => Math.max(most, v), 0) > 0.2"
    ));
    let [x, y] = brightest(&browser);
    let away = (x - PRESS_MM[0]).hypot(y - PRESS_MM[1]);
    assert!(away < 15.0, "the pressed place is {away} mm off");
    browser.until("document.title.startsWith('ALARM ') && document.title.includes('pressed')");
    let button = "document.querySelector('[aria-label=\"Acknowledge pressed\"]')";
    browser.until(&format!("{button} !== null"));
    let row = browser.value("byId('alarms').innerText");
    let row = row.as_str().expect("text");
    for words in ["pressed", "ACTIVE, major, not acknowledged", "lift it"] {
        assert!(row.contains(words), "{words} in {row}");
    }
    browser.screenshot(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("alarm-page.png"));
    browser.value(&format!("{button}.click()"));
    browser.until(&format!("{button} === null"));
    let listed = stage
        .tactus(&["--json", "alarms"])
        .expect("the program runs");
    let alarm = listed
        .stdout
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).expect("JSON"))
        .find(|alarm| alarm["name"] == "pressed")
        .expect("it is listed");
    assert_eq!(
        (&alarm["active"], &alarm["acknowledged"]),
        (&true.into(), &true.into())
    );
    // an error reply of the daemon is shown
    browser.value("send({ call: 'reset', name: 'pressed' }), 0");
    browser.until("byId('answer').textContent.includes('nothing to reset')");
    browser.value("byId('release').click(), 0");
    browser.until("byId('answer').textContent === 'release: done'");
    browser.until("latest.frame.quantities && latest.frame.quantities.spots.length === 0");
    browser.value("byId('stop').click(), 0");
    browser.until("byId('session').textContent === 'no session runs'");
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}
