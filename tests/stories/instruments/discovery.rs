//! Two simulators announce themselves: both are listed with their reply to `*IDN?`, and a running daemon uses neither.
//! The time is printed.

use std::process::Command;

use serde_json::Value;

use crate::test_rig::{self, Needs, ask};

/// A private network namespace without other announcements; `$0` is the program, `$1` the folder.
const ALONE: &str = r#"
set -e
ip link set lo up multicast on
ip route add 224.0.0.0/4 dev lo
"$0" tactus-sim serve --announce --instant --port-6221 0 --port-34980a 0 --port-vxi11 0 > "$1/ready" &
bench=$!
trap 'kill $bench' EXIT
for _ in $(seq 600); do [ -s "$1/ready" ] && break; sleep 0.1; done
for _ in 1 2 3 4 5 6 7 8; do
    start=$(date +%s%N)
    "$0" tactusd --discover --json > "$1/found"
    end=$(date +%s%N)
    echo $(( (end - start) / 1000000 )) > "$1/took_ms"
    grep -q 6221 "$1/found" && grep -q 34980A "$1/found" && break
done
"#;

#[test]
fn two_announced_simulators_are_each_listed_once() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let alone = Command::new("unshare")
        .args(["--net", "sh", "-c", ALONE, env!("CARGO_BIN_EXE_programs")])
        .arg(stage.path())
        .output();
    let message = match &alone {
        Ok(ended) if ended.status.success() => None,
        Ok(ended) => Some(String::from_utf8_lossy(&ended.stderr).into_owned()),
        Err(fault) => Some(fault.to_string()),
    };
    let read = |file: &str| std::fs::read_to_string(stage.path().join(file)).unwrap_or_default();
    if let Some(message) = message.filter(|_| read("ready").is_empty()) {
        let why = format!("no network of its own can be had here ({})", message.trim());
        return needs::lacking("NETNS", &why);
    }
    let found: Vec<Value> = read("found")
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|fault| panic!("{line}: {fault}")))
        .collect();
    let seen: Vec<&Value> = found
        .iter()
        .filter(|line| line["event"] == "instrument")
        .collect();
    let ready: Value = serde_json::from_str(&read("ready")).expect("a line of JSON");
    for (of, model, section) in [
        ("6221", ",MODEL 6221,", "[source]"),
        ("34980a", ",34980A,", "[switch]"),
    ] {
        let port = ready[of]
            .as_str()
            .and_then(|address| address.rsplit(':').next())
            .expect("a port");
        let found: Vec<&&Value> = seen
            .iter()
            .filter(|seen| {
                seen["identity"]
                    .as_str()
                    .is_some_and(|identity| identity.contains(model))
            })
            .collect();
        assert_eq!(found.len(), 1, "{of} is listed once: {seen:?}");
        let (address, proposal) = (&found[0]["address"], &found[0]["proposal"]);
        assert_eq!(
            address,
            &Value::from(format!("tcp:127.0.0.1:{port}")),
            "{seen:?}"
        );
        assert!(
            proposal
                .as_str()
                .is_some_and(|lines| lines.starts_with(section)),
            "{proposal}"
        );
        assert!(
            found[0]["found_by"]
                .as_str()
                .is_some_and(|ways| ways.contains("mdns")),
            "{seen:?}"
        );
    }
    let took: u64 = read("took_ms").trim().parse().expect("milliseconds");
    println!("both listed {took} ms after the start of tactusd --discover");
    // ten times the five seconds that are promised: a busy machine may need another try
    assert!(took <= 50_000, "{took} ms");
}

#[test]
fn running_daemon_lists_a_given_address_and_goes_on() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    // a listener that counts the bytes sent to it
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = listener.local_addr().expect("it has one").port();
    let stranger = std::thread::spawn(move || {
        use std::io::{Read, Write};
        let (mut client, _) = listener.accept().expect("somebody asks");
        let mut received = Vec::new();
        let mut chunk = [0; 256];
        while !received.ends_with(b"\n") {
            let length = client.read(&mut chunk).expect("a question");
            received.extend(&chunk[..length]);
        }
        client
            .write_all(b"Agilent Technologies,34980A,MY1,2.43\n")
            .expect("an answer");
        // until it disconnects
        client.read_to_end(&mut received).ok();
        String::from_utf8_lossy(&received).into_owned()
    });
    let address = format!("tcp:127.0.0.1:{port}");
    let found = ask(
        &stage,
        &[
            "instruments",
            "discover",
            "--no-mdns",
            "--no-broadcast",
            &address,
        ],
    );
    let seen = found
        .iter()
        .find(|line| line["address"] == address.as_str())
        .unwrap_or_else(|| panic!("{found:?}"));
    assert_eq!(
        (&seen["in_use"], &seen["found_by"]),
        (&false.into(), &"address".into())
    );
    assert_eq!(
        stranger.join().expect("it heard something"),
        "*IDN?\n",
        "nothing else is said to it"
    );
    let used = found.iter().filter(|line| line["in_use"] == true);
    assert_eq!(
        used.count(),
        2,
        "the configured ones are listed as such: {found:?}"
    );
    let instruments = ask(&stage, &["instruments"]);
    assert!(
        instruments
            .iter()
            .all(|used| used["address"] != address.as_str()),
        "{instruments:?}"
    );
}
