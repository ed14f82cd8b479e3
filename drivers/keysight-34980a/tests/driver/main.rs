//! The driver against the simulator over a pipe: the same bytes as over TCP. The clock of the tests is paused and
//! advances at once.

mod frames;
mod moves;
mod ranges;
#[path = "../stand_in/mod.rs"]
mod stand_in;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use keysight_34980a::{HeaderForm, Keysight34980a, Settings34980a, Simulator34980a};
use rig::{
    ChainedReading, Link, LinkError, MeterSettings, Move, RigError, Sample, Switch, Voltmeter,
};
use scpi::Framer;
use stand_in::{Sheet, mainframe, mainframe_slots};
use survey::{Reading, Relay, Volts};
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::time::Instant;

/// A mainframe, its sheet, and the messages it has received.
struct TestInstrument {
    unit: Simulator34980a,
    sheet: Sheet,
    received: Vec<String>,
    /// Faked replies: the end of a message, or of a query within a message, and the reply to it. An empty reply means
    /// no reply.
    fake_replies: Vec<(&'static str, &'static str)>,
}

/// The reply to a message of several queries, with faked replies to single queries inserted.
fn with_fake_replies(line: &str, answer: String, fake_replies: &[(&str, &str)]) -> String {
    let queries: Vec<&str> = line.split(";").filter(|one| one.contains('?')).collect();
    let mut answers: Vec<&str> = answer.split(';').collect();
    if queries.len() == answers.len() {
        for (query, answer) in queries.iter().zip(&mut answers) {
            let fake = fake_replies.iter().find(|(end, _)| query.ends_with(end));
            *answer = fake.map_or(*answer, |(_, reply)| reply);
        }
    }
    answers.join(";")
}

#[derive(Clone)]
struct Shared(Arc<Mutex<TestInstrument>>);

impl Shared {
    fn of(unit: Simulator34980a) -> Self {
        Self(Arc::new(Mutex::new(TestInstrument {
            unit,
            sheet: Sheet::default(),
            received: Vec::new(),
            fake_replies: Vec::new(),
        })))
    }

    fn fake_reply(&self, end: &'static str, answer: &'static str) {
        self.0.lock().unwrap().fake_replies.push((end, answer));
    }

    fn no_fake_replies(&self) {
        self.0.lock().unwrap().fake_replies.clear();
    }

    /// The messages received since the last call.
    fn received(&self) -> Vec<String> {
        std::mem::take(&mut self.0.lock().unwrap().received)
    }

    /// Sends a message to the mainframe without the driver.
    fn say(&self, message: &str) {
        self.ask(message);
    }

    /// The reply to a message sent without the driver.
    fn ask(&self, message: &str) -> Option<String> {
        let device = &mut *self.0.lock().unwrap();
        let response = device
            .unit
            .receive(message, Duration::ZERO, &mut device.sheet);
        response.text
    }

    fn closed(&self) -> Vec<u32> {
        let device = self.0.lock().unwrap();
        device.unit.closed().iter().map(|relay| relay.0).collect()
    }

    fn plug(&self) -> Link<DuplexStream> {
        let (here, mut there) = tokio::io::duplex(4096);
        let shared = self.clone();
        let start = Instant::now();
        tokio::spawn(async move {
            let mut framer = Framer::new(65536);
            let mut bytes = [0; 512];
            while let Ok(count @ 1..) = there.read(&mut bytes).await {
                framer.push(&bytes[..count]);
                for line in framer.by_ref() {
                    let line = String::from_utf8(line.unwrap()).unwrap();
                    let (text, busy) = {
                        let device = &mut *shared.0.lock().unwrap();
                        device.received.push(line.clone());
                        let answer = device
                            .unit
                            .receive(&line, start.elapsed(), &mut device.sheet);
                        let fake = device
                            .fake_replies
                            .iter()
                            .find(|(end, _)| line.ends_with(end));
                        match fake {
                            Some((_, "")) => (None, answer.busy),
                            Some((_, text)) => (Some((*text).to_owned()), answer.busy),
                            None => {
                                let among =
                                    |text| with_fake_replies(&line, text, &device.fake_replies);
                                (answer.text.map(among), answer.busy)
                            }
                        }
                    };
                    // the time that the instrument needs; the paused clock advances at once
                    tokio::time::sleep(busy).await;
                    if let Some(text) = text {
                        there
                            .write_all(format!("{text}\n").as_bytes())
                            .await
                            .unwrap_or(());
                    }
                }
            }
        });
        Link::new(here, "34980A in a test", Duration::from_secs(2))
    }
}

/// The end of every message that measures.
const READ: &str = "READ?;:SYST:ERR?";

const METER: MeterSettings = MeterSettings::new(Volts(100.0), 1.0);

fn relays(numbers: impl IntoIterator<Item = u32>) -> Vec<Relay> {
    numbers.into_iter().map(Relay).collect()
}

fn close(numbers: &[u32]) -> Move {
    Move::Close(relays(numbers.iter().copied()))
}

fn open(numbers: &[u32]) -> Move {
    Move::Open(relays(numbers.iter().copied()))
}

async fn connected(modules: &[&str]) -> (Shared, Keysight34980a<DuplexStream>) {
    let shared = Shared::of(mainframe(modules));
    let unit = Keysight34980a::connect(shared.plug()).await.unwrap();
    shared.received();
    (shared, unit)
}
