//! What a push stores in the archive, and what a pull returns.

use logbook::{Retention, SessionReader, archived, prune};

use crate::archive;
use crate::frames::at;
use crate::site::{add_minute, begun};

fn lines(text: &str) -> Vec<serde_json::Value> {
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn closed_parts_events_alarms_and_quantities_arrive_once() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 3);
    let open = begun(&site.record(), "m2", 1);
    add_minute(&site.record(), "m2", 1);
    let status = lines(&String::from_utf8(site.run(&["status", "--json"]).stdout).unwrap());
    assert_eq!(
        status[0]["missing"],
        serde_json::json!(["m1", "m1_p2", "m1_p3"])
    );
    assert_eq!(
        (&status[0]["open"], &status[0]["missing_lines"]),
        (&1.into(), &10.into())
    );
    let before: Vec<Vec<u8>> = ["m1", "m1_p2", "m1_p3"]
        .map(|id| std::fs::read(site.record().join(format!("{id}.tactus"))).unwrap())
        .to_vec();
    let steps = lines(&site.done(&["push", "--json"]));
    let what: Vec<&str> = steps
        .iter()
        .map(|step| step["what"].as_str().unwrap())
        .collect();
    assert_eq!(
        what,
        [
            "archived",
            "archived",
            "archived",
            "quantities",
            "receipt",
            "receipt",
            "receipt"
        ]
    );
    let expected = "3|9|9|3|10";
    let counts = "SELECT (SELECT count(*) FROM tactus.part), (SELECT sum(frames) FROM tactus.part),
        (SELECT count(*) FROM tactus.event WHERE kind = 'note'), (SELECT count(*) FROM tactus.alarm WHERE alarm = 'heel' AND change = 'active'),
        (SELECT count(*) FROM tactus.quantity)";
    assert_eq!(server.sql(counts), expected);
    let summary = "SELECT session, parts, frames, complete FROM tactus.session_summary";
    assert_eq!(server.sql(summary), "m1|3|9|t");
    let value = "SELECT region, of, min, mean, max, frames, known FROM tactus.quantity_value WHERE session = 'm1' AND line = 2 AND quantity = 'peak'";
    assert_eq!(server.sql(value), "sheet|kpa|1|2|2.5|60|59");
    assert_eq!(
        server.sql("SELECT site, daq, parts, silent_s < 600 FROM tactus.daq_summary"),
        "berlin|bed3|3|t"
    );
    // a second push does nothing, and the record is unchanged
    assert_eq!(site.done(&["push"]), "");
    assert_eq!(server.sql(counts), expected);
    for (id, content) in ["m1", "m1_p2", "m1_p3"].iter().zip(before) {
        let path = site.record().join(format!("{id}.tactus"));
        assert!(std::fs::read(&path).unwrap() == content, "{id}");
        assert!(archived(&path).is_some(), "{id}");
    }
    assert_eq!(site.stored().len(), 3);
    // a deleted receipt is written again
    std::fs::remove_file(site.record().join("m1_p2.archived.json")).unwrap();
    assert_eq!(site.done(&["push"]), "m1_p2: receipt written\n");
    // the rest of the other session
    add_minute(&site.record(), "m2", 2);
    open.close(at(3600), "asked to stop").unwrap();
    let steps = lines(&site.done(&["push", "--json"]));
    assert_eq!(steps[0]["part"], "m2");
    assert_eq!(server.sql(counts), "4|12|12|4|11");
    let status = lines(&site.done(&["status", "--json"]));
    assert_eq!(
        (&status[0]["closed"], &status[0]["archived"]),
        (&4.into(), &4.into())
    );
}

#[test]
fn archived_session_is_pruned_and_comes_back_the_same() {
    let Some((_server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 2);
    let paths = ["m1", "m1_p2"].map(|id| site.record().join(format!("{id}.tactus")));
    let before = paths.clone().map(|path| std::fs::read(path).unwrap());
    let only = Retention {
        archived_only: true,
        ..Retention::default()
    };
    assert!(
        prune(site.record(), &only, at(7200), false)
            .unwrap()
            .removed
            .is_empty()
    );
    site.done(&["push"]);
    assert_eq!(
        prune(site.record(), &only, at(7200), false)
            .unwrap()
            .removed
            .len(),
        2
    );
    let back = site.folder.path().join("back");
    std::fs::create_dir(&back).unwrap();
    let into = back.to_string_lossy().into_owned();
    // the second pull finds the files in place
    for _ in 0..2 {
        assert_eq!(
            site.done(&["pull", "m1", "--into", &into]).lines().count(),
            2
        );
    }
    for (path, content) in paths.iter().zip(before) {
        let path = back.join(path.file_name().unwrap());
        assert!(std::fs::read(&path).unwrap() == content);
        assert_eq!(SessionReader::open(path).unwrap().len().unwrap(), 3);
    }
    assert_eq!(
        logbook::verify(back.join("m1.tactus"), |_| {})
            .unwrap()
            .findings
            .len(),
        0
    );
    let missing = site.refused(&["pull", "m9", "--into", &into], 3);
    assert!(missing.contains("no session 'm9'"), "{missing}");
    std::fs::remove_file(back.join("m1.tactus")).unwrap();
    std::fs::write(back.join("m1.tactus"), "another file").unwrap();
    let there = site.refused(&["pull", "m1", "--into", &into], 1);
    assert!(
        there.contains("exists already and is not this part"),
        "{there}"
    );
    // a file removed after archiving does not count as missing
    assert_eq!(site.done(&["push"]), "");
}
