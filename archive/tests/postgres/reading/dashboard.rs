//! The dashboard file for Grafana: a read-only role gets rows from each of its queries on a known archive.

use serde_json::Value;

use crate::archive;
use crate::site::Site;

const DASHBOARD: &str = include_str!("../../../grafana/tactus-sheets.json");

/// The values that Grafana substitutes for the variables of a dashboard.
const VARIABLES: [(&str, &str); 4] = [
    ("site", "berlin"),
    ("daq", "bed3"),
    ("region", "sheet"),
    ("quantity", "peak"),
];

/// A query as sent by Grafana for the whole time range of the known archive.
fn sent(query: &str) -> String {
    let (filter, end) = ("$__timeFilter(", ')');
    let mut text = String::new();
    let mut rest = query;
    while let Some((before, after)) = rest.split_once(filter) {
        let (column, after) = after.split_once(end).expect("the macro is closed");
        text +=
            &format!("{before}{column} BETWEEN '2020-01-01T00:00:00Z' AND '2040-01-01T00:00:00Z'");
        rest = after;
    }
    text += rest;
    for (name, value) in VARIABLES {
        text = text.replace(&format!("${name}"), value);
    }
    assert!(!text.contains('$'), "an unknown variable or macro: {text}");
    text
}

#[test]
fn every_query_of_the_dashboard_gives_the_known_rows() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 2);
    site.done(&["push"]);
    let other = Site::added(&server, "paris");
    other.record_session("m1", 1);
    other.done(&["push"]);
    // a session that is still recording
    let mut open = crate::site::begun(&site.record(), "m2", 1);
    open.roll(crate::frames::at(10)).unwrap();
    site.done(&["push"]);
    server.add_role("grafana");
    server.sql("GRANT tactus_reader TO grafana");
    let rows = |query: &str| -> Vec<Value> {
        let query = format!(
            "SELECT coalesce(json_agg(found), '[]') FROM ({}) AS found",
            sent(query)
        );
        serde_json::from_str(&server.sql_as("grafana", &query)).unwrap()
    };
    let dashboard: Value = serde_json::from_str(DASHBOARD).unwrap();
    let variables = dashboard["templating"]["list"].as_array().unwrap();
    for ((name, value), variable) in VARIABLES.iter().zip(variables) {
        assert_eq!(variable["name"], *name);
        let found = rows(variable["query"].as_str().unwrap());
        let values: Vec<&Value> = found
            .iter()
            .flat_map(|row| row.as_object().unwrap().values())
            .collect();
        assert!(values.contains(&&Value::from(*value)), "{name}: {values:?}");
    }
    let panels = dashboard["panels"].as_array().unwrap();
    let mut first = Vec::new();
    for panel in panels {
        let title = panel["title"].as_str().unwrap();
        for target in panel["targets"].as_array().unwrap() {
            let found = rows(target["rawSql"].as_str().unwrap());
            assert!(!found.is_empty(), "{title}: no row");
            if target["format"] == "time_series" {
                assert!(found[0]["time"].is_string(), "{title}: {:?}", found[0]);
            }
            first.push((title, found));
        }
    }
    let of = |title: &str| {
        &first
            .iter()
            .find(|(found, _)| *found == title)
            .expect(title)
            .1
    };
    assert_eq!(of("Machines")[0]["machines"], 2);
    assert_eq!(of("Silent for an hour or longer")[0]["silent"], 0);
    assert_eq!(of("Machines with an active alarm")[0]["alarms"], 2);
    assert_eq!(
        of("Sessions that continue or lack parts")[0]["incomplete"],
        1
    );
    let sheets = of("All sheets");
    let machine = sheets.iter().find(|row| row["site"] == "berlin").unwrap();
    assert_eq!(
        (&machine["daq"], &machine["known"], &machine["frames"]),
        (&"bed3".into(), &0.75.into(), &9.into())
    );
    assert_eq!(machine["alarms"], serde_json::json!(["heel"]));
    let alarm = &of("Alarms that are active or cannot be judged")[0];
    assert_eq!(
        (&alarm["alarm"], &alarm["text"]),
        (&"heel".into(), &"heel: ppi is 9 kPa".into())
    );
    let peak = of("$quantity of $site/$daq, $region");
    assert_eq!(peak.len(), 6);
    let numbers = ["min", "mean", "max"].map(|name| peak[1][name].as_f64());
    assert_eq!(numbers, [Some(1.0), Some(2.0), Some(2.5)]);
    assert_eq!(of("Sessions of $site/$daq").len(), 2);
}
