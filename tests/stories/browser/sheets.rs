//! The page of all sheets: a machine with an alarm is found, and its session is played from the archive.

use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use super::driver::{Browser, PATIENCE};
use super::live_page::Page;
use super::server::{DATABASE, OWNER, PASSWORD, Server};
use crate::test_rig::{self, Needs, PRESS_MM, ask, baseline, press};

const ALARM: &str = "\n[[alarm]]\nname = \"pressed\"\nquantity = \"contact\"\nabove = 100.0\nseverity = \"minor\"\n";

/// A configuration of the archive for a role.
fn written(folder: &Path, server: &Server, role: &str, more: &str) -> String {
    let (socket, port) = (server.socket().display(), server.port());
    let text = format!(
        "[record]\ndirectory = \"state\"\n[archive]\nsite = \"berlin\"\ndaq = \"bed3\"\nstore = \"store\"\n\
         dsn = \"host={socket} port={port} dbname={DATABASE} user={role}\"\n{more}"
    );
    let path = folder.join(format!("{role}.toml"));
    std::fs::write(&path, text).expect("the folder can be written");
    path.display().to_string()
}

#[test]
fn an_alarm_of_all_sheets_is_found_and_played() {
    use std::os::unix::fs::PermissionsExt;
    let Some(server) = Server::start() else {
        return;
    };
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        format!("{config}{ALARM}")
    }) else {
        return;
    };
    let Some(browser) = Browser::start(&stage.path().join("browser"), 1400, 1000) else {
        return;
    };
    let password = stage.path().join("password");
    std::fs::write(&password, PASSWORD).expect("written");
    std::fs::set_permissions(&password, PermissionsExt::from_mode(0o600)).expect("its own file");
    std::fs::create_dir(stage.path().join("store")).expect("a folder");
    for role in ["berlin", "ward"] {
        server.add_role(role);
    }
    let file = "password_file = \"password\"\n";
    let owner = written(stage.path(), &server, OWNER, "");
    let uploader = written(stage.path(), &server, "berlin", file);
    let reader = written(stage.path(), &server, "ward", file);
    for words in [
        &["migrate"][..],
        &["add-site", "berlin", "--role", "berlin"],
    ] {
        let words = [&["tactus-archive"], words, &["--config", &owner]].concat();
        let done = archive::run(words.into_iter().map(Into::into));
        assert_eq!(format!("{done:?}"), format!("{:?}", ExitCode::SUCCESS));
    }
    server.sql("GRANT tactus_reader TO ward");

    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let page = Page::serve(&stage, &["--archive", "--archive-config", &reader]);
    browser.open(&page.url);
    browser.value("location.reload()");
    ask(&stage, &["start", "--every", "300ms"]);
    press(&stage, PRESS_MM, 30.0, 0.5);
    browser
        .until("latest && latest.alarms.some(alarm => alarm.name === 'pressed' && alarm.active)");
    ask(&stage, &["stop"]);
    // retry, because the page may still read a part while the daemon merges its journal
    let push = ["archive", "push", "--archive-config", &uploader, "--json"];
    let begun = Instant::now();
    while let Err(fault) = stage.tactus(&push).and_then(|ran| ran.succeeded()) {
        assert!(begun.elapsed() < PATIENCE, "{fault}");
        std::thread::sleep(Duration::from_millis(200));
    }
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
    let frames = ask(&stage, &["quantities", "last", "--each-frame"]);
    let last = frames.last().expect("frames");

    // without the record, the page can only show data of the archive
    std::fs::rename(stage.path().join("state"), stage.path().join("before")).expect("renamed");
    browser.value("document.querySelector('nav a:last-of-type').click(), 0");
    browser.until("location.pathname === '/sheets' && machines.length === 1");
    assert_eq!(
        browser.value("machines[0].alarms"),
        serde_json::json!(["pressed"])
    );
    assert_eq!(
        browser.value("document.querySelector('.machine').className"),
        "machine bad"
    );
    let counts = browser.value("byId('counts').textContent");
    assert_eq!(
        counts,
        "1 machine: 1 with an active alarm, 0 with another problem, 0 without problems"
    );
    browser.value("document.querySelector('#machines button').click(), 0");
    browser.until("document.querySelector('#machine-sessions a')");
    browser.screenshot(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("sheets-page.png"));
    browser.value("document.querySelector('#machine-sessions a').click(), 0");
    browser
        .until("location.pathname === '/playback' && session && course && course.progress === 1");
    assert_eq!(
        browser.value(
            "byId('sessions').value === session.id && session.id.startsWith('archive:berlin/bed3/')"
        ),
        true
    );
    browser.value("show('frame', session.last_frame), 0");
    browser.until("document.body.dataset.sequence === String(session.last_frame) && document.body.dataset.kind === 'exact'");
    // the same bits as on the machine that recorded the session
    for name in ["load", "contact", "ppi"] {
        let shown = browser.value(&format!("shown.quantities.regions[0].values['{name}']"));
        assert!(shown.is_number(), "{name}");
        assert_eq!(last["regions"][0]["values"][name], shown, "{name}");
    }
}
