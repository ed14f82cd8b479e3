//! Raw sockets: bytes as real clients and networks send them.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

use crate::program::Served;

const DEADLINE: Duration = Duration::from_secs(20);

struct Client(BufReader<TcpStream>);

impl Client {
    fn of(served: &Served, instrument: &str) -> Self {
        Self::taken(served, instrument).unwrap()
    }

    /// `None` if the server resets the connection before the call returns.
    fn taken(served: &Served, instrument: &str) -> Option<Self> {
        let stream = TcpStream::connect(served.address(instrument)).ok()?;
        stream.set_nodelay(true).ok()?;
        stream.set_read_timeout(Some(DEADLINE)).ok()?;
        Some(Self(BufReader::new(stream)))
    }

    /// A client with its first reply; retried until a connection is free.
    fn insisting(served: &Served, query: &str) -> (Self, String, u32) {
        let begun = Instant::now();
        for tries in 1.. {
            assert!(begun.elapsed() < DEADLINE);
            let Some(mut client) = Self::taken(served, "6221") else {
                continue;
            };
            let query = format!("{query}\n");
            client.0.get_mut().write_all(query.as_bytes()).ok();
            let mut line = String::new();
            if matches!(client.0.read_line(&mut line), Ok(1..)) {
                return (client, line.trim_end().to_owned(), tries);
            }
        }
        unreachable!("the deadline ends the tries")
    }

    fn send(&mut self, bytes: &[u8]) {
        self.0.get_mut().write_all(bytes).unwrap();
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.0.read_line(&mut line).unwrap();
        assert!(line.ends_with('\n'), "{line:?}");
        line.trim_end().to_owned()
    }

    fn ask(&mut self, query: &str) -> String {
        self.send(format!("{query}\n").as_bytes());
        self.line()
    }

    fn code(&mut self) -> i32 {
        let error = self.ask("SYST:ERR?");
        error.split(',').next().unwrap().parse().unwrap()
    }

    /// Whether the server closed the connection, with or without a reset.
    fn is_closed(&mut self) -> bool {
        let mut rest = Vec::new();
        match self.0.read_to_end(&mut rest) {
            Ok(_) => rest.is_empty(),
            Err(fault) => fault.kind() == std::io::ErrorKind::ConnectionReset,
        }
    }
}

/// Disconnects without closing: the server sees a reset.
fn reset(client: Client) {
    let socket = client.0.into_inner();
    // Unread input makes the kernel reset instead of closing.
    let socket = tokio::net::TcpSocket::from_std_stream(socket);
    socket.set_zero_linger().unwrap();
}

#[test]
fn owner_of_the_lock_is_named_by_its_address() {
    let served = Served::start(&[]);
    let mut client = Client::of(&served, "34980a");
    assert_eq!(client.ask("SYST:LOCK:NAME?;OWN?"), "LAN127.0.0.1;NONE");
    assert_eq!(client.ask("SYST:LOCK:REQ?;OWN?"), "+1;LAN127.0.0.1");
}

#[test]
fn fragments_line_ends_and_pipelines_are_all_one() {
    let served = Served::start(&[]);
    for (instrument, model) in [("6221", "MODEL 6221"), ("34980a", "34980A")] {
        let mut client = Client::of(&served, instrument);
        for byte in b"*IDN?\n" {
            client.send(&[*byte]);
        }
        assert!(client.line().contains(model));
        client.send(b"*IDN?\r\n");
        let reply = client.line();
        assert!(reply.contains(model) && !reply.contains('\r'));
        client.send(b"\n\r\n  \n*IDN?\n");
        assert!(client.line().contains(model));
        client.send("*IDN?\n".repeat(200).as_bytes());
        for _ in 0..200 {
            assert!(client.line().contains(model));
        }
        // A message cut anywhere, combined with the next.
        client.send(b"*ESE 4\n*ES");
        client.send(b"E?\n*ESE 0;*ESE?\n*ID");
        assert_eq!(client.line().trim_start_matches('+'), "4");
        assert_eq!(client.line().trim_start_matches('+'), "0");
        client.send(b"N?\n");
        assert!(client.line().contains(model));
        assert_eq!(client.code(), 0);
    }
}

#[test]
fn long_lines_are_read_and_longer_ones_refused() {
    let served = Served::start(&[]);
    for instrument in ["6221", "34980a"] {
        let mut client = Client::of(&served, instrument);
        let long = format!(
            "{};*ESE 8;*ESE?\n",
            "*ESE 1;".repeat(3000).trim_end_matches(';')
        );
        assert!(long.len() > 20_000);
        client.send(long.as_bytes());
        assert_eq!(client.line().trim_start_matches('+'), "8");
        let blanks = vec![b' '; 20_000];
        client.send(&[&blanks[..], b"*ESE?\n"].concat());
        assert_eq!(client.line().trim_start_matches('+'), "8");
        assert_eq!(client.code(), 0);
        client.send(&[&[b'A'; 1_000_000][..], b"\n"].concat());
        assert_eq!(client.code(), -363, "{instrument}");
        assert_eq!(client.code(), 0);
        // An endless message takes no memory and does not disturb others.
        client.send(&[b'A'; 1_000_000]);
        if instrument == "34980a" {
            let mut other = Client::of(&served, instrument);
            assert!(other.ask("*IDN?").contains("34980A"));
        }
    }
}

#[test]
fn bytes_that_are_no_text_are_refused_and_forgotten() {
    let served = Served::start(&[]);
    for instrument in ["6221", "34980a"] {
        let mut client = Client::of(&served, instrument);
        let every: Vec<u8> = (0..=255).filter(|byte| *byte != b'\n').collect();
        client.send(&[&every[..], b"\n"].concat());
        assert!(client.code() < 0);
        client.send(b"*CLS\n");
        assert_eq!(client.code(), 0);
        // An invalid query has no reply; the next one has.
        client.send(b"FOO?\n");
        assert_eq!(client.code(), -113);
    }
}

#[test]
fn a_half_closed_client_still_gets_its_replies() {
    let served = Served::start(&[]);
    for instrument in ["6221", "34980a"] {
        let mut client = Client::of(&served, instrument);
        client.send(b"*ESE 3\n*ESE?\n*IDN?\n");
        client.0.get_ref().shutdown(Shutdown::Write).unwrap();
        assert_eq!(client.line().trim_start_matches('+'), "3");
        assert!(!client.line().is_empty());
        assert!(client.is_closed());
    }
}

#[test]
fn churn_and_resets_leave_the_instruments_well() {
    let served = Served::start(&[]);
    for instrument in ["6221", "34980a"] {
        for round in 0..50 {
            let mut client = Client::of(&served, instrument);
            match round % 4 {
                0 => drop(client),
                1 => reset(client),
                2 => {
                    client.send(b"*IDN?\n*IDN?\n*ID");
                    reset(client);
                }
                _ => assert!(!client.ask("*IDN?").is_empty()),
            }
        }
        let mut client = Client::of(&served, instrument);
        assert_eq!(client.code(), 0);
    }
}

#[test]
fn sessions_of_the_mainframe_have_queues_of_their_own() {
    let served = Served::start_in_time(&[]);
    let mut slow = Client::of(&served, "34980a");
    let mut quick = Client::of(&served, "34980a");
    slow.send(
        b"CONF:VOLT:DC 1,(@1001:1026);:VOLT:DC:NPLC 2,(@1001:1026);:TRIG:COUN 10000\n*OPC?\n",
    );
    assert_eq!(slow.line().trim_start_matches('+'), "1");
    // Six hours, in which the other client is served.
    slow.send(b"READ?\n");
    assert!(quick.ask("*IDN?").contains("34980A"));
    assert_eq!(quick.ask("ROUT:CLOS? (@1036)"), "0");
    while quick.ask("DATA:POIN?") == "+0" {}
    quick.send(b"ABOR\n");
    assert!(!slow.line().is_empty());
}

#[test]
fn a_second_client_of_the_source_is_held_or_refused_or_served() {
    let folder = tempfile::tempdir().unwrap();
    let start = |name: &str, source: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, format!("[source]\n{source}\n")).unwrap();
        Served::start(&["--profile", path.to_str().unwrap()])
    };
    let held = start("held.toml", "second_client = \"held\"");
    let mut first = Client::of(&held, "6221");
    assert!(!first.ask("*IDN?").is_empty());
    let mut second = Client::of(&held, "6221");
    second.send(b"*ESE?\n");
    // Messages of the second client are received only after the first has disconnected.
    first.send(b"*ESE 7\n");
    drop(first);
    assert_eq!(second.line(), "7");

    let refused = start("refused.toml", "second_client = \"refused\"");
    let mut first = Client::of(&refused, "6221");
    assert!(!first.ask("*IDN?").is_empty());
    let second = Client::taken(&refused, "6221");
    assert!(second.is_none_or(|mut second| second.is_closed()));
    assert!(!first.ask("*IDN?").is_empty());

    let served = start("served.toml", "second_client = \"served\"");
    let mut first = Client::of(&served, "6221");
    let mut second = Client::of(&served, "6221");
    assert!(!second.ask("*IDN?").is_empty());
    assert!(!first.ask("*IDN?").is_empty());
}

#[test]
fn the_only_place_stays_taken_after_a_client_that_vanished() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("slow-slot.toml");
    let text = "[source]\nsecond_client = \"refused\"\nslot_hold_s = 1.5\n";
    std::fs::write(&path, text).unwrap();
    let served = Served::start(&["--profile", path.to_str().unwrap()]);
    let mut polite = Client::of(&served, "6221");
    assert!(!polite.ask("*IDN?").is_empty());
    drop(polite);
    let (mut vanishing, ..) = Client::insisting(&served, "*IDN?");
    vanishing.send(b"OUTP ON\n");
    assert_eq!(vanishing.ask("OUTP?"), "1");
    let left = Instant::now();
    reset(vanishing);
    let (mut back, output, _) = Client::insisting(&served, "OUTP?");
    assert_eq!(output, "1", "the output outlives its client");
    assert!(
        left.elapsed() >= Duration::from_millis(1400),
        "{:?}",
        left.elapsed()
    );
    assert!(!back.ask("*IDN?").is_empty());
}

/// A sweep of 10,000 s, and a query that waits for its end.
const LONG_SWEEP: &[u8] =
    b"SOUR:SWE:SPAC LIST;:SOUR:LIST:CURR 1e-3;DEL 10000;COMP 10;:SOUR:SWE:ARM;:INIT\n*OPC?\n";

#[test]
fn client_reset_while_source_is_busy_frees_its_slot() {
    let served = Served::start_in_time(&[]);
    let mut first = Client::of(&served, "6221");
    first.send(LONG_SWEEP);
    // The message has been received once the mainframe's status shows the sweep.
    let begun = Instant::now();
    let status = || String::from_utf8(served.command("status", "--json").stdout).unwrap();
    while !status().contains("\"output\":true") {
        assert!(begun.elapsed() < DEADLINE);
    }
    reset(first);
    let (mut second, sweeping, _) = Client::insisting(&served, "STAT:OPER:COND?");
    assert_eq!(
        sweeping.parse::<u16>().unwrap() & 8,
        8,
        "the sweep outlives its client"
    );
    second.send(b"SOUR:SWE:ABOR\n");
    assert_eq!(second.ask("OUTP?"), "0");
    assert_eq!(second.code(), 0);
}

#[test]
fn messages_to_a_busy_source_are_read_in_order() {
    let served = Served::start_in_time(&[]);
    let mut client = Client::of(&served, "6221");
    let begun = Instant::now();
    client.send(b"SOUR:SWE:SPAC LIST;:SOUR:LIST:CURR 1e-3,2e-3;DEL 0.3,0.3;COMP 10,10;:SOUR:SWE:ARM;:INIT\n*OPC?\n");
    for byte in b"SOUR:CURR?\n*IDN?\n" {
        client.send(&[*byte]);
    }
    client.0.get_ref().shutdown(Shutdown::Write).unwrap();
    assert_eq!(client.line(), "1");
    assert!(begun.elapsed() >= Duration::from_millis(600));
    assert_eq!(client.line(), "2.000000E-03");
    assert!(client.line().contains("MODEL 6221"));
    assert!(client.is_closed());
}

#[test]
fn a_list_sweep_runs_in_real_time() {
    let served = Served::start_in_time(&[]);
    let mut client = Client::of(&served, "6221");
    client
        .send(b"SOUR:SWE:SPAC LIST;:SOUR:LIST:CURR 1e-3,2e-3,3e-3;DEL 0.4,0.4,0.4;COMP 10,10,10\n");
    let begun = Instant::now();
    client.send(b"SOUR:SWE:ARM;:INIT\n");
    let mut seen = Vec::new();
    loop {
        let reply = client.ask("SOUR:CURR?;:STAT:OPER:COND?");
        let (level, conditions) = reply.split_once(';').unwrap();
        if seen.last().is_none_or(|(last, _)| last != level) {
            seen.push((level.to_owned(), begun.elapsed()));
        }
        if conditions.parse::<u16>().unwrap() & 2 != 0 {
            break;
        }
        assert!(begun.elapsed() < DEADLINE);
    }
    let whole = begun.elapsed();
    let levels: Vec<&str> = seen.iter().map(|(level, _)| level.as_str()).collect();
    // The check may be late on a loaded machine, never early.
    assert!(
        levels
            .iter()
            .all(|level| ["1.000000E-03", "2.000000E-03", "3.000000E-03"].contains(level))
    );
    assert!(levels.is_sorted(), "{levels:?}");
    assert!(whole >= Duration::from_millis(1190), "{whole:?}");
    assert_eq!(levels.last(), Some(&"3.000000E-03"));
    assert_eq!(client.ask("OUTP?"), "1");
}
