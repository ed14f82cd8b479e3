//! Tests of screens with constructed states.

use std::path::Path;
use std::sync::Arc;

use chrono::{DateTime, FixedOffset};
use dbus::json::Alarm;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::style::Color;
use render::TerminalColour;
use serde_json::{Value, json};
use web::{DaemonState, EventState, FrameState, SessionState, Snapshot, State};

use crate::args::{Arguments, Command};
use crate::control::top::dashboard::{Dashboard, Next};
use crate::control::top::{run, view};
use crate::options::choices::Scale;
use crate::output::Printer;

/// 2026-01-01 12:00:00 at +01:00.
const NOW_MS: i64 = 1_767_265_200_000;

fn now() -> DateTime<FixedOffset> {
    let hour = FixedOffset::east_opt(3600).unwrap();
    DateTime::from_timestamp_millis(NOW_MS)
        .unwrap()
        .with_timezone(&hour)
}

/// A sheet of 200 x 140 mm: squares of 10 mm, two triangles each, with 16 electrodes.
fn geometry() -> dbus::Geometry {
    let mut nodes = Vec::new();
    for row in 0..=14_u32 {
        for column in 0..=20_u32 {
            nodes.extend([0.01 * f64::from(column), 0.01 * f64::from(row)]);
        }
    }
    let mut triangles = Vec::new();
    for row in 0..14_u32 {
        for column in 0..20_u32 {
            let corner = 21 * row + column;
            triangles.extend([corner, corner + 1, corner + 22]);
            triangles.extend([corner, corner + 22, corner + 21]);
        }
    }
    let mut electrodes = Vec::new();
    for place in [0.03, 0.08, 0.12, 0.17] {
        electrodes.extend([place, 0.0]);
    }
    for place in [0.02, 0.05, 0.09, 0.12] {
        electrodes.extend([0.2, place]);
    }
    for place in [0.17, 0.12, 0.08, 0.03] {
        electrodes.extend([place, 0.14]);
    }
    for place in [0.12, 0.09, 0.05, 0.02] {
        electrodes.extend([0.0, place]);
    }
    dbus::Geometry {
        mesh_hash: "m".into(),
        nodes,
        triangles,
        outline: vec![0.0, 0.0, 0.2, 0.0, 0.2, 0.14, 0.0, 0.14],
        outline_lengths: vec![4],
        electrodes,
        more: dbus::GeometryDetails::default(),
    }
}

/// Two loads, of 12 kPa at (60, 100) mm and of 6 kPa at (150, 40) mm.
fn pressures() -> Vec<f32> {
    let triangles = geometry().corners().unwrap();
    let hill = |[x, y]: [f64; 2], [cx, cy]: [f64; 2], peak: f64| {
        peak * (-((x - cx).powi(2) + (y - cy).powi(2)) / (2.0 * 0.018_f64.powi(2))).exp()
    };
    let at = |[a, b, c]: [[f64; 2]; 3]| [0, 1].map(|axis| (a[axis] + b[axis] + c[axis]) / 3.0);
    let value = |triangle| {
        let place = at(triangle);
        hill(place, [0.06, 0.1], 12.0) + hill(place, [0.15, 0.04], 6.0)
    };
    let values = triangles.into_iter().map(value);
    values.map(|kpa| kpa as f32).collect()
}

fn region(name: &str, load: f64) -> Value {
    json!({
        "name": name,
        "values": {
            "contact": 41.3 * load, "load": load, "mean": 0.042 * load, "peak": 0.21 * load, "ppi": 0.15 * load,
            "dispersion": 1.7 * load, "centre-x": 82.5, "centre-y": 84.0, "gradient": 0.4, "hot-spots": 2.0,
            "path": 12.0, "dose": 1530.0, "unrelieved": 340.0, "unrelieved-area": 0.0, "known": 1.0,
        },
        "deviations": {"load": 0.4, "peak": 0.031, "contact": 12.0},
        "peak_mm": [60.0, 100.0], "ppi_mm": [60.0, 100.0], "dose_mm": null, "unrelieved_mm": null,
    })
}

fn quantities(load: f64) -> Value {
    json!({
        "known": true, "reason": null, "unit": "pressure",
        "regions": [region("sheet", load), region("left", 0.6 * load), region("seat-of-the-chair", 0.2 * load)],
        "spots": [
            {"number": 1, "centre_mm": [60.0, 100.0], "peak": 12.0, "area_mm2": 1500.0, "load": 12.1, "uncertainty": null, "age_s": 330.0, "speed_mm_s": 0.1},
            {"number": 12, "centre_mm": [150.0, 40.0], "peak": 6.0, "area_mm2": 1450.0, "load": 5.8, "uncertainty": {"half_axes_mm": [1.4, 0.9], "angle_deg": 20.0, "load_interval": [5.2, 6.4]}, "age_s": 12.0, "speed_mm_s": null},
        ],
        "changes": [],
    })
}

fn frame(sequence: u64, age_s: i64, load: f64) -> FrameState {
    FrameState {
        sequence,
        wall_ms: NOW_MS - 1000 * age_s,
        simulated: true,
        readings: 598,
        map: true,
        method: Some("one-step noser".into()),
        unit: Some("kPa"),
        largest_loss: Some(0.3),
        quality: Some(json!({"verdict": "sound", "reasons": []})),
        quantities: Some(quantities(load)),
        ..FrameState::default()
    }
}

fn state() -> State {
    let event = |age_s: i64, kind: &str, text: &str| EventState {
        wall_ms: NOW_MS - 1000 * age_s,
        kind: kind.into(),
        text: text.into(),
    };
    State {
        alarms: Vec::new(),
        control: false,
        trouble: None,
        daemon: Some(DaemonState {
            state: "acquiring".into(),
            simulated: true,
            source: "rig".into(),
            source_state: "on".into(),
            method: "one-step noser, whole sheet".into(),
            baseline: "b20260101t100000_123".into(),
            baseline_age_s: Some(3600.0),
            baseline_remarks: ["a load near electrode 3", "a contact", "another"]
                .map(String::from)
                .into(),
            version: "0.1.0".into(),
            well: Some(false),
            troubles: vec!["disk-days: the disk is full in 3.0 days".into()],
            disk_days: Some(3.0),
            ..DaemonState::default()
        }),
        session: Some(SessionState {
            id: "m20260101t110000_456".into(),
            kind: "measurement".into(),
            state: "running".into(),
            frames: Some(60),
            failed: Some(2),
            dropped: Some(1),
            map_noise: Some(0.02),
            last_error: None,
        }),
        frame: None,
        events: [
            event(20, "frame-failed", "frame 57: the voltmeter did not reply"),
            event(3000, "baseline", "recorded"),
        ]
        .into(),
    }
}

/// The state after frames of the last five minutes at intervals of five seconds; frames 30 to 35 have no known
/// quantities.
fn measuring(colour: TerminalColour) -> (Dashboard, Snapshot) {
    let mut shown = Dashboard::new(colour, Scale::Own);
    let mut snapshot = Snapshot::default();
    snapshot.state = state();
    snapshot.geometry = Some(Arc::new(geometry()));
    for sequence in 0..60_u64 {
        let load = 30.0 + sequence as f64 / 2.0;
        let mut frame = frame(sequence, 302 - 5 * sequence as i64, load);
        if (30..=35).contains(&sequence) {
            frame.quantities = None;
        }
        take(&mut shown, &mut snapshot, frame, &pressures());
    }
    (shown, snapshot)
}

fn take(shown: &mut Dashboard, snapshot: &mut Snapshot, frame: FrameState, values: &[f32]) {
    snapshot.keep_map(frame.sequence, values);
    snapshot.state.frame = Some(frame);
    shown.take(snapshot);
}

fn drawn(shown: &Dashboard, columns: u16, rows: u16) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).unwrap();
    terminal
        .draw(|frame| view::draw(frame, shown, now()))
        .unwrap();
    terminal.backend().buffer().clone()
}

fn text(buffer: &Buffer) -> String {
    let rows = buffer.content().chunks(usize::from(buffer.area.width));
    let row = |cells: &[ratatui::buffer::Cell]| {
        let line: String = cells.iter().map(ratatui::buffer::Cell::symbol).collect();
        line.trim_end().to_owned() + "\n"
    };
    rows.map(row).collect()
}

/// The words of a screen: those of the left panels, then those of the right ones, without borders.
fn words(buffer: &Buffer) -> String {
    let left = usize::from(38 + (buffer.area.width - 80) / 2);
    let text = text(buffer);
    let half = |keep: &dyn Fn(usize) -> bool| {
        let of_line = |line: &str| -> String {
            let letters = line.chars().enumerate();
            letters
                .filter(|(column, _)| keep(*column))
                .map(|(_, letter)| letter)
                .collect()
        };
        text.lines().map(of_line).collect::<Vec<_>>().join(" ")
    };
    let both = format!(
        "{} {}",
        half(&|column| column < left),
        half(&|column| column >= left)
    );
    let both = both.replace('─', " ");
    both.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn golden(name: &str, seen: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden")
        .join(name);
    if std::env::var_os("TACTUS_WRITE_REFERENCE").is_some() {
        std::fs::write(&path, seen).unwrap();
    }
    let kept = std::fs::read_to_string(&path).unwrap();
    assert_eq!(
        seen, kept,
        "{name} differs; TACTUS_WRITE_REFERENCE=1 writes it again\n{seen}"
    );
}

#[test]
fn screens_are_the_kept_ones() {
    let (mut shown, _) = measuring(TerminalColour::Plain);
    golden("top-80x24.txt", &text(&drawn(&shown, 80, 24)));
    golden("top-120x40.txt", &text(&drawn(&shown, 120, 40)));
    shown.help = true;
    golden("top-keys-80x24.txt", &text(&drawn(&shown, 80, 24)));
    shown.help = false;
    shown.seen.alarms = alarms();
    golden("top-alarm-80x24.txt", &text(&drawn(&shown, 80, 24)));
    shown.alarms = true;
    golden("top-alarms-80x24.txt", &text(&drawn(&shown, 80, 24)));
}

/// Five alarms: active and notifying, ended, impossible to judge, shelved, and ok.
fn alarms() -> Vec<Alarm> {
    let alarm = |name: &str, level: &str, active: bool| Alarm {
        name: name.into(),
        severity: "major".into(),
        level: Some(level.into()),
        active,
        acknowledged: true,
        ..Alarm::default()
    };
    vec![
        Alarm {
            acknowledged: false,
            cause: Some("ppi of hip 12.3 kPa, above 10 kPa".into()),
            guidance: Some("turn the person".into()),
            ..alarm("hip", "major", true)
        },
        Alarm {
            acknowledged: false,
            ..alarm("elbow", "ok", false)
        },
        Alarm {
            invalid: Some("unrelieved area is not known yet".into()),
            ..alarm("skin", "invalid", false)
        },
        Alarm {
            shelved: Some("by user 1000: known".into()),
            ..alarm("edge", "major", true)
        },
        alarm("disk-days", "ok", false),
    ]
}

#[test]
fn a_load_has_the_colour_of_its_pressure() {
    let (shown, _) = measuring(TerminalColour::TrueColour);
    let buffer = drawn(&shown, 120, 40);
    let darkest = Color::Rgb(26, 26, 82);
    let marks = buffer.content().iter();
    let marked: Vec<_> = marks
        .filter(|cell| cell.symbol() == "1" && cell.bg != Color::Reset)
        .collect();
    // hot spot 1, and the first digit of hot spot 12
    assert_eq!(marked.len(), 2, "{}", text(&buffer));
    let near = |colour: Color, wanted: Color| match (colour, wanted) {
        (Color::Rgb(r, g, b), Color::Rgb(wr, wg, wb)) => {
            r.abs_diff(wr) < 20 && g.abs_diff(wg) < 20 && b.abs_diff(wb) < 20
        }
        _ => false,
    };
    assert!(near(marked[0].bg, darkest), "{:?}", marked[0]);
    assert!(!near(marked[1].bg, darkest), "{:?}", marked[1]);
}

#[test]
fn smaller_terminals_get_a_line_with_the_reason() {
    let (shown, _) = measuring(TerminalColour::Plain);
    for (columns, rows) in [(79, 24), (80, 23), (120, 10)] {
        let seen = text(&drawn(&shown, columns, rows));
        let wanted = format!("needs 80x24 characters, this terminal has {columns}x{rows}");
        assert!(seen.contains(&wanted), "{seen}");
        assert!(!seen.contains("Health"), "{seen}");
    }
}

#[test]
fn every_size_is_drawn() {
    let (mut shown, _) = measuring(TerminalColour::Ansi256);
    (shown.help, shown.alarms, shown.seen.alarms) = (true, true, alarms());
    for columns in [1, 2, 10, 80, 81, 97, 150, 400] {
        for rows in [1, 2, 10, 24, 25, 31, 32, 100] {
            drawn(&shown, columns, rows);
        }
    }
}

#[test]
fn what_is_not_known_is_no_number() {
    let (mut shown, mut snapshot) = measuring(TerminalColour::Plain);
    let mut frame = frame(60, 1, 70.0);
    frame.quality = Some(json!({"verdict": "unreliable", "reasons": [
        {"kind": "electrodes", "electrode": null, "text": "the readings contradict each other"}]}));
    frame.quantities = Some(
        json!({"known": false, "reason": "contradiction", "unit": "pressure",
        "regions": [{"name": "sheet", "values": {"known": 0.0}, "deviations": {}, "peak_mm": null, "ppi_mm": null,
            "dose_mm": null, "unrelieved_mm": null}],
        "spots": [], "changes": []}),
    );
    take(&mut shown, &mut snapshot, frame, &pressures());
    let seen = words(&drawn(&shown, 80, 24));
    for wanted in [
        "contact - mm2 load - N",
        "unreliable",
        "Hot spots (mm) not known",
    ] {
        assert!(seen.contains(wanted), "{wanted}: {seen}");
    }
}

#[test]
fn a_map_of_noise_has_a_note() {
    let (mut shown, mut snapshot) = measuring(TerminalColour::Plain);
    let mut frame = frame(60, 1, 70.0);
    frame.largest_loss = Some(0.019);
    take(&mut shown, &mut snapshot, frame.clone(), &pressures());
    let seen = text(&drawn(&shown, 80, 24));
    assert!(seen.contains("nothing above the noise (2.0 %)"), "{seen}");
    frame.sequence = 61;
    frame.largest_loss = Some(0.021);
    take(&mut shown, &mut snapshot, frame, &pressures());
    assert!(!text(&drawn(&shown, 80, 24)).contains("the noise"));
}

#[test]
fn without_a_map_the_reason_is_shown() {
    let seen = |shown: &Dashboard| words(&drawn(shown, 80, 24));
    let mut shown = Dashboard::new(TerminalColour::Plain, Scale::Own);
    let first = seen(&shown);
    assert!(first.contains("connecting to the daemon") && first.contains("NO DAEMON"));
    let (mut shown_before, mut snapshot) = measuring(TerminalColour::Plain);
    assert!(shown_before.picture.is_some());
    snapshot.state.trouble = Some("nothing is there".into());
    snapshot.state.daemon = None;
    snapshot.state.session = None;
    shown_before.take(&snapshot);
    let lost = seen(&shown_before);
    for wanted in ["NO DAEMON", "nothing is there; trying again", "no map yet"] {
        assert!(lost.contains(wanted), "{wanted}: {lost}");
    }
    let mut snapshot = Snapshot::default();
    snapshot.state = state();
    shown.take(&snapshot);
    assert!(seen(&shown).contains("waiting for the first map of"));
    snapshot.state.session = None;
    shown.take(&snapshot);
    assert!(seen(&shown).contains("`tactus start` starts one"));
}

#[test]
fn a_map_that_does_not_fit_its_sheet_is_refused() {
    let (mut shown, mut snapshot) = measuring(TerminalColour::Plain);
    take(&mut shown, &mut snapshot, frame(60, 1, 70.0), &[1.0]);
    let seen = text(&drawn(&shown, 120, 40));
    assert!(seen.contains("the map has 1 values"), "{seen}");
}

#[test]
fn text_from_outside_cannot_act_on_the_terminal() {
    let (mut shown, mut snapshot) = measuring(TerminalColour::Plain);
    let daemon = snapshot.state.daemon.as_mut().unwrap();
    daemon.state = "\u{1b}[2Jstate".into();
    daemon.troubles = vec!["kind: \u{9b}trouble".into()];
    daemon.method = "\u{202e}method".into();
    snapshot.state.events[0].text = "\r\0event".into();
    snapshot.state.session.as_mut().unwrap().id = "\u{7}session".into();
    shown.take(&snapshot);
    let seen = text(&drawn(&shown, 120, 40));
    assert!(
        seen.chars()
            .all(|letter| letter == '\n' || !(letter.is_control() || letter == '\u{202e}')),
        "{seen:?}"
    );
    assert!(seen.contains("\\u{1b}[2Jstate"), "{seen}");
}

#[test]
fn charts_show_the_largest_value_of_each_span() {
    use crate::control::top::history::History;
    let mut history = History::default();
    let add = |history: &mut History, at_ms: i64, load: f64| {
        let quantities = serde_json::from_value(quantities(load)).unwrap();
        history.add(at_ms, Some(&quantities));
    };
    let now_ms = 1_000_000;
    for (at_ms, load) in [
        (399_999, 9.0),
        (400_001, 1.0),
        (700_001, 3.0),
        (850_001, 2.0),
    ] {
        add(&mut history, at_ms, load);
    }
    assert_eq!(
        history.columns(0, 4, now_ms),
        [Some(1.0), None, Some(3.0), Some(2.0)]
    );
    // a frame without known quantities is a gap
    history.add(900_000, None);
    // the time of a frame by a clock that is ahead
    add(&mut history, 1_000_500, 5.0);
    assert_eq!(
        history.columns(0, 10, now_ms)[7..],
        [Some(2.0), None, Some(5.0)]
    );
    let mut other = quantities(7.0);
    other["unit"] = json!("relative_loss");
    history.add(1_000_600, Some(&serde_json::from_value(other).unwrap()));
    assert_eq!(history.columns(0, 2, now_ms), [None, Some(7.0)]);
}

#[test]
fn keys_scroll_show_help_and_leave() {
    let key = |code, modifiers| Event::Key(KeyEvent::new(code, modifiers));
    let plain = |code| key(code, KeyModifiers::NONE);
    let control = |letter| key(KeyCode::Char(letter), KeyModifiers::CONTROL);
    let (mut shown, _) = measuring(TerminalColour::Plain);
    for leave in [plain(KeyCode::Char('q')), plain(KeyCode::Esc), control('c')] {
        assert_eq!(shown.press(&leave), Next::Leave);
    }
    assert_eq!(shown.press(&control('l')), Next::Redraw);
    assert_eq!(shown.press(&plain(KeyCode::Char('c'))), Next::Stay);
    assert_eq!(
        shown.press(&Event::Key(KeyEvent::new_with_kind(
            KeyCode::Char('q'),
            KeyModifiers::NONE,
            KeyEventKind::Release
        ))),
        Next::Stay
    );
    for _ in 0..40 {
        shown.press(&plain(KeyCode::Down));
        shown.press(&plain(KeyCode::Right));
    }
    let seen = text(&drawn(&shown, 80, 24));
    assert!(seen.contains("Quantities 17 to 17 of 17"), "{seen}");
    assert!(seen.contains("seat-of-th..."), "{seen}");
    shown.press(&plain(KeyCode::Up));
    shown.press(&plain(KeyCode::Left));
    let seen = text(&drawn(&shown, 80, 24));
    assert!(seen.contains("Quantities 16 to 17 of 17"), "{seen}");
    assert!(seen.contains("left"), "{seen}");
    shown.press(&key(KeyCode::Char('?'), KeyModifiers::SHIFT));
    assert!(shown.help);
    shown.press(&plain(KeyCode::Char('?')));
    assert!(!shown.help);
}

#[test]
fn an_alarm_is_acknowledged_after_a_second_key() {
    let key = |code| Event::Key(KeyEvent::new(code, KeyModifiers::NONE));
    let (mut shown, _) = measuring(TerminalColour::Plain);
    shown.seen.alarms = alarms();
    // without the list of alarms the keys scroll the table
    assert_eq!(shown.press(&key(KeyCode::Enter)), Next::Stay);
    assert_eq!(shown.asking, None);
    shown.press(&key(KeyCode::Char('a')));
    shown.press(&key(KeyCode::Down));
    assert_eq!(shown.first_quantity, 0);
    for refused in [KeyCode::Char('n'), KeyCode::Enter, KeyCode::Esc] {
        shown.press(&key(KeyCode::Enter));
        let seen = text(&drawn(&shown, 80, 24));
        assert!(
            seen.contains("> elbow: ok") && seen.contains("acknowledge elbow? y: yes"),
            "{seen}"
        );
        assert_eq!(shown.press(&key(refused)), Next::Stay);
        assert_eq!(shown.press(&key(KeyCode::Char('y'))), Next::Stay);
    }
    shown.press(&key(KeyCode::Enter));
    let order = shown.press(&key(KeyCode::Char('y')));
    assert_eq!(order, Next::Acknowledge("elbow".to_owned()));
    shown.acknowledged("elbow", Err("not authorised".to_owned()));
    let seen = text(&drawn(&shown, 80, 24));
    assert!(seen.contains("elbow: not authorised"), "{seen}");
    // the last alarm of the list needs no acknowledgement
    for _ in 0..20 {
        shown.press(&key(KeyCode::Down));
    }
    assert_eq!(shown.press(&key(KeyCode::Enter)), Next::Stay);
    let seen = text(&drawn(&shown, 80, 24));
    assert!(
        seen.contains("> disk-days: ok") && seen.contains("needs no acknowledgement"),
        "{seen}"
    );
    // the list has become shorter than the index
    shown.seen.alarms.truncate(1);
    shown.press(&key(KeyCode::Enter));
    drawn(&shown, 80, 24);
    shown.seen.alarms.clear();
    shown.press(&key(KeyCode::Enter));
    drawn(&shown, 80, 24);
}

#[test]
fn without_a_terminal_watch_is_named() {
    use clap::Parser;
    let arguments = Arguments::try_parse_from(["tactus", "top"]).unwrap();
    let Command::Top(requested) = arguments.command else {
        unreachable!("top was asked");
    };
    let refusal = run(
        &arguments.global,
        &requested,
        &Printer::into(false, Vec::new()),
    )
    .unwrap_err();
    assert_eq!(refusal.code(), 2);
    assert!(refusal.to_string().contains("`tactus watch`"), "{refusal}");
}
