//! Quantities of frames that were recorded without times.

use crate::scene::{done, lines, refused, session};

#[test]
fn frames_without_times_are_one_span_of_unknown_begin() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let export = "export m20270115_1 --format csv --out out.csv";
    done(folder.path(), &export.split(' ').collect::<Vec<_>>());
    let line = |more: &str| format!("quantities out.case --preset disc-tank --noise-v 2e-6 {more}");
    let asked = |more: &str| {
        let line = line(more);
        done(folder.path(), &line.split_whitespace().collect::<Vec<_>>())
    };
    let rows = lines(&asked("--json"));
    assert!(rows.iter().all(|row| row["begin"].is_null()), "{rows:?}");
    let of = |quantity: &str| rows.iter().find(|row| row["quantity"] == quantity);
    assert_eq!(of("known").unwrap()["frames"], 3);
    assert!(of("load").unwrap()["max"].as_f64().unwrap() > 0.0);
    for over_time in ["speed", "path", "dose", "unrelieved", "unrelieved-area"] {
        assert_eq!(of(over_time), None);
    }
    let table = asked("--csv");
    let mut rows = table.lines().skip(1);
    assert!(rows.all(|row| row.starts_with(",sheet,")), "{table}");
    let page = asked("");
    assert!(
        page.lines().any(|row| row.starts_with("not known")),
        "{page}"
    );
    assert!(page.contains("largest dose not known"), "{page}");
    let frame = &lines(&asked("--each-frame --json"))[2];
    assert!(frame["regions"][0]["values"]["load"].is_f64(), "{frame}");
    assert!(frame["regions"][0]["values"]["dose"].is_null(), "{frame}");
    // spans of one minute are impossible without times
    let every = line("--every 1m");
    let message = refused(folder.path(), &every.split(' ').collect::<Vec<_>>(), 2);
    assert!(
        message.contains("--every") && message.contains("--each-frame"),
        "{message}"
    );
}
