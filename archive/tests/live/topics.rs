//! What is published, and when.

use std::path::Path;

use dbus::json::{Alarm, Status};
use serde_json::{Value, json};

use crate::live::daemon::{Daemon, report};
use crate::live::mosquitto::Mosquitto;
use crate::live::publisher::{Publisher, machine, mqtt};

const STATUS: &str = "tactus/1/berlin/bed3/status";

#[test]
fn values_are_retained_as_the_json_of_the_commands() {
    let Some(broker) = Mosquitto::open() else {
        return;
    };
    let machine = machine();
    let peer = machine.path().join("peer");
    let daemon = Daemon::start(&peer, report(3));
    // with an interval of an hour, only an event triggers the next message
    let lines = mqtt(&broker, 3600.0);
    let _publisher = Publisher::start(machine.path(), &lines);
    let mut first = broker.watch();
    first.wait(STATUS, |status| status["state"] == "acquiring");
    // a later subscriber gets the retained messages
    let mut later = broker.watch();
    let expected = report(3);
    let status = Status::from(expected.status, format!("unix:{}", peer.display()));
    let quantities: Value = serde_json::from_str(&expected.quantities.unwrap()).unwrap();
    let mut frame =
        json!({"session": "m1", "frame": 17, "wall": "2027-01-15T08:00:00Z", "simulated": true});
    frame
        .as_object_mut()
        .unwrap()
        .extend(quantities.as_object().unwrap().clone());
    let alarm = |number: usize| serde_json::to_value(Alarm::from(expected.alarms[number].clone()));
    for (name, value) in [
        ("alarm/heel", alarm(0).unwrap()),
        ("alarm/hip", alarm(1).unwrap()),
        ("health", serde_json::to_value(&status.health).unwrap()),
        ("quantities", frame),
        ("session", serde_json::to_value(&status.session).unwrap()),
        ("status", serde_json::to_value(&status).unwrap()),
    ] {
        let (message, found) = later.wait(&format!("tactus/1/berlin/bed3/{name}"), |_| true);
        assert_eq!(found, value, "{name}");
        assert!(message.retain, "{name}");
        let about = message.properties.expect("properties");
        assert_eq!(
            about.content_type.as_deref(),
            Some("application/json"),
            "{name}"
        );
        // the broker decrements the remaining time
        let left = about.message_expiry_interval.expect("it expires");
        assert!((3600..=6 * 3600).contains(&left), "{name}: {left}");
    }
    // the session ends
    daemon.change(|report| {
        report.status.session = None;
        report.alarms[0].active = Some(false);
    });
    daemon.happen();
    first.wait("tactus/1/berlin/bed3/alarm/heel", |alarm| {
        alarm["active"] == false
    });
    first.wait("tactus/1/berlin/bed3/quantities", Value::is_null);
    first.wait("tactus/1/berlin/bed3/session", Value::is_null);
}

#[test]
fn killed_process_and_lost_daemon_are_offline() {
    let Some(broker) = Mosquitto::open() else {
        return;
    };
    let machine = machine();
    let peer = machine.path().join("peer");
    let lines = mqtt(&broker, 1.0);
    let mut publisher = Publisher::start(machine.path(), &lines);
    let mut watcher = broker.watch();
    let offline = |words: &'static str| {
        move |status: &Value| {
            let reason = status["reason"].as_str().unwrap_or_default();
            status["state"] == "offline" && reason.contains(words)
        }
    };
    watcher.wait(STATUS, offline("no daemon at unix:"));
    let daemon = Daemon::start(&peer, report(3));
    watcher.wait(STATUS, |status| status["state"] == "acquiring");
    drop(daemon);
    watcher.wait(STATUS, offline("has ended"));
    let _daemon = Daemon::start(&peer, report(4));
    watcher.wait(STATUS, |status| status["session"]["frames_durable"] == 4);
    publisher.kill();
    watcher.wait(STATUS, offline("tactus-archive has ended"));
    // the will is retained too
    broker
        .watch()
        .wait(STATUS, offline("tactus-archive has ended"));
}

#[test]
fn alarms_that_cannot_be_listed_are_not_published_as_none() {
    let Some(broker) = Mosquitto::open() else {
        return;
    };
    let machine = machine();
    let daemon = Daemon::start(&machine.path().join("peer"), report(3));
    let lines = mqtt(&broker, 1.0);
    let _publisher = Publisher::start(machine.path(), &lines);
    let mut watcher = broker.watch();
    watcher.wait(STATUS, |status| status["state"] == "acquiring");
    daemon.change(|report| report.alarms_fault = "the alarms are locked".to_owned());
    watcher.wait(STATUS, |status| {
        status["state"] == "offline" && status["reason"] == "the alarms are locked"
    });
    daemon.change(|report| report.alarms_fault.clear());
    watcher.wait(STATUS, |status| status["state"] == "acquiring");
}

#[test]
fn home_assistant_reads_the_values_by_its_templates() {
    let Some(broker) = Mosquitto::open() else {
        return;
    };
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let Some(python) = needs::python(folder, "jinja", &["jinja2==3.1.6"]) else {
        return;
    };
    let machine = machine();
    let daemon = Daemon::start(&machine.path().join("peer"), report(3));
    let lines = format!(
        "host = \"127.0.0.1\"\nport = {}\nhome_assistant = \"homeassistant\"\n",
        broker.port()
    );
    let _publisher = Publisher::start(machine.path(), &lines);
    let mut watcher = broker.watch();
    let topic = "homeassistant/device/tactus_berlin_bed3/config";
    let (message, device) = watcher.wait(topic, |device| device["components"].is_object());
    assert_eq!(
        message
            .properties
            .and_then(|about| about.message_expiry_interval),
        None
    );
    assert_eq!(device["device"]["model"], "conductive sheet (SIMULATED)");
    assert_eq!(
        device["components"]["sheet_load"]["unit_of_measurement"],
        "N"
    );
    let read = || {
        let mut watcher = broker.watch();
        watcher.wait(STATUS, |_| true);
        let messages: Value = watcher
            .seen
            .iter()
            .cloned()
            .map(|(topic, text)| (topic, json!(text)))
            .collect();
        let asked = json!({"device": device, "messages": messages}).to_string();
        let program = "import json, sys, jinja2\n\
            asked = json.loads(sys.argv[1])\n\
            for id, entity in sorted(asked['device']['components'].items()):\n    \
                value = json.loads(asked['messages'][entity['state_topic']])\n    \
                print(id, jinja2.Environment().from_string(entity['value_template']).render(value_json=value))\n";
        needs::run(std::process::Command::new(&python).args(["-c", program, &asked])).unwrap()
    };
    assert_eq!(
        read(),
        "alarm_heel ON\nalarm_hip None\nframes 3\nhealth ON\nheel_load 90.0\nsheet_contact 1200.0\nsheet_load 412.5\nstate acquiring\n"
    );
    daemon.change(|report| {
        report.status.session = None;
        report.quantities = None;
        report.alarms[0].active = Some(false);
        report.alarms[0].level = Some("ok".to_owned());
    });
    daemon.happen();
    watcher.wait("tactus/1/berlin/bed3/session", Value::is_null);
    watcher.wait(STATUS, |_| true);
    assert_eq!(
        read(),
        "alarm_heel OFF\nalarm_hip None\nframes None\nhealth ON\nheel_load None\nsheet_contact None\nsheet_load None\nstate acquiring\n"
    );
}
