//! Wrong clocks: on the recording machine, and during a push.

use std::time::{Duration, SystemTime};

use logbook::{SessionHeader, SessionWriter, archived};
use survey::Protocol;

use crate::archive;
use crate::frames::at;
use crate::site::more_frames;

const DAY: i64 = 86_400;

#[test]
fn wrong_clock_of_the_machine_loses_and_repeats_nothing() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    // recorded with the clock at 1970, and with the clock at 2099 before it was corrected
    for (id, second) in [("m1970", -1_699_990_000), ("m2099", 2_380_000_000)] {
        let header = SessionHeader::new(id, at(second), Protocol::sheffield(8).unwrap());
        let mut writer = SessionWriter::create(site.record(), &header).unwrap();
        more_frames(&mut writer, 1);
        writer.close(at(second + DAY), "asked to stop").unwrap();
    }
    let later = SystemTime::now() + Duration::from_secs(70 * 365 * 86_400);
    let file = std::fs::File::options()
        .append(true)
        .open(site.record().join("m2099.tactus"))
        .unwrap();
    file.set_modified(later).unwrap();
    assert_eq!(site.done(&["push"]).matches(": archived as").count(), 2);
    assert!(archived(site.record().join("m2099.tactus")).is_some());
    // a file with a modification time in the future is confirmed once, not at every push
    assert_eq!(site.done(&["push"]), "");
    let years = "SELECT string_agg(extract(year FROM started)::text, ',' ORDER BY started) FROM tactus.part";
    assert_eq!(server.sql(years), "1970,2099");
    // the archiving time is by the server's clock
    let recent = "SELECT count(*) FROM tactus.part WHERE archived_at BETWEEN now() - interval '10 min' AND now()";
    assert_eq!(server.sql(recent), "2");
    site.done(&["verify"]);
}

#[test]
fn push_with_a_clock_of_the_past_is_repeated_once() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    let library = std::fs::read_dir("/usr/lib")
        .unwrap()
        .filter_map(Result::ok);
    let library = library
        .map(|folder| folder.path().join("faketime/libfaketimeMT.so.1"))
        .find(|library| library.exists());
    let Some(library) = library else {
        return needs::lacking("FAKETIME", "libfaketime is not installed");
    };
    site.record_session("m1", 1);
    let push = || {
        let mut command = site.command(&["push"]);
        command
            .env("LD_PRELOAD", &library)
            .env("FAKETIME", "@2001-02-03 04:05:06")
            .env("FAKETIME_DONT_FAKE_MONOTONIC", "1")
            .env("NO_FAKE_STAT", "1");
        let output = command.output().unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    assert!(push().contains("m1: archived as"));
    // the receipt, dated 2001, is valid for the file
    assert_eq!(push(), "");
    assert_eq!(site.done(&["push"]), "");
    let recent = "SELECT count(*) FROM tactus.part WHERE archived_at > now() - interval '10 min'";
    assert_eq!(server.sql(recent), "1");
}
