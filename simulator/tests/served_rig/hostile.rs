//! Hostile and exhaustive clients: limits, overflow, garbage, and their error messages.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::program::Served;

struct Client(BufReader<TcpStream>);

impl Client {
    fn at(address: &str) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        let deadline = Some(Duration::from_secs(20));
        stream.set_read_timeout(deadline).unwrap();
        stream.set_nodelay(true).unwrap();
        Self(BufReader::new(stream))
    }

    fn address(&self) -> String {
        self.0.get_ref().local_addr().unwrap().to_string()
    }

    fn send(&mut self, bytes: &[u8]) {
        self.0.get_mut().write_all(bytes).unwrap();
    }

    fn ask(&mut self, query: &str) -> String {
        self.send(format!("{query}\n").as_bytes());
        let mut line = String::new();
        self.0.read_line(&mut line).unwrap();
        assert!(line.ends_with('\n'), "{query}: {line:?}");
        line.trim_end().to_owned()
    }

    fn error(&mut self) -> String {
        self.ask("SYST:ERR?")
    }
}

fn number(text: &str) -> f64 {
    text.parse()
        .unwrap_or_else(|_| panic!("'{text}' is no number"))
}

/// Each header with MIN, MAX and DEF; the reported limits can be set.
#[test]
fn every_limit_is_listed_and_can_be_set() {
    let served = Served::start(&["--profile", "pairs-34924a"]);
    let of_source = [
        "SOUR:CURR",
        "SOUR:CURR:COMP",
        "SOUR:CURR:RANG",
        "SOUR:DEL",
        "SOUR:SWE:POIN",
        "SOUR:SWE:COUN",
        "SOUR:CURR:STAR",
        "SOUR:CURR:STOP",
        "SOUR:CURR:STEP",
        "SOUR:CURR:CENT",
        "SOUR:WAVE:FREQ",
        "SOUR:WAVE:AMPL",
        "SOUR:WAVE:OFFS",
        "SOUR:WAVE:DCYC",
        "SOUR:WAVE:DUR:TIME",
        "SOUR:WAVE:DUR:CYCL",
        "SOUR:WAVE:PMAR:LEV",
        "SOUR:WAVE:PMAR:OLIN",
        "SOUR:DELT:HIGH",
        "SOUR:DELT:LOW",
        "SOUR:DELT:DEL",
        "SOUR:DELT:COUN",
        "ARM:TIM",
        "ARM:ILIN",
        "ARM:OLIN",
        "TRIG:ILIN",
        "TRIG:OLIN",
        "TRAC:POIN",
    ];
    let of_mainframe = [
        ("VOLT:DC:NPLC", ",(@1001)"),
        ("VOLT:DC:APER", ",(@1001)"),
        ("VOLT:DC:RANG", ",(@1001)"),
        ("ROUT:CHAN:DEL", ",(@1001)"),
        ("TRIG:TIM", ""),
        ("TRIG:COUN", ""),
    ];
    let source = of_source.map(|header| ("6221", header, ""));
    let mainframe = of_mainframe.map(|(header, list)| ("34980a", header, list));
    for (key, headers) in [("6221", &source[..]), ("34980a", &mainframe[..])] {
        let mut client = Client::at(served.address(key));
        for (_, header, list) in headers {
            let [least, most, default] = ["MIN", "MAXimum", "def"]
                .map(|limit| number(&client.ask(&format!("{header}? {limit}{list}"))));
            assert!(least < most, "{header}: {least} {most}");
            assert!(
                (least..=most).contains(&default) || default == 9.9e37,
                "{header}: {default}"
            );
            if *header == "SOUR:CURR:CENT" {
                // A span on both sides reduces the range.
                client.send(b"SOUR:CURR:SPAN 0\n");
            }
            for (limit, value) in [("MIN", least), ("max", most)] {
                let here = list.trim_start_matches(',');
                let reported = client.ask(&format!("{header} {limit}{list};:{header}? {here}"));
                assert_eq!(number(&reported), value, "{header} {limit}");
                // The reported value can be set, too.
                let again = client.ask(&format!("{header} {reported}{list};:{header}? {here}"));
                assert_eq!(again, reported, "{header} {reported}");
                let error = client.error();
                assert!(
                    error.trim_start_matches('+').starts_with("0,"),
                    "{header} {reported}: {error}"
                );
            }
            client.send(format!("{header} DEF{list}\n").as_bytes());
            assert!(
                client.error().trim_start_matches('+').starts_with("0,"),
                "{header}"
            );
        }
    }
}

#[test]
fn a_queue_that_overflows_keeps_the_oldest_and_reports_it() {
    let served = Served::start(&[]);
    for (key, depth) in [("6221", 10), ("34980a", 20)] {
        let mut client = Client::at(served.address(key));
        client.send(b"*RST\n*FOO 1\n");
        client.send("NONSENSE\n".repeat(40).as_bytes());
        let codes: Vec<i32> = (0..depth + 2)
            .map(|_| client.error().split(',').next().unwrap().parse().unwrap())
            .collect();
        assert_eq!(codes[..depth - 1], vec![-113; depth - 1][..], "{key}");
        assert_eq!(codes[depth - 1..], [-350, 0, 0], "{key}");
        // With space in the queue the next error is reported normally.
        client.send(b"NONSENSE\n");
        assert!(client.error().contains("-113"));
    }
}

#[test]
fn values_beyond_the_limits_change_nothing() {
    let served = Served::start(&["--profile", "pairs-34924a"]);
    let mut source = Client::at(served.address("6221"));
    for (message, code) in [
        ("SOUR:CURR 0.2", "-222"),
        ("SOUR:CURR -1", "-222"),
        ("SOUR:CURR 1e400", "-123"),
        ("SOUR:CURR NAN", "-"),
        ("SOUR:CURR", "-109"),
        ("SOUR:CURR 1e-3,2e-3", "-108"),
        ("SOUR:CURR \"1\"", "-1"),
        ("SOUR:CURR ONE", "-"),
        ("SOUR:CURR (@1)", "-1"),
        ("SOUR:CURR 1 V", "-131"),
        ("SOUR:CURR:COMP 106", "-222"),
        ("SOUR:CURR:COMP 0.05", "-222"),
        ("OUTP 2.5e3x", "-"),
        ("OUTP:ISH EARTH", "-224"),
        ("SOUR:SWE:POIN 0", "-222"),
        ("SOUR:SWE:POIN 65536", "-222"),
        ("SOUR:WAVE:FREQ 1.1e5", "-222"),
        ("TRIG:SOUR BUS", "-224"),
        ("SYSTe:PRES", "-113"),
        (":::OUTP ON", "-1"),
    ] {
        source.send(format!("{message}\n").as_bytes());
        let error = source.error();
        assert!(
            error.starts_with(code) && !error.starts_with('0'),
            "{message}: {error}"
        );
    }
    assert_eq!(
        source.ask("SOUR:CURR?;:SOUR:CURR:COMP?;:OUTP?;:SOUR:SWE:POIN?"),
        "0.000000E+00;1.000000E+01;0;11"
    );
    let mut mainframe = Client::at(served.address("34980a"));
    for message in [
        "ROUT:CLOS (@1071)",
        "ROUT:CLOS (@9001)",
        "ROUT:CLOS 1001",
        "ROUT:CLOS (@1001",
        "ROUT:CLOS (@1001:)",
        "ROUT:CLOS (@1001:1911)",
        "ROUT:CLOS",
        "ROUT:CLOS (@1001),(@1002)",
        "ROUT:OPEN:ALL 9",
        "ROUT:SCAN (@4001)",
        "VOLT:DC:NPLC 300,(@1001)",
        "TRIG:COUN 0",
        "TRIG:COUN 50001",
        "TRIG:TIM -1",
        "*ESE 256",
        "DATA:REM? 1",
        "R? 0",
    ] {
        mainframe.send(format!("{message}\n").as_bytes());
        let error = mainframe.error();
        assert!(!error.starts_with("+0,"), "{message}: {error}");
        assert!(mainframe.error().starts_with("+0,"), "{message}: one error");
    }
    let closed = mainframe.ask("ROUT:CLOS? (@1001:1070)");
    assert!(!closed.contains('1'), "{closed}");
}

#[test]
fn a_bank_that_is_scanned_takes_no_other_closure() {
    let served = Served::start(&["--profile", "pairs-34924a"]);
    let mut client = Client::at(served.address("34980a"));
    client.send(b"ROUT:SCAN (@1001:1026)\n");
    for refused in [
        "ROUT:CLOS (@1030)",
        "ROUT:CLOS (@1911)",
        "ROUT:CLOS (@1921)",
        "ROUT:CLOS (@1036,1001)",
    ] {
        client.send(format!("{refused}\n").as_bytes());
        let error = client.error();
        assert!(
            error.starts_with('+') && !error.starts_with("+0,"),
            "{refused}: {error}"
        );
    }
    assert_eq!(
        client.ask("ROUT:CLOS (@1036);:ROUT:CLOS? (@1036,1001,1030)"),
        "1,0,0"
    );
    client.send(b"ROUT:SCAN (@)\n");
    assert_eq!(client.ask("ROUT:CLOS (@1030);:ROUT:CLOS? (@1030)"), "1");
    assert!(client.error().starts_with("+0,"));
}

/// Invalid input is logged with its sender, escaped, and displayed immediately; other clients are not affected.
#[test]
fn bad_input_is_logged_with_its_address_and_affects_no_other() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_tactus-sim"))
        .args([
            "serve",
            "--port-6221",
            "0",
            "--port-34980a",
            "0",
            "--port-vxi11",
            "0",
            "--instant",
        ])
        .env("TACTUS_LOG", "warn")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    let mut reported = BufReader::new(child.stdout.take().unwrap());
    reported.read_line(&mut line).unwrap();
    let ready: serde_json::Value = serde_json::from_str(&line).unwrap();
    let address = |key: &str| ready[key].as_str().unwrap().to_owned();

    let mut good = Client::at(&address("34980a"));
    let mut bad = Client::at(&address("34980a"));
    let mut source = Client::at(&address("6221"));
    assert_eq!(good.ask("*ESE 4;*ESE?"), "+4");
    // Half a message of the bad client is pending all the time; its reply queue and lock are its own.
    bad.send(b"NON\x1b[2JSENSE\nROUT:CLOS (@1001);:BLAH?;*IDN?\n");
    for _ in 0..50 {
        bad.send(&[0xff, 0xfe, b'\n']);
        assert_eq!(good.ask("*ESE?"), "+4");
        assert!(good.ask("*IDN?").contains("34980A"));
    }
    bad.send(b"*ID");
    let mut stranger = TcpStream::connect(address("vxi11")).unwrap();
    stranger.write_all(&[0xff; 64]).unwrap();
    let from_vxi11 = stranger.local_addr().unwrap().to_string();
    stranger.read_to_end(&mut Vec::new()).ok();
    assert_eq!(good.ask("*ESE?"), "+4");
    // An invalid query has no reply, and the next line is processed normally.
    assert_eq!(
        bad.ask("N?;*ESE?").split(',').next(),
        Some("Agilent Technologies")
    );

    source.send(b"BLAH?\n");
    assert!(source.error().starts_with("-113,"));

    let status = Command::new(env!("CARGO_BIN_EXE_tactus-sim"))
        .args(["status", "--json", "--control", &address("control")])
        .output()
        .unwrap();
    let status: serde_json::Value = serde_json::from_slice(&status.stdout).unwrap();
    let shown = status["last_error"].as_str().unwrap();
    assert_eq!(
        shown,
        format!(
            "6221: -113,\"Undefined header\" (from {})",
            source.address()
        )
    );

    child.kill().unwrap();
    let mut log = String::new();
    child
        .stderr
        .take()
        .unwrap()
        .read_to_string(&mut log)
        .unwrap();
    child.wait().unwrap();
    for (who, what) in [
        (bad.address(), "sent the 34980a 'NON\\u{1b}[2JSENSE'"),
        (
            source.address(),
            "sent the 6221 'BLAH?': -113,\"Undefined header\"",
        ),
        (from_vxi11, "is disconnected"),
    ] {
        let line = log
            .lines()
            .find(|line| line.contains(&who) && line.contains(what));
        assert!(line.is_some(), "{who} {what} in\n{log}");
    }
    assert!(
        !log.contains("\u{1b}[2J"),
        "what a stranger sends steers no terminal"
    );
    assert!(!log.contains(&good.address()), "{log}");
}
