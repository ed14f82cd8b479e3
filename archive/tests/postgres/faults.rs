//! Faults of the store, of the record and of the server.

use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;

use rustix::process::Signal;

use crate::archive;
use crate::frames::at;
use crate::server::wait_until;
use crate::site::begun;

fn altered(path: &PathBuf) {
    let mut bytes = std::fs::read(path).unwrap();
    // no row is stored at this place: only the hash reveals the change
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::set_permissions(path, PermissionsExt::from_mode(0o600)).unwrap();
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn altered_part_is_found_in_the_store_and_in_the_record() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 2);
    site.done(&["push"]);
    assert_eq!(site.done(&["verify"]).matches(": intact").count(), 2);
    // in the store
    let stored = site.stored();
    let whole = std::fs::read(&stored[0]).unwrap();
    altered(&stored[0]);
    let error = site.refused(&["verify"], 1);
    assert!(
        error.contains("1 of 2 parts are damaged or missing"),
        "{error}"
    );
    assert!(
        String::from_utf8(site.run(&["verify"]).stdout)
            .unwrap()
            .contains("DAMAGED")
    );
    let into = site.folder.path().join("back");
    std::fs::create_dir(&into).unwrap();
    let error = site.refused(&["pull", "m1", "--into", &into.to_string_lossy()], 1);
    assert!(error.contains("nothing was kept"), "{error}");
    assert_eq!(std::fs::read_dir(&into).unwrap().count(), 0);
    std::fs::remove_file(&stored[0]).unwrap();
    assert!(
        String::from_utf8(site.run(&["verify"]).stdout)
            .unwrap()
            .contains("MISSING")
    );
    std::fs::write(&stored[0], whole).unwrap();
    site.done(&["verify"]);
    // altered in the record: the archive keeps its copy
    altered(&site.record().join("m1_p2.tactus"));
    let output = site.run(&["push"]);
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text.contains("m1_p2: NOT ARCHIVED") && !text.contains("m1:"),
        "{text}"
    );
    assert_eq!(site.stored(), stored);
    assert_eq!(server.sql("SELECT count(*) FROM tactus.part"), "2");
}

#[test]
fn part_closed_while_it_is_read_waits_for_its_last_rows() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    let writer = begun(&site.record(), "m1", 1);
    let reader = logbook::SessionReader::open(writer.path()).unwrap();
    writer.close(at(3600), "asked to stop").unwrap();
    let output = site.run(&["push"]);
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text.contains("NOT ARCHIVED") && text.contains("journal next to it"),
        "{text}"
    );
    assert_eq!(server.sql("SELECT count(*) FROM tactus.part"), "0");
    drop(reader);
    site.merge_journals();
    assert!(site.done(&["push"]).contains("m1: archived"));
    site.done(&["verify"]);
}

#[test]
fn another_content_under_a_known_name_is_a_conflict() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 1);
    site.done(&["push"]);
    let hash = server.sql("SELECT encode(sha256, 'hex') FROM tactus.part");
    // another machine with the same site and machine name
    std::fs::remove_dir_all(site.record()).unwrap();
    std::fs::create_dir(site.record()).unwrap();
    site.record_session("m1", 2);
    let output = site.run(&["push"]);
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text.contains("with another content") && text.contains("berlin/bed3"),
        "{text}"
    );
    assert!(text.contains("m1_p2: archived"), "{text}");
    assert!(!site.record().join("m1.archived.json").exists());
    assert_eq!(
        server.sql("SELECT encode(sha256, 'hex') FROM tactus.part WHERE part = 'm1'"),
        hash
    );
}

#[test]
fn catalogue_refuses_a_second_content_of_a_part() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 1);
    let path = site.record().join("m1.tactus");
    let access = archive::Access {
        dsn: format!(
            "host={} port={} dbname=tactus user=berlin",
            server.socket().display(),
            server.port()
        ),
        ca: None,
        password_file: Some(site.folder.path().join("password")),
    };
    let enter = async |path: &std::path::Path| {
        let mut catalogue = archive::Catalogue::connect(&access).await?;
        let part = archive::Part::read(path, "berlin", "bed3").unwrap();
        catalogue.enter(&part, &[]).await
    };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    // the same content twice is fine
    runtime.block_on(enter(&path)).unwrap();
    runtime.block_on(enter(&path)).unwrap();
    let events = server.sql("SELECT count(*) FROM tactus.event");
    altered(&path);
    let error = runtime.block_on(enter(&path)).unwrap_err();
    assert!(
        matches!(error, archive::CatalogueError::Conflict { .. }),
        "{error}"
    );
    assert_eq!(server.sql("SELECT count(*) FROM tactus.event"), events);
    assert_eq!(server.sql("SELECT count(*) FROM tactus.part"), "1");
}

#[test]
fn damaged_part_does_not_hold_up_the_others() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 1);
    site.record_session("m2", 1);
    std::fs::write(site.record().join("m1.tactus"), "no database").unwrap();
    let output = site.run(&["push"]);
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("m1.tactus is not a session file"), "{text}");
    assert_eq!(server.sql("SELECT part FROM tactus.part"), "m2");
}

#[test]
fn unreadable_quantities_do_not_hold_up_the_others() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 2);
    site.record_session("m2", 1);
    let quantities = site.record().join("m1.quantities");
    std::fs::remove_file(&quantities).unwrap();
    std::fs::create_dir(&quantities).unwrap();
    let output = site.run(&["push"]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(
        text.matches("m1.quantities: NOT ARCHIVED").count(),
        1,
        "{text}"
    );
    assert_eq!(server.sql("SELECT count(*) FROM tactus.part"), "3");
    let is_confirmed = |part: &str| {
        let name = format!("{part}.archived.json");
        site.record().join(name).exists()
    };
    // the receipt of the first part also covers the session's quantities
    assert!(!is_confirmed("m1"), "{text}");
    assert!(is_confirmed("m1_p2") && is_confirmed("m2"), "{text}");
    std::fs::remove_dir(&quantities).unwrap();
    site.done(&["push"]);
    assert!(is_confirmed("m1"));
}

#[test]
fn status_names_unreadable_files_beside_the_rest() {
    let Some((_server, site)) = archive("berlin") else {
        return;
    };
    for id in ["m1", "m2", "m3"] {
        site.record_session(id, 1);
    }
    let quantities = site.record().join("m1.quantities");
    std::fs::remove_file(&quantities).unwrap();
    std::fs::create_dir(&quantities).unwrap();
    std::fs::write(site.record().join("m3.tactus"), "no database").unwrap();
    let output = site.run(&["status", "--json"]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    let found: Vec<serde_json::Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(found[0]["missing"], serde_json::json!(["m1", "m2"]));
    // the three minutes of the session that can be read
    assert_eq!(found[0]["missing_lines"], 3);
    let mut problems: Vec<(&str, String)> = found[1..]
        .iter()
        .map(|line| (line["what"].as_str().unwrap(), line["part"].to_string()))
        .collect();
    problems.sort();
    let [(first, quantities), (second, session)] = &problems[..] else {
        panic!("{found:?}");
    };
    assert!(*first == "problem" && *second == "problem", "{found:?}");
    assert!(quantities.contains("m1.quantities"), "{found:?}");
    assert!(session.contains("m3.tactus"), "{found:?}");
    // both problems remain a failure even with everything else archived
    assert_eq!(site.run(&["push"]).status.code(), Some(1));
    let error = site.refused(&["status"], 1);
    assert!(error.contains("2 problems: see above"), "{error}");
}

#[test]
fn full_store_is_reported_and_goes_on_when_there_is_space() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    for id in ["m1", "m2", "m3"] {
        site.record_session(id, 1);
    }
    let part = std::fs::metadata(site.record().join("m1.tactus"))
        .unwrap()
        .len();
    // space for two and a half parts
    let mounted = std::process::Command::new("mount")
        .args([
            "-t",
            "tmpfs",
            "-o",
            &format!("size={}", 5 * part / 2),
            "tmpfs",
        ])
        .arg(site.store())
        .output();
    if !mounted.is_ok_and(|output| output.status.success()) {
        return needs::lacking("LOOP", "this test cannot mount a small file system");
    }
    let first = site.run(&["push"]);
    // enlarged; all results are read before the unmount
    let space = std::process::Command::new("mount")
        .args(["-o", "remount,size=4m"])
        .arg(site.store())
        .status();
    let parts = server.sql("SELECT count(*) FROM tactus.part");
    let unfinished = site
        .stored()
        .iter()
        .filter(|path| path.extension().is_none_or(|end| end != "tactus"))
        .count();
    let pushed = site.run(&["push"]);
    let verified = site.run(&["verify"]);
    let _ = std::process::Command::new("umount")
        .arg(site.store())
        .status();
    let error = String::from_utf8_lossy(&first.stderr);
    assert_eq!(first.status.code(), Some(75), "{error}");
    assert!(error.contains("is full: free space there"), "{error}");
    assert!(
        parts == "2" && unfinished == 0,
        "{parts} parts, {unfinished} unfinished files"
    );
    assert!(space.is_ok_and(|status| status.success()));
    assert!(
        pushed.status.success() && verified.status.success(),
        "{pushed:?} {verified:?}"
    );
    assert_eq!(server.sql("SELECT count(*) FROM tactus.part"), "3");
}

#[test]
fn service_survives_a_server_that_stops_and_comes_back() {
    let Some((mut server, site)) = archive("berlin") else {
        return;
    };
    let log = site.folder.path().join("log");
    let written = std::fs::File::create(&log).unwrap();
    let mut service = site.command(&["run"]);
    let mut service = service
        .stdout(written.try_clone().unwrap())
        .stderr(written)
        .spawn()
        .unwrap();
    let wait = |what: &str, done: &dyn Fn() -> bool| {
        wait_until(done, || {
            format!("no {what}: {}", std::fs::read_to_string(&log).unwrap())
        });
    };
    site.record_session("m1", 2);
    wait("first parts", &|| {
        server.sql("SELECT count(*) FROM tactus.part") == "2"
    });
    server.kill(Signal::QUIT);
    site.record_session("m2", 2);
    wait("report", &|| {
        std::fs::read_to_string(&log).unwrap().contains("again in")
    });
    server.resume();
    wait("rest", &|| {
        server.sql("SELECT count(*) FROM tactus.part") == "4"
    });
    wait("receipt", &|| {
        site.record().join("m2_p2.archived.json").exists()
    });
    service.kill().unwrap();
    service.wait().unwrap();
    site.done(&["verify"]);
}
