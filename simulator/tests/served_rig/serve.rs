//! The program: its ready line, its ports, its serial port, its clean exit.

use std::process::Command;
use std::time::Duration;

use crate::program::Served;
use gpio_mux::GpioMux;
use keithley_6221::Keithley6221;
use keysight_34980a::Keysight34980a;
use mdns_sd::{IfKind, ServiceDaemon, ServiceEvent};
use rig::{Link, Move, Switch, connect_tcp, open_serial};
use serde_json::Value;
use survey::{Electrode, Relay};

const DEADLINE: Duration = Duration::from_secs(20);

async fn link(served: &Served, instrument: &str) -> Link<rig::BoxStream> {
    let stream = connect_tcp(served.address(instrument), DEADLINE)
        .await
        .unwrap();
    Link::new(stream, instrument, DEADLINE)
}

#[tokio::test]
async fn drivers_talk_to_the_program_over_tcp_and_it_ends_cleanly() {
    let served = Served::start(&["--slot", "3=34934A,4x128"]);
    assert_eq!(served.ready["serial"], Value::Null);
    let source = Keithley6221::connect(link(&served, "6221").await)
        .await
        .unwrap();
    assert!(source.identity().contains("MODEL 6221"));
    let mainframe = Keysight34980a::connect(link(&served, "34980a").await)
        .await
        .unwrap();
    let modules = mainframe.modules();
    assert_eq!(modules[0], "34924A".parse().ok());
    assert_eq!(modules[2], "34934A,4x128".parse().ok());
    assert_eq!(served.terminate(), Some(0));
}

#[tokio::test]
async fn mainframe_serves_many_clients_and_source_one_at_a_time() {
    let served = Served::start(&[]);
    let mut first = link(&served, "34980a").await;
    let mut second = link(&served, "34980a").await;
    first.send("ROUT:CLOS (@1036)").await.unwrap();
    assert_eq!(
        first.ask("*OPC?").await.unwrap().trim_start_matches('+'),
        "1"
    );
    assert_eq!(second.ask("ROUT:CLOS? (@1036)").await.unwrap(), "1");
    let mut source = link(&served, "6221").await;
    source.send("SOUR:CURR 1e-3;:OUTP ON").await.unwrap();
    assert_eq!(source.ask("OUTP?").await.unwrap(), "1");
    drop(source);
    // The output stays on after its client disconnects.
    let mut next = link(&served, "6221").await;
    assert_eq!(next.ask("OUTP?").await.unwrap(), "1");
}

#[tokio::test]
async fn the_board_is_reached_through_its_serial_port_again_and_again() {
    let served = Served::start(&["--profile", "gpio-board"]);
    let path = served.ready["serial"].as_str().unwrap();
    for electrode in [3, 7] {
        let link = Link::new(open_serial(path, 115_200).unwrap(), path, DEADLINE);
        let mut board = GpioMux::connect(link).await.unwrap();
        let relays = [Relay(100 + electrode), Relay(200 + electrode + 1)];
        board
            .move_relays(&[Move::Close(relays.to_vec())])
            .await
            .unwrap();
        board.settle().await.unwrap();
        assert_eq!(board.closed(&relays).await.unwrap(), [true, true]);
        let plus = Electrode::from_number(electrode as usize);
        assert_eq!(board.state().await.unwrap().0[0], plus);
        board.open_verified(&relays).await.unwrap();
    }
}

/// Longer than any multicast takes on a busy machine, and shorter than the life of an announcement without its goodbye
/// (RFC 6762 section 10: 120 s and 75 minutes).
const ANNOUNCED: Duration = Duration::from_secs(60);

#[tokio::test]
async fn announced_instruments_are_found_by_name_and_withdrawn() {
    let browser = ServiceDaemon::new().unwrap();
    browser.enable_interface(IfKind::LoopbackV4).unwrap();
    let events = browser.browse("_scpi-raw._tcp.local.").unwrap();
    // A different serial number from other simulators on this machine.
    let folder = tempfile::tempdir().unwrap();
    let profile = folder.path().join("announced.toml");
    let serial = std::process::id();
    std::fs::write(&profile, format!("[source]\nserial = \"A{serial}\"\n")).unwrap();
    let served = Served::start(&["--announce", "--profile", profile.to_str().unwrap()]);
    let ours = |name: &str| name.contains(&format!("#A{serial}"));
    let found = tokio::time::timeout(ANNOUNCED, async {
        loop {
            if let Ok(ServiceEvent::ServiceResolved(service)) = events.recv_async().await
                && ours(&service.fullname)
            {
                return service;
            }
        }
    });
    let Ok(service) = found.await else {
        let why = "no multicast reaches this machine's own loopback interface";
        return needs::lacking("MULTICAST", why);
    };
    let port = service.port.to_string();
    assert!(served.address("6221").ends_with(&port));
    assert_eq!(
        service.txt_properties.get_property_val_str("Model"),
        Some("MODEL 6221")
    );
    assert_eq!(served.terminate(), Some(0));
    tokio::time::timeout(ANNOUNCED, async {
        while let Ok(event) = events.recv_async().await {
            if matches!(event, ServiceEvent::ServiceRemoved(_, name) if ours(&name)) {
                return;
            }
        }
    })
    .await
    .expect("a goodbye at a clean stop");
    browser.shutdown().unwrap();
}

#[test]
fn what_cannot_be_served_is_refused_with_the_right_code() {
    let run = |arguments: &[&str]| {
        let ended = Command::new(env!("CARGO_BIN_EXE_tactus-sim"))
            .args(arguments)
            .output()
            .unwrap();
        (
            ended.status.code(),
            String::from_utf8(ended.stderr).unwrap(),
        )
    };
    let (code, reported) = run(&["serve", "--slot", "9=34924A"]);
    assert_eq!(code, Some(2));
    assert!(reported.contains("slots are 1 to 8"), "{reported}");
    let (code, reported) = run(&["serve", "--profile", "no-such-profile"]);
    assert_eq!(code, Some(78));
    assert!(
        reported.contains("pairs-34924a, ") && reported.contains(", gpio-board"),
        "{reported}"
    );
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let (code, reported) = run(&["serve", "--port-6221", &port]);
    assert_eq!(code, Some(1));
    assert!(
        reported.contains(&port) && reported.contains("for the 6221"),
        "{reported}"
    );
}

#[test]
fn with_json_errors_are_objects() {
    for (words, code, kind, says) in [
        (
            &["status", "--control", "/nowhere", "--json"][..],
            1,
            "failed",
            "/nowhere",
        ),
        (
            &["list", "--frobnicate", "--json"][..],
            2,
            "usage",
            "--frobnicate",
        ),
    ] {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_tactus-sim"))
            .args(words)
            .output()
            .unwrap();
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{message}");
        let error: serde_json::Value =
            serde_json::from_str(&message).unwrap_or_else(|_| panic!("{message}"));
        assert_eq!(error["event"], "error", "{message}");
        assert_eq!(error["kind"], kind, "{message}");
        assert_eq!(error["code"], code, "{message}");
        assert!(error["text"].as_str().unwrap().contains(says), "{message}");
    }
}
