//! Login and certificates of the broker: errors name the fault and the remedy, and uploads continue.

use crate::authority::{authority, issue};
use crate::live::daemon::{Daemon, report};
use crate::live::mosquitto::Mosquitto;
use crate::live::publisher::{Publisher, machine, mqtt};

fn write_private(path: &std::path::Path, text: &str) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::write(path, text).unwrap();
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600)).unwrap();
}

#[test]
fn login_and_topics_that_are_refused_are_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("rights"),
        "user bed3\ntopic readwrite tactus/1/berlin/bed3/status\n",
    )
    .unwrap();
    if !needs::program("MOSQUITTO", "mosquitto_passwd") {
        return;
    }
    let made = std::process::Command::new("mosquitto_passwd")
        .args(["-b", "-c"])
        .arg(folder.path().join("users"))
        .args(["bed3", "a word"])
        .output()
        .unwrap();
    assert!(made.status.success(), "{made:?}");
    let rules = "allow_anonymous false\npassword_file FOLDER/users\nacl_file FOLDER/rights\n";
    let Some(broker) = Mosquitto::start(folder, rules) else {
        return;
    };
    let machine = machine();
    let _daemon = Daemon::start(&machine.path().join("peer"), report(1));
    let server = mqtt(&broker, 1.0);
    let refused = |lines: &str, words: &str| {
        let mut publisher = Publisher::start(machine.path(), lines);
        publisher.wait_for(words);
        // the archive continues: it tries to reach its catalogue
        publisher.wait_for("cannot reach PostgreSQL");
        assert!(publisher.child.try_wait().unwrap().is_none());
        publisher.kill();
    };
    refused(
        &server,
        "refuses the login: correct mqtt.user and mqtt.password_file",
    );
    let user = format!("{server}user = \"bed3\"\npassword_file = \"mqtt.password\"\n");
    let password = machine.path().join("mqtt.password");
    write_private(&password, "another word\n");
    refused(&user, "refuses the login");
    write_private(&password, "a word\n");
    refused(
        &user,
        "refuses tactus/1/berlin/bed3/health: NotAuthorized; the user 'bed3' needs the right to write it",
    );
    // an invalid file ends the program before anything is sent
    std::fs::remove_file(&password).unwrap();
    let mut publisher = Publisher::start(machine.path(), &user);
    publisher.wait_for("mqtt.password_file: ");
    assert_eq!(publisher.child.wait().unwrap().code(), Some(78));
}

#[test]
fn broker_is_trusted_by_its_authority_only() {
    if !needs::program("MOSQUITTO", "openssl") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let machine = machine();
    authority(machine.path(), "ca");
    authority(machine.path(), "other");
    issue(machine.path(), "ca", "server");
    for name in ["ca.pem", "server.crt", "server.key"] {
        std::fs::copy(machine.path().join(name), folder.path().join(name)).unwrap();
    }
    let rules = "allow_anonymous true\ncafile FOLDER/ca.pem\ncertfile FOLDER/server.crt\nkeyfile FOLDER/server.key\n";
    let Some(broker) = Mosquitto::start(folder, rules) else {
        return;
    };
    let _daemon = Daemon::start(&machine.path().join("peer"), report(1));
    let lines = |ca: &str| {
        format!(
            "host = \"127.0.0.1\"\nport = {}\nca = \"{ca}.pem\"\n",
            broker.port()
        )
    };
    let publisher = Publisher::start(machine.path(), &lines("other"));
    publisher.wait_for("no trusted connection to 127.0.0.1");
    publisher.wait_for("other.pem");
    drop(publisher);
    let mut publisher = Publisher::start(machine.path(), &lines("none"));
    publisher.wait_for("mqtt.ca: ");
    assert_eq!(publisher.child.wait().unwrap().code(), Some(78));
    Publisher::start(machine.path(), &lines("ca")).wait_for("mqtt: connected to 127.0.0.1");
}
