//! Instruments are discovered on the network, and their identity is queried; they receive no other message (fact sheet
//! lxi-discovery, section 8).
//!
//! Each test runs itself again in a separate network namespace, where nothing else is announced and the port mapper's
//! port is free; if no namespace is available, the test reports that and passes.
//! `simulator/tests/served_rig/clients.rs` tests a host shared with avahi and python-zeroconf, and lxi-tools; a story
//! tests that a running daemon uses nothing that was discovered.

use std::process::{Command, Output};
use std::time::{Duration, Instant};

use crate::stage::{instant, within};
use mdns_sd::{IfKind, ServiceDaemon, ServiceEvent};
use serde_json::Value;
use simulator::{Profile, ServeOptions, SimulatedRig};
use tokio::net::UdpSocket;

/// Environment variable, set in the run in the separate network namespace.
const ALONE: &str = "TACTUS_TEST_ALONE";
const QUIET: &str = "ip link set lo up";
const MULTICAST: &str = "ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo";

/// Whether this run has a separate network namespace. If not, creates one, prepares it with the commands `network`, and
/// runs this test in it.
fn has_network(test: &str, network: &str) -> bool {
    if std::env::var_os(ALONE).is_some() {
        return true;
    }
    let unshare = |rights: &[&str], then: &str, args: &[&str]| -> std::io::Result<Output> {
        Command::new("unshare")
            .args(rights)
            .args(["--net", "sh", "-c", &format!("{network} && {then}"), "sh"])
            .args(args)
            .env(ALONE, "1")
            .output()
    };
    let ways: [&[&str]; 2] = [&[], &["--user", "--map-root-user"]];
    let can =
        |rights: &&&[&str]| unshare(rights, "true", &[]).is_ok_and(|done| done.status.success());
    let Some(rights) = ways.iter().find(can) else {
        let why = "no network of its own can be had here (unshare and ip are needed)";
        needs::lacking("NETNS", why);
        return false;
    };
    let own = std::env::current_exe().unwrap();
    let args = [own.to_str().unwrap(), "--exact", test, "--nocapture"];
    let done = unshare(rights, "exec \"$@\"", &args).unwrap();
    let message = String::from_utf8_lossy(&done.stdout).into_owned();
    println!("{message}");
    assert!(
        done.status.success() && message.contains("1 passed"),
        "{message}{}",
        String::from_utf8_lossy(&done.stderr)
    );
    false
}

/// A rig that records received messages, and options to serve it on free ports.
fn listening() -> (SimulatedRig, ServeOptions) {
    let rig = instant(&Profile::default());
    rig.keep_transcript();
    let options = ServeOptions {
        port_6221: 0,
        port_34980a: 0,
        ..ServeOptions::default()
    };
    (rig, options)
}

fn assert_only_identity_was_queried(rig: &SimulatedRig) {
    let received: Vec<String> = rig
        .transcript()
        .into_iter()
        .map(|message| message.received)
        .collect();
    assert!(
        !received.is_empty() && received.iter().all(|received| received == "*IDN?"),
        "{received:?}"
    );
}

/// Runs `tactusd --discover`; returns instruments and notes.
async fn discovered(addresses: Vec<String>) -> (Vec<Value>, Vec<String>) {
    let requested = tokio::task::spawn_blocking(move || {
        Command::new(env!("CARGO_BIN_EXE_tactusd"))
            .args(["--json", "--discover"])
            .args(addresses)
            .output()
            .unwrap()
    });
    let message = within(requested).await.unwrap();
    assert!(message.status.success(), "{message:?}");
    let text = String::from_utf8(message.stdout).unwrap();
    let lines = text
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap());
    let (notes, instruments): (Vec<Value>, Vec<Value>) =
        lines.partition(|line| line["event"] == "note");
    let notes = notes
        .iter()
        .map(|note| note["text"].as_str().unwrap().to_owned());
    (instruments, notes.collect())
}

/// The instrument of this model; panics if there are several.
fn one<'a>(found: &'a [Value], model: &str) -> Option<&'a Value> {
    let of_model = |found: &&Value| {
        found["identity"]
            .as_str()
            .is_some_and(|message| message.contains(model))
    };
    let lines: Vec<&Value> = found.iter().filter(of_model).collect();
    assert!(lines.len() < 2, "{model} is listed twice: {lines:#?}");
    lines.first().copied()
}

#[tokio::test(flavor = "multi_thread")]
async fn two_announced_simulators_are_each_listed_once() {
    let name = "discovery::two_announced_simulators_are_each_listed_once";
    if !has_network(name, MULTICAST) {
        return;
    }
    let (rig, options) = listening();
    let options = ServeOptions {
        announce: true,
        port_vxi11: Some(0),
        ..options
    };
    let server = simulator::serve(rig.clone(), &options).await.unwrap();
    let browser = ServiceDaemon::new().unwrap();
    browser.enable_interface(IfKind::LoopbackV4).unwrap();

    // both instruments publish the same properties for every service type
    let mut properties: Vec<(String, Vec<(String, String)>)> = Vec::new();
    let raw = browser.browse("_scpi-raw._tcp.local.").unwrap();
    for (kind, events, wanted) in [
        ("_scpi-raw._tcp.local.", raw.clone(), 2),
        (
            "_lxi._tcp.local.",
            browser.browse("_lxi._tcp.local.").unwrap(),
            1,
        ),
        (
            "_http._tcp.local.",
            browser.browse("_http._tcp.local.").unwrap(),
            1,
        ),
        (
            "_vxi-11._tcp.local.",
            browser.browse("_vxi-11._tcp.local.").unwrap(),
            1,
        ),
    ] {
        let mut names = Vec::new();
        while names.len() < wanted {
            if let ServiceEvent::ServiceResolved(service) =
                within(events.recv_async()).await.unwrap()
            {
                let name = service.fullname.trim_end_matches(kind).to_owned();
                let text = service.txt_properties.iter();
                let text = text.map(|entry| (entry.key().to_owned(), entry.val_str().to_owned()));
                if !names.contains(&name) {
                    names.push(name.clone());
                    properties.push((name, text.collect()));
                }
            }
        }
    }

    let begun = Instant::now();
    let mut tries = 0;
    let found = loop {
        let (found, _) = discovered(Vec::new()).await;
        tries += 1;
        if one(&found, "6221").is_some() && one(&found, "34980A").is_some() {
            break found;
        }
        assert!(begun.elapsed() < crate::stage::DEADLINE, "{found:#?}");
    };
    let took = begun.elapsed();
    println!("both listed by try {tries}, {took:?} after the start of the first");
    // ten times the promised time
    assert!(took < Duration::from_secs(50), "{took:?}");
    for (model, section) in [("6221", "[source]"), ("34980A", "[switch]")] {
        let seen = one(&found, model).unwrap();
        let identity = seen["identity"].as_str().unwrap();
        assert!(
            seen["found_by"].as_str().unwrap().contains("mdns"),
            "{seen}"
        );
        assert!(
            seen["proposal"].as_str().unwrap().starts_with(section),
            "{seen}"
        );
        let mut wanted = vec![("txtvers".to_owned(), "1".to_owned())];
        let keys = ["Manufacturer", "Model", "SerialNumber", "FirmwareVersion"];
        wanted.extend(
            keys.map(str::to_owned)
                .into_iter()
                .zip(identity.splitn(4, ',').map(str::to_owned)),
        );
        let announced = seen["name"].as_str().unwrap();
        let own: Vec<_> = properties
            .iter()
            .filter(|(name, _)| name.trim_end_matches('.') == announced)
            .collect();
        assert_eq!(
            own.len(),
            if model == "6221" { 1 } else { 4 },
            "{announced}: {properties:#?}"
        );
        for (_, text) in own {
            assert_eq!(text, &wanted, "{announced}");
        }
    }
    assert_only_identity_was_queried(&rig);

    // without a goodbye packet the instruments would be listed for two minutes, until their records expire
    let begun = Instant::now();
    server.stop().await;
    let mut gone = Vec::new();
    while gone.len() < 2 {
        let event = tokio::time::timeout(Duration::from_secs(300), raw.recv_async()).await;
        if let ServiceEvent::ServiceRemoved(_, name) = event.expect("a goodbye").unwrap()
            && !gone.contains(&name)
        {
            gone.push(name);
        }
    }
    let took = begun.elapsed();
    println!("both gone {took:?} after a clean stop");
    assert!(took < Duration::from_secs(50), "{took:?}");
    browser.shutdown().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn without_multicast_given_addresses_are_still_queried() {
    let name = "discovery::without_multicast_given_addresses_are_still_queried";
    if !has_network(name, QUIET) {
        return;
    }
    let (rig, options) = listening();
    let server = simulator::serve(rig.clone(), &options).await.unwrap();
    let address = format!("tcp:{}", server.ready().source);
    // the same address twice, and an address without an instrument
    let requested = vec![
        address.clone(),
        address.clone(),
        "tcp:127.0.0.1:9".to_owned(),
    ];
    let (found, notes) = discovered(requested).await;
    assert!(
        notes
            .iter()
            .any(|note| note.contains("this machine has no multicast")),
        "{notes:?}"
    );
    let source = one(&found, "6221").expect("it was asked");
    assert_eq!(
        (&source["address"], &source["found_by"]),
        (&address.into(), &"address".into())
    );
    assert_eq!(found.len(), 2, "{found:#?}");
    let nobody = found
        .iter()
        .find(|seen| seen["identity"].is_null())
        .expect("it is reported");
    assert!(
        nobody["remark"].as_str().is_some_and(|why| !why.is_empty()),
        "{nobody}"
    );
    assert!(nobody["proposal"].is_null(), "{nobody}");
    assert_only_identity_was_queried(&rig);
}

/// Replies to a port mapper's GETPORT call: first with another message, then twice with this port.
async fn map_ports(socket: UdpSocket, port: u16) {
    let mut call = [0; 256];
    while let Ok((length, peer)) = socket.recv_from(&mut call).await {
        // program 100000, version 2, procedure 3, no credentials; core channel, version 1, TCP
        let wanted = [0, 2, 100_000, 2, 3, 0, 0, 0, 0, 0x0006_07AF, 1, 6, 0];
        let words: Vec<u32> = call[4..length]
            .chunks_exact(4)
            .map(|word| u32::from_be_bytes(word.try_into().unwrap()))
            .collect();
        assert_eq!(words, wanted);
        let sound = [1, 0, 0, 0, 0, u32::from(port)]
            .map(u32::to_be_bytes)
            .concat();
        let sound = [&call[..4], &sound].concat();
        for answer in [
            b"HTTP/1.1 400 Bad Request\r\n".as_slice(),
            &sound[..14],
            &sound,
            &sound,
        ] {
            socket.send_to(answer, peer).await.unwrap();
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_to_a_vxi_11_broadcast_is_one_instrument() {
    let name = "discovery::an_answer_to_a_vxi_11_broadcast_is_one_instrument";
    // a dummy interface that supports broadcasts, if the kernel provides it
    let network = format!(
        "{QUIET} && {{ ip link add wire type dummy && ip address add 192.0.2.1/24 brd + dev wire && \
         ip link set wire up || true; }}"
    );
    if !has_network(name, &network) {
        return;
    }
    let (rig, options) = listening();
    // the instrument replies on two interfaces, and must be listed once
    let options = ServeOptions {
        bind: "0.0.0.0".to_owned(),
        port_34980a: 5025,
        port_vxi11: Some(0),
        ..options
    };
    let server = simulator::serve(rig.clone(), &options).await.unwrap();
    let core = server.ready().vxi11.clone().unwrap();
    let core: u16 = core.rsplit(':').next().unwrap().parse().unwrap();
    let worker = UdpSocket::bind("0.0.0.0:111").await.unwrap();
    let worker = tokio::spawn(map_ports(worker, core));
    let (found, notes) = discovered(Vec::new()).await;
    println!("{found:#?}, {notes:?}");
    let mainframe = one(&found, "34980A").expect("it answered");
    assert_eq!(found.len(), 1, "{found:#?}");
    assert_eq!(mainframe["found_by"], "vxi-11");
    let address = mainframe["address"].as_str().unwrap();
    assert!(address.ends_with(":5025"), "{address}");
    assert!(
        mainframe["proposal"]
            .as_str()
            .unwrap()
            .starts_with("[switch]"),
        "{mainframe}"
    );
    assert_only_identity_was_queried(&rig);
    server.stop().await;

    // an instrument to which the daemon cannot connect is listed, but not proposed
    let options = ServeOptions {
        port_34980a: 0,
        port_vxi11: Some(core),
        ..options
    };
    let server = simulator::serve(rig.clone(), &options).await.unwrap();
    let (found, _) = discovered(Vec::new()).await;
    let mainframe = one(&found, "34980A").expect("it answered");
    assert!(
        mainframe["address"].is_null() && mainframe["proposal"].is_null(),
        "{mainframe}"
    );
    assert!(
        mainframe["remark"]
            .as_str()
            .unwrap()
            .contains("VXI-11 only"),
        "{mainframe}"
    );
    assert_only_identity_was_queried(&rig);
    server.stop().await;
    worker.abort();
}
