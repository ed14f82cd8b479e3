//! Reading the archive: the state of all machines, sessions by name, the cache.

mod dashboard;

use archive::{ArchiveReader, ReadError, SessionFilter};

use crate::archive;
use crate::frames::at;
use crate::server::{DATABASE, OWNER, Server};
use crate::site::{Site, add_minute, begun};

/// A read-only role, and the configuration of its machine.
fn reader(server: &Server, of: &Site) -> ArchiveReader {
    server.add_role("ward");
    server.sql("GRANT tactus_reader TO ward");
    let path = of.folder.path().join("reader.toml");
    let text = format!(
        "[archive]\nstore = \"store\"\ndsn = \"host={} port={} dbname={DATABASE} user=ward\"\npassword_file = \"password\"\n",
        server.socket().display(),
        server.port()
    );
    std::fs::write(&path, text).unwrap();
    ArchiveReader::open(&path).unwrap()
}

fn fetched(reader: &ArchiveReader, name: &str, of: &Site) -> Result<String, ReadError> {
    let cache = of.folder.path().join("cache");
    let fetched = reader.fetch(&name.parse().unwrap(), &cache)?;
    assert!(fetched.path.starts_with(cache));
    Ok(fetched.name.to_string())
}

#[test]
fn sessions_are_found_by_id_prefix_and_whole_name() {
    let Some((server, berlin)) = archive("berlin") else {
        return;
    };
    for (id, parts) in [("m1", 1), ("m12", 1), ("m2", 2)] {
        berlin.record_session(id, parts);
    }
    berlin.done(&["push"]);
    let mut paris = Site::added(&server, "paris");
    // readers see the stores of all sites in one folder
    std::fs::remove_dir(paris.store()).unwrap();
    std::os::unix::fs::symlink(berlin.store(), paris.store()).unwrap();
    paris.name = "paris".into();
    paris.record_session("m1", 1);
    paris.done(&["push"]);
    let reader = reader(&server, &berlin);
    for (name, whole) in [
        ("m2", "berlin/bed3/m2"),
        ("m12", "berlin/bed3/m12"),
        ("paris/bed3/m", "paris/bed3/m1"),
        ("berlin/bed3/m1", "berlin/bed3/m1"),
        ("paris/bed3/last", "paris/bed3/m1"),
    ] {
        assert_eq!(fetched(&reader, name, &berlin).unwrap(), whole, "{name}");
    }
    for (name, words) in [
        (
            "m1",
            "several sessions of the archive: berlin/bed3/m1, paris/bed3/m1",
        ),
        ("berlin/bed3/m", "berlin/bed3/m12"),
        ("m3", "no session 'm3'"),
        ("rome/bed3/m1", "no session 'rome/bed3/m1'"),
        ("m%", "no session 'm%'"),
    ] {
        let text = fetched(&reader, name, &berlin).unwrap_err().to_string();
        assert!(text.contains(words), "{name}: {text}");
    }
    let listed = |filter: SessionFilter| -> Vec<String> {
        let sessions = reader.sessions(&filter).unwrap();
        sessions
            .iter()
            .map(|s| format!("{}/{}: {}", s.site, s.id, s.frames))
            .collect()
    };
    assert_eq!(listed(SessionFilter::default()).len(), 4);
    let of_berlin = SessionFilter {
        site: Some("berlin".into()),
        ..SessionFilter::default()
    };
    assert_eq!(
        listed(of_berlin.clone()),
        ["berlin/m1: 3", "berlin/m12: 3", "berlin/m2: 6"]
    );
    let after = SessionFilter {
        from: Some(at(3601)),
        ..of_berlin.clone()
    };
    assert_eq!(listed(after), [""; 0]);
    let before = SessionFilter {
        to: Some(at(0)),
        ..of_berlin
    };
    assert_eq!(listed(before), [""; 0]);
}

#[test]
fn fetched_session_equals_the_record_and_grows_with_it() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    let mut writer = begun(&site.record(), "m1", 1);
    add_minute(&site.record(), "m1", 1);
    let state = "{\"state\":1}";
    logbook::keep_state(&site.record(), "m1", logbook::StateKind::Tracking, state).unwrap();
    writer.roll(at(10)).unwrap();
    site.done(&["push"]);
    let reader = reader(&server, &site);
    let folder = site.folder.path().join("cache/berlin/bed3/m1");
    let same = |name: &str| {
        let bytes = |folder: &std::path::Path| std::fs::read(folder.join(name)).unwrap();
        assert!(bytes(&folder) == bytes(&site.record()), "{name}");
    };
    fetched(&reader, "m1", &site).unwrap();
    for name in ["m1.tactus", "m1.quantities", "m1.tracking"] {
        same(name);
    }
    assert!(!folder.join("m1_p2.tactus").exists());
    add_minute(&site.record(), "m1", 2);
    writer.close(at(3600), "asked to stop").unwrap();
    site.done(&["push"]);
    for _ in 0..2 {
        fetched(&reader, "m1", &site).unwrap();
        for name in ["m1.tactus", "m1_p2.tactus", "m1.quantities"] {
            same(name);
        }
    }
    let count = std::fs::read_dir(&folder).unwrap().count();
    assert_eq!(count, 4, "nothing unfinished lies there");
}

#[test]
fn threads_that_fetch_one_session_do_not_disturb_each_other() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 4);
    site.done(&["push"]);
    let reader = reader(&server, &site);
    let together = std::sync::Barrier::new(8);
    let fetch = || {
        together.wait();
        fetched(&reader, "m1", &site).map_err(|error| error.to_string())
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..8).map(|_| scope.spawn(fetch)).collect();
        for thread in threads {
            thread.join().unwrap().unwrap();
        }
    });
    let folder = site.folder.path().join("cache/berlin/bed3/m1");
    let unfinished = std::fs::read_dir(&folder).unwrap().filter(|file| {
        let name = file.as_ref().unwrap().file_name();
        name.to_string_lossy().contains("unfinished")
    });
    assert_eq!(unfinished.count(), 0);
    assert!(folder.join("m1_p4.tactus").exists());
}

#[test]
fn altered_or_missing_part_is_refused_and_leaves_nothing() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 2);
    site.done(&["push"]);
    let reader = reader(&server, &site);
    let folder = site.folder.path().join("cache/berlin/bed3/m1");
    let files = || -> Vec<String> {
        let found = std::fs::read_dir(&folder).unwrap();
        let mut names: Vec<String> = found
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    };
    let second = site
        .stored()
        .into_iter()
        .find(|path| path.to_string_lossy().contains("_p2."))
        .unwrap();
    let whole = std::fs::read(&second).unwrap();
    std::fs::remove_file(&second).unwrap();
    let text = fetched(&reader, "m1", &site).unwrap_err().to_string();
    assert!(
        text.contains("m1_p2") && text.contains("is not in the store"),
        "{text}"
    );
    assert_eq!(files(), ["m1.tactus"]);
    let mut bytes = whole.clone();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&second, bytes).unwrap();
    let error = fetched(&reader, "m1", &site).unwrap_err();
    assert!(survey::error_chain(&error).contains("SHA-256"), "{error:?}");
    assert_eq!(files(), ["m1.tactus"]);
    std::fs::write(&second, whole).unwrap();
    fetched(&reader, "m1", &site).unwrap();
    // a cached file with other content than the part is refused
    let cached = folder.join("m1.tactus");
    std::fs::remove_file(&cached).unwrap();
    std::fs::write(&cached, "another file").unwrap();
    let text = fetched(&reader, "m1", &site).unwrap_err().to_string();
    assert!(text.contains("is not this part"), "{text}");
}

#[test]
fn name_in_the_catalogue_leads_out_of_no_folder() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 1);
    site.done(&["push"]);
    // a site's role has the right to insert such rows
    let insert = |table: &str, change: &str| {
        server.sql(&format!(
            "CREATE TABLE copy AS SELECT * FROM tactus.{table} LIMIT 1; UPDATE copy SET {change};
             INSERT INTO tactus.{table} SELECT * FROM copy ON CONFLICT DO NOTHING; DROP TABLE copy"
        ));
    };
    insert("session", "session = 'x/../../../../x'");
    insert("part", "part = 'x', session = 'x/../../../../x'");
    insert("part", "part = '../../../../m1', session = 'm1'");
    let reader = reader(&server, &site);
    for name in ["m1", "x"] {
        let text = fetched(&reader, name, &site).unwrap_err().to_string();
        assert!(text.contains("is not the name"), "{name}: {text}");
    }
    assert!(!site.folder.path().join("cache").exists());
    let error = site.refused(&["verify"], 1);
    assert!(error.contains("is not the name"), "{error}");
}

#[test]
fn session_without_parts_creates_no_folder() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 1);
    site.done(&["push"]);
    for session in ["m9/../../../../x", "m8"] {
        server.sql(&format!(
            "INSERT INTO tactus.session SELECT site, daq, '{session}', kind, simulated, electrodes, readings, build,
             config_sha256, model_sha256, note, about, instruments FROM tactus.session WHERE session = 'm1'"
        ));
    }
    let reader = reader(&server, &site);
    for name in ["m9", "m8"] {
        let error = fetched(&reader, name, &site).unwrap_err();
        assert!(
            matches!(error, ReadError::NoSuchSession(_)),
            "{name}: {error}"
        );
    }
    assert!(!site.folder.path().join("x").exists());
    assert!(!site.folder.path().join("cache").exists());
}

#[test]
fn machines_show_missing_data_alarms_and_a_wrong_clock() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 1);
    site.done(&["push"]);
    // another machine in its first session, which has archived quantities only
    let running = "INSERT INTO tactus.quantity
        SELECT site, 'bed4', 'm7', line, now() - interval '2 hours' + line * interval '1 minute', span FROM tactus.quantity";
    server.sql(running);
    let reader = reader(&server, &site);
    let machines = reader.machines().unwrap();
    let names: Vec<&str> = machines
        .iter()
        .map(|machine| machine.daq.as_str())
        .collect();
    assert_eq!(names, ["bed3", "bed4"]);
    let [ahead, silent] = &machines[..] else {
        panic!()
    };
    // the times of the example's quantities are in 2027
    let is_ahead = ahead.clock_ahead_s.is_some_and(|s| s > 300.0);
    let passed = chrono::Utc::now() > at(0);
    assert!(is_ahead || passed, "{ahead:?}");
    assert!(
        ahead.silent_s.is_some_and(|s| (0.0..600.0).contains(&s)),
        "{ahead:?}"
    );
    assert_eq!(
        (&ahead.session, ahead.simulated),
        (&Some("m1".to_owned()), Some(false))
    );
    assert_eq!(
        (&ahead.alarms, ahead.known),
        (&vec!["heel".to_owned()], Some(0.75))
    );
    assert_eq!(
        (&silent.session, silent.frames, &silent.alarms),
        (&Some("m7".to_owned()), 0, &Vec::new())
    );
    assert!(silent.silent_s.is_some_and(|s| s > 6900.0), "{silent:?}");
    // an alarm that is judged again stays active until its condition ends
    for (number, change) in [
        (11, "invalid"),
        (12, "judged"),
        (13, "invalid"),
        (14, "handled"),
        (15, "over"),
    ] {
        server.sql(&format!(
            "INSERT INTO tactus.event SELECT site, daq, part, {number}, at + {number} * interval '1 s', kind, text FROM tactus.event WHERE number = 4;
             INSERT INTO tactus.alarm SELECT site, daq, part, number, at, 'heel', '{change}', text FROM tactus.event WHERE number = {number}"
        ));
        let state = server.sql("SELECT active, invalid FROM tactus.alarm_state");
        let wanted = match number {
            11 | 13 | 14 => "t|t",
            12 => "t|f",
            _ => "f|t",
        };
        assert_eq!(state, wanted, "after {change}");
    }
}

#[test]
fn reader_may_read_all_sites_and_write_nothing() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 1);
    site.done(&["push"]);
    reader(&server, &site);
    assert_eq!(
        server.sql_as("ward", "SELECT count(*) FROM tactus.part"),
        "1"
    );
    for statement in [
        "INSERT INTO tactus.quantity VALUES ('berlin', 'bed3', 'm1', 99, now(), '{}')",
        "INSERT INTO tactus.tracking VALUES ('berlin', 'bed3', 'm1', '{}')",
        "DELETE FROM tactus.part",
        "UPDATE tactus.part SET bytes = 1",
        "TRUNCATE tactus.event",
        "CREATE TABLE tactus.mine (x int)",
        "DROP VIEW tactus.machine_state",
    ] {
        let error = server.refusal("ward", statement);
        let refused = error.contains("permission denied") || error.contains("must be owner");
        assert!(refused, "{statement}: {error}");
    }
    // like its parts, the state of a session belongs to its site
    Site::added(&server, "paris");
    let forged = "INSERT INTO tactus.tracking VALUES ('berlin', 'bed3', 'm1', '{}')";
    let error = server.refusal("paris", forged);
    assert!(error.contains("row-level security"), "{error}");
    assert_eq!(
        server.sql_as("paris", "SELECT count(*) FROM tactus.machine_state"),
        "0"
    );
}

#[test]
fn catalogue_of_the_first_version_is_brought_to_this_one() {
    let Some(server) = Server::start() else {
        return;
    };
    server.sql(include_str!(
        "../../../src/catalogue/migrations/0001-catalogue.sql"
    ));
    let first = "INSERT INTO tactus.migration (version, name) VALUES (1, '0001-catalogue')";
    server.sql(first);
    server.add_role("berlin");
    server.sql(
        "INSERT INTO tactus.site VALUES ('berlin', 'berlin'); GRANT tactus_uploader TO berlin",
    );
    server.sql("INSERT INTO tactus.quantity VALUES ('berlin', 'bed9', 'm0', 1, now() - interval '1 day', '{}')");
    let site = Site::new(&server, "berlin");
    site.record_session("m1", 1);
    let waits = site.refused(&["push"], 1);
    assert!(waits.contains("tactus-archive migrate"), "{waits}");
    let owner = Site::new(&server, OWNER);
    for printed in ["applied: 0002-reading", "the catalogue is up to date"] {
        let done = owner.owner(&server, &["migrate"]);
        assert!(done.status.success(), "{done:?}");
        assert_eq!(String::from_utf8(done.stdout).unwrap().trim(), printed);
    }
    site.done(&["push"]);
    let seen = server.sql_as(
        "berlin",
        "SELECT daq, session, frames FROM tactus.machine_state ORDER BY daq",
    );
    assert_eq!(seen, "bed3|m1|3\nbed9|m0|0");
}
