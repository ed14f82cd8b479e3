//! Every kind of fault, by command and on a scene's time line: absent at first, then visible to a client, then over.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::program::Served;
use rig::{BoxStream, connect_tcp, open_serial};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};

/// Generous: the expected event happens, or the test has failed.
const DEADLINE: Duration = Duration::from_secs(120);

/// Delay of late and slow replies.
const LATE: Duration = Duration::from_millis(300);

/// The fault; `true` if it lasts until it is ended, `false` if it has no duration.
const ON_THE_PAIRS: [(&str, bool); 30] = [
    ("stuck-open 1036", true),
    ("stuck-closed 1036", true),
    ("lost 6221", false),
    ("lost 34980a", false),
    ("late 6221 0.3", false),
    ("late 34980a 0.3", false),
    ("doubled 6221", false),
    ("doubled 34980a", false),
    ("half-line 6221", false),
    ("half-line 34980a", false),
    ("nan 6221", false),
    ("nan 34980a", false),
    ("stale 6221", false),
    ("stale 34980a", false),
    ("drop 6221", false),
    ("drop 34980a", false),
    ("wire 6221 cut", true),
    ("wire 34980a cut", true),
    ("reset 6221", false),
    ("reset 34980a", false),
    ("power-cut", false),
    ("slot 1 empty", true),
    ("slot 1 34922A", true),
    ("voltmeter missing", true),
    ("overload on", true),
    ("slow 6221 0.3", true),
    ("queue-overflow 6221", false),
    ("queue-overflow 34980a", false),
    ("interlock open", true),
    ("terminal-block 1 open", true),
];

const ON_THE_BOARD: [(&str, bool); 11] = [
    ("stuck-open 101", true),
    ("lost board", false),
    ("doubled board", false),
    ("half-line board", false),
    ("late board 0.3", false),
    ("slow board 0.3", true),
    ("reset board", false),
    ("power-cut", false),
    ("queue-overflow board", false),
    ("serial unplug", true),
    ("pulse 34980a", false),
];

/// A connection to one instrument.
struct Wire {
    address: String,
    baud: Option<u32>,
    stream: Option<BufReader<BoxStream>>,
}

impl Wire {
    fn of(served: &Served, key: &str) -> Self {
        Self {
            address: served.ready[key].as_str().unwrap_or_default().to_owned(),
            baud: (key == "serial").then_some(115_200),
            stream: None,
        }
    }

    async fn connect(&mut self) {
        // Close the old one first: a source accepts one connection.
        self.stream = None;
        let stream = match self.baud {
            Some(baud) => open_serial(&self.address, baud).ok(),
            None => connect_tcp(&self.address, DEADLINE).await.ok(),
        };
        self.stream = stream.map(BufReader::new);
    }

    async fn say(&mut self, text: &str) {
        if self.stream.is_none() {
            self.connect().await;
        }
        if let Some(stream) = &mut self.stream {
            // A broken connection is detected when the reply is read.
            stream.write_all(text.as_bytes()).await.ok();
        }
    }

    /// The next line; `None` if the connection is closed.
    async fn line(&mut self) -> Option<String> {
        let mut line = String::new();
        let read = self.stream.as_mut()?.read_line(&mut line);
        let read = tokio::time::timeout(DEADLINE, read).await;
        let count = read.expect("the deadline is over").unwrap_or(0);
        (count > 0).then(|| line.trim_end().to_owned())
    }

    /// Waits until the server closes the connection; `false` if a line arrives instead.
    async fn is_closed_by_the_server(&mut self) -> bool {
        assert!(self.stream.is_some(), "no connection to {}", self.address);
        let closed = self.line().await.is_none();
        if closed {
            self.stream = None;
        }
        closed
    }

    async fn ask(&mut self, query: &str) -> Option<String> {
        self.say(&format!("{query}\n")).await;
        let line = self.line().await;
        if line.is_none() {
            self.stream = None;
        }
        line
    }

    /// Repeats the query over a new connection if the old one is broken.
    async fn insist(&mut self, query: &str) -> String {
        let begun = Instant::now();
        loop {
            if let Some(line) = self.ask(query).await {
                return line;
            }
            assert!(begun.elapsed() < DEADLINE, "{query} at {}", self.address);
            tokio::task::yield_now().await;
        }
    }
}

struct FaultyRig {
    served: Served,
    source: Wire,
    mainframe: Wire,
    board: Wire,
}

impl FaultyRig {
    fn start(profile: &str, scene: Option<&Path>) -> Self {
        let mut arguments = vec!["--profile", profile, "--load", "resistor 1 2 470"];
        arguments.extend(
            scene
                .into_iter()
                .flat_map(|path| ["--scene", path.to_str().unwrap()]),
        );
        let served = Served::start(&arguments);
        Self {
            source: Wire::of(&served, "6221"),
            mainframe: Wire::of(&served, "34980a"),
            board: Wire::of(&served, "serial"),
            served,
        }
    }

    /// The connection that a fault concerns, a query with a short reply, and that reply.
    fn named(&mut self, words: &str) -> (&mut Wire, &'static str, &'static str) {
        match words.split(' ').nth(1) {
            Some("6221") => (&mut self.source, "*ESE?", "0"),
            Some("board" | "unplug") => (&mut self.board, "STAT?", "OFF,OFF,OFF,OFF"),
            _ => (&mut self.mainframe, "*ESE?", "+0"),
        }
    }

    /// Prepares the state in which the fault becomes visible.
    async fn prepare(&mut self, words: &str) {
        self.source.insist("*RST;*CLS;*OPC?").await;
        self.mainframe.insist("*RST;*CLS;*OPC?").await;
        self.board.insist_if_there("OFF").await;
        match words.split(' ').next().unwrap() {
            "stuck-open" | "stuck-closed" => {
                self.mainframe.insist("ROUT:CLOS (@1036);*OPC?").await;
                self.source.insist("SOUR:CURR 1e-3;:OUTP ON;*OPC?").await;
            }
            "stale" => {
                self.source
                    .insist("SOUR:CURR:COMP 5;:SOUR:CURR:COMP?")
                    .await;
                self.mainframe.insist("MEAS:VOLT:DC? 10,(@1001)").await;
            }
            "reset" | "power-cut" => {
                self.source.insist("SOUR:CURR:COMP 5;*OPC?").await;
                self.mainframe.insist("ROUT:CLOS (@1036);*OPC?").await;
                // Its watchdog would open it too.
                self.board.insist_if_there("WDOG 0").await;
                self.board.insist_if_there("PAIR I 3").await;
            }
            "terminal-block" => drop(self.mainframe.insist("ROUT:CLOS (@1911);*OPC?").await),
            "serial" => drop(self.board.insist("STAT?").await),
            "pulse" => {
                let waits = "ABOR;:CONF:VOLT:DC 10,(@);:TRIG:SOUR EXT;:INIT;*ESE?";
                self.mainframe.insist(waits).await;
            }
            _ => {}
        }
    }

    /// Whether a client observes the fault.
    async fn shows(&mut self, words: &str) -> bool {
        let compliance = "STAT:MEAS:COND?";
        match words.split(' ').next().unwrap() {
            "stuck-open" if words.ends_with(" 101") => {
                let reads = self.board.insist("PAIR I 1").await;
                self.source.insist(compliance).await == "8" && reads == "1,2,OFF,OFF"
            }
            "stuck-open" => {
                let reads = self.mainframe.insist("ROUT:CLOS? (@1036)").await;
                self.source.insist(compliance).await == "8" && reads == "1"
            }
            "stuck-closed" => {
                let opened = "ROUT:OPEN (@1036);:ROUT:CLOS? (@1036)";
                let reads = self.mainframe.insist(opened).await;
                self.source.insist(compliance).await == "0" && reads == "0"
            }
            kind @ ("lost" | "doubled" | "half-line") => {
                let (wire, query, answer) = self.named(words);
                let replies = wire.replies_to(&["*IDN?", query]).await;
                let replies: Vec<&str> = replies.iter().map(String::as_str).collect();
                match (kind, replies.as_slice()) {
                    ("lost", [only]) => *only == answer,
                    ("doubled", [one, two, _]) => one == two,
                    // Half the identity without its line end, followed by the next reply.
                    ("half-line", [only]) => *only != answer && only.ends_with(answer),
                    (_, [_, last]) if *last == answer => false,
                    other => panic!("{words}: {other:?}"),
                }
            }
            "nan" if words.ends_with("6221") => {
                self.source.insist("*OPC?").await == "1"
                    && self.source.insist("SOUR:CURR:COMP?").await == "NAN"
            }
            "nan" => self.mainframe.insist("MEAS:VOLT:DC? 10,(@1001)").await == "NAN",
            "stale" if words.ends_with("6221") => {
                let set = "SOUR:CURR:COMP 7;:SOUR:CURR:COMP?";
                let read = self.source.insist(set).await;
                assert!(["5.000000E+00", "7.000000E+00"].contains(&read.as_str()));
                read == "5.000000E+00"
            }
            "stale" => {
                self.mainframe.insist("ROUT:CLOS (@1036);*OPC?").await;
                self.source.insist("SOUR:CURR 1e-3;:OUTP ON;*OPC?").await;
                let read = self.mainframe.insist("MEAS:VOLT:DC? 10,(@1001)").await;
                let volts: f64 = read.parse().unwrap();
                assert!(volts.abs() < 1e-3 || (volts - 0.47).abs() < 1e-3, "{read}");
                volts.abs() < 1e-3
            }
            "late" | "slow" => {
                let (wire, query, _) = self.named(words);
                let begun = Instant::now();
                wire.insist(query).await;
                begun.elapsed() >= LATE
            }
            "drop" => {
                let (wire, query, _) = self.named(words);
                wire.ask(query).await.is_none()
            }
            "wire" => {
                let (wire, query, _) = self.named(words);
                wire.connect().await;
                wire.ask(query).await.is_none()
            }
            "power-cut" => {
                let reset = self.source.insist("SOUR:CURR:COMP?").await == "1.000000E+01";
                // With a board the mainframe has no modules.
                let open = match self.board.address.is_empty() {
                    true => self.mainframe.insist("ROUT:CLOS? (@1036)").await == "0",
                    false => self.board_was_reset().await,
                };
                reset && open
            }
            "reset" if words.ends_with("6221") => {
                self.source.insist("SOUR:CURR:COMP?").await == "1.000000E+01"
            }
            "reset" if words.ends_with("34980a") => {
                self.mainframe.insist("ROUT:CLOS? (@1036)").await == "0"
            }
            "reset" => self.board_was_reset().await,
            "queue-overflow" => {
                let (wire, _, _) = self.named(words);
                let mut overflown = false;
                loop {
                    let error = wire.insist("SYST:ERR?").await;
                    overflown |= error.starts_with("-350,");
                    if error.trim_start_matches('+').starts_with("0,") {
                        return overflown;
                    }
                }
            }
            "slot" if words.ends_with("34922A") => {
                let card = self.mainframe.insist("SYST:CTYP? 1").await;
                card.contains(",34922A,")
            }
            "slot" => self
                .mainframe
                .insist("SYST:CTYP? 1")
                .await
                .contains(",0,0,0"),
            "voltmeter" => self.mainframe.insist("INST:DMM:INST?").await == "0",
            "overload" => {
                let reading = self.mainframe.insist("MEAS:VOLT:DC? 10,(@1001)").await;
                reading == "+9.90000000E+37"
            }
            "interlock" => self.source.insist("OUTP:INT:TRIP?").await == "0",
            "terminal-block" => self.mainframe.insist("ROUT:CLOS? (@1911)").await == "0",
            "serial" => self.board.ask("STAT?").await.is_none(),
            "pulse" => self.mainframe.insist("SYST:DEL 1;:DATA:POIN?").await == "+1",
            other => panic!("how does '{other}' show itself?"),
        }
    }

    /// Whether the fault has its effect, after it has been caused. Waits for what follows the cause on a busy server:
    /// the end of a connection, and the rest of a power cut after the source's part of it.
    async fn takes_effect(&mut self, words: &str) -> bool {
        match words.split(' ').next().unwrap() {
            "drop" | "serial" => self.named(words).0.is_closed_by_the_server().await,
            "power-cut" => {
                // Wait on the source's connection: it is the only one without traffic meanwhile.
                let closed = self.source.is_closed_by_the_server().await;
                let begun = Instant::now();
                while !self.shows(words).await {
                    assert!(begun.elapsed() < DEADLINE, "{words}: not everything is off");
                    tokio::task::yield_now().await;
                }
                closed
            }
            _ => self.shows(words).await,
        }
    }

    /// Whether the board's poles are open, and it has sent its banner.
    async fn board_was_reset(&mut self) -> bool {
        let mut lines = vec![self.board.insist("STAT?").await];
        if lines[0] != "3,4,OFF,OFF" {
            // The banner is sent without a query, before the reply or after it.
            lines.extend(self.board.line().await);
        }
        lines.sort();
        lines == ["OFF,OFF,OFF,OFF", "Tactus,GPIO-MUX,0001,1.0 ready"]
    }

    /// Advances the instruments' time by 25 s. Due faults take effect at the next message to any instrument; here it
    /// goes to one without the fault.
    async fn time_passes(&mut self, words: &str) {
        if words.starts_with("wire 34980a") {
            let sweep = "SOUR:DEL 25;:SOUR:SWE:POIN 1;ARM;:INIT;*OPC?";
            self.source.insist(sweep).await;
        } else {
            self.mainframe.insist("SYST:DEL 25;*OPC?").await;
        }
        let bystander = match words.contains("34980a") {
            true => &mut self.source,
            false => &mut self.mainframe,
        };
        // The connection may break, but the message has been received.
        bystander.ask("*OPC?").await;
    }
}

impl Wire {
    async fn insist_if_there(&mut self, query: &str) {
        if !self.address.is_empty() {
            self.insist(query).await;
        }
    }

    /// All replies to some queries and to a final error query.
    async fn replies_to(&mut self, queries: &[&str]) -> Vec<String> {
        self.say(&format!("{}\nSYST:ERR?\n", queries.join("\n")))
            .await;
        let mut replies = Vec::new();
        loop {
            let line = self.line().await.unwrap();
            if line.ends_with("0,\"No error\"") {
                return replies;
            }
            replies.push(line);
        }
    }
}

/// How a fault is caused.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Way {
    Live,
    TimeLine,
}

async fn holds(rig: &mut FaultyRig, (words, lasts): (&str, bool), way: Way) {
    let timed = words.starts_with("late") || words.starts_with("slow");
    rig.prepare(words).await;
    // A busy machine may be slow without any fault.
    assert!(timed || !rig.shows(words).await, "{words}, {way:?}: before");
    rig.prepare(words).await;
    match way {
        Way::TimeLine => rig.time_passes(words).await,
        Way::Live => rig.served.fault(words),
    }
    assert!(rig.takes_effect(words).await, "{words}, {way:?}: not seen");
    if lasts {
        match way {
            Way::TimeLine => rig.time_passes(words).await,
            Way::Live => rig.served.fault("none"),
        }
    }
    rig.prepare(words).await;
    assert!(
        timed || !rig.shows(words).await,
        "{words}, {way:?}: not over"
    );
}

async fn all_hold(profile: &str, faults: &[(&str, bool)]) {
    let mut live = FaultyRig::start(profile, None);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    for (words, lasts) in faults {
        holds(&mut live, (words, *lasts), Way::Live).await;
        let until = if *lasts { "for_s = 25\n" } else { "" };
        let scene = format!("[[fault]]\nat_s = 25\n{until}what = \"{words}\"\n");
        std::fs::write(&path, scene).unwrap();
        let mut played = FaultyRig::start(profile, Some(&path));
        holds(&mut played, (words, *lasts), Way::TimeLine).await;
    }
}

#[tokio::test]
async fn every_fault_acts_live_and_from_the_time_line() {
    all_hold("pairs-34924a", &ON_THE_PAIRS).await;
}

#[tokio::test]
async fn every_fault_of_the_board_is_seen_live_and_on_the_time_line() {
    all_hold("gpio-board", &ON_THE_BOARD).await;
}
