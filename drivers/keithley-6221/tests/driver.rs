//! The driver against the simulator over a pipe: the same bytes as over TCP.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use keithley_6221::{Command, Keithley6221, Resistor, Settings6221, Simulator6221};
use rig::{CurrentSource, Link, LinkError, RigError};
use scpi::{Framer, parse_message};
use survey::{Amps, Ohms, Volts};
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};

/// An instrument with a resistor, and the lines it has received. It outlives its connections.
struct TestInstrument {
    simulator: Simulator6221,
    load: Resistor,
    received: Vec<String>,
    /// Faults for the next replies.
    reply_faults: Vec<ReplyFault>,
}

enum ReplyFault {
    /// The reply is lost.
    Silence,
    /// The reply is replaced.
    Says(&'static str),
    /// The connection breaks.
    HangUp,
}

type Shared = Arc<Mutex<TestInstrument>>;

fn device(resistance: f64) -> Shared {
    Arc::new(Mutex::new(TestInstrument {
        simulator: Simulator6221::new(Settings6221::default()),
        load: Resistor::new(Ohms(resistance)),
        received: Vec::new(),
        reply_faults: Vec::new(),
    }))
}

/// Connects a client to the instrument.
fn plug(device: &Shared) -> DuplexStream {
    let (here, mut there) = tokio::io::duplex(4096);
    let device = Arc::clone(device);
    tokio::spawn(async move {
        let mut framer = Framer::new(4096);
        let mut bytes = [0; 512];
        while let Ok(count @ 1..) = there.read(&mut bytes).await {
            framer.push(&bytes[..count]);
            for line in framer.by_ref() {
                let line = String::from_utf8(line.unwrap()).unwrap();
                let answer = device.lock().unwrap().answer(line);
                match answer {
                    Some(Some(text)) => there
                        .write_all(format!("{text}\n").as_bytes())
                        .await
                        .unwrap_or(()),
                    Some(None) => {}
                    None => return,
                }
            }
        }
    });
    here
}

impl TestInstrument {
    /// `Some` with the line to send, if any; `None` to close the connection.
    fn answer(&mut self, line: String) -> Option<Option<String>> {
        let reply = self
            .simulator
            .receive(&line, Duration::ZERO, &mut self.load);
        self.received.push(line);
        match reply
            .text
            .is_some()
            .then(|| self.reply_faults.pop())
            .flatten()
        {
            Some(ReplyFault::Silence) => Some(None),
            Some(ReplyFault::Says(text)) => Some(Some(text.to_owned())),
            Some(ReplyFault::HangUp) => None,
            None => Some(reply.text),
        }
    }
}

fn link(stream: DuplexStream) -> Link<DuplexStream> {
    Link::new(stream, "6221 in memory", Duration::from_secs(2))
}

async fn connected(device: &Shared) -> Keithley6221<DuplexStream> {
    Keithley6221::connect(link(plug(device))).await.unwrap()
}

fn simulator<T>(device: &Shared, look: impl FnOnce(&mut TestInstrument) -> T) -> T {
    look(&mut device.lock().unwrap())
}

#[tokio::test]
async fn a_current_flows_and_is_switched_off() {
    let device = device(500.0);
    let mut source = connected(&device).await;
    assert!(source.identity().contains("MODEL 6221"));
    source.prepare(Amps(1e-3), Volts(5.0)).await.unwrap();
    source.set_output(true).await.unwrap();
    source.set_current(Amps(1e-3)).await.unwrap();
    assert_eq!(source.output().await.unwrap(), (Amps(1e-3), true));
    assert!(!source.in_compliance().await.unwrap());
    assert_eq!(simulator(&device, |b| b.load.flowing), Amps(1e-3));
    assert_eq!(simulator(&device, |b| b.simulator.range()), Amps(2e-3));
    source.off().await.unwrap();
    assert_eq!(simulator(&device, |b| b.load.flowing), Amps(0.0));
    assert!(!simulator(&device, |b| b.simulator.output()));
}

#[tokio::test]
async fn simulator_parses_every_driver_command() {
    let device = device(500.0);
    let mut source = connected(&device).await;
    source.prepare(Amps(-2e-6), Volts(0.1)).await.unwrap();
    source.set_output(true).await.unwrap();
    source.set_current(Amps(-2.1e-6)).await.unwrap();
    source.in_compliance().await.unwrap();
    source.off().await.unwrap();
    for line in simulator(&device, |b| b.received.clone()) {
        for call in parse_message(&line) {
            Command::of(&call.unwrap()).unwrap();
        }
    }
    assert_eq!(simulator(&device, |b| b.simulator.errors()), 0);
}

#[tokio::test]
async fn setting_a_level_is_one_segment() {
    let device = device(500.0);
    let mut source = connected(&device).await;
    source.prepare(Amps(1e-3), Volts(5.0)).await.unwrap();
    simulator(&device, |b| b.received.clear());
    source.set_current(Amps(1e-3)).await.unwrap();
    assert_eq!(
        simulator(&device, |b| b.received.clone()),
        ["SOUR:CURR 1E-3;:SOUR:CURR?;:SYST:ERR?"]
    );
}

#[tokio::test]
async fn compliance_is_seen_now_and_after_the_fact() {
    let device = device(1e6);
    let mut source = connected(&device).await;
    source.prepare(Amps(1e-3), Volts(5.0)).await.unwrap();
    source.set_output(true).await.unwrap();
    source.set_current(Amps(1e-3)).await.unwrap();
    assert!(source.in_compliance().await.unwrap());
    source.set_current(Amps(0.0)).await.unwrap();
    assert!(!source.in_compliance().await.unwrap());
    source.set_current(Amps(1e-3)).await.unwrap();
    source.set_current(Amps(0.0)).await.unwrap();
    assert!(source.in_compliance().await.unwrap());
}

#[tokio::test]
async fn an_interlock_that_opens_is_no_reading_of_nothing() {
    let device = device(500.0);
    let interlock = |closed| {
        simulator(&device, |b| {
            b.simulator
                .set_interlock(closed, Duration::ZERO, &mut b.load);
        });
    };
    let mut source = connected(&device).await;
    source.prepare(Amps(1e-3), Volts(5.0)).await.unwrap();
    source.set_output(true).await.unwrap();
    source.set_current(Amps(1e-3)).await.unwrap();
    assert!(!source.in_compliance().await.unwrap());
    for closed in [false, true] {
        interlock(true);
        interlock(false);
        interlock(closed);
        // also after the interlock was closed again, because the output stays off
        let open = source.compliance().await;
        assert!(matches!(open, Err(RigError::Interlock { .. })), "{open:?}");
    }
    interlock(false);
    let open = source.prepare(Amps(1e-3), Volts(5.0)).await;
    assert!(matches!(open, Err(RigError::Interlock { .. })), "{open:?}");
    interlock(true);
    source.prepare(Amps(1e-3), Volts(5.0)).await.unwrap();
    assert!(!source.in_compliance().await.unwrap());
}

#[tokio::test]
async fn what_cannot_be_set_is_refused_before_a_byte_is_sent() {
    let device = device(500.0);
    let mut source = connected(&device).await;
    let unprepared = source.set_current(Amps(1e-9)).await;
    assert!(matches!(
        unprepared,
        Err(RigError::CurrentOutOfRange { .. })
    ));
    source.prepare(Amps(1e-3), Volts(5.0)).await.unwrap();
    simulator(&device, |b| b.received.clear());
    for current in [2.2e-3, -1.0, f64::NAN, f64::INFINITY] {
        let refused = source.set_current(Amps(current)).await;
        assert!(
            matches!(refused, Err(RigError::CurrentOutOfRange { .. })),
            "{refused:?}"
        );
    }
    for current in [0.1051, f64::NAN] {
        let refused = source.prepare(Amps(current), Volts(5.0)).await;
        assert!(matches!(refused, Err(RigError::CurrentOutOfRange { .. })));
    }
    for limit in [0.0, 0.09, 105.01, 4.005, f64::NAN] {
        let refused = source.prepare(Amps(1e-3), Volts(limit)).await;
        assert!(
            matches!(refused, Err(RigError::VoltageOutOfRange { .. })),
            "{limit}"
        );
    }
    assert!(simulator(&device, |b| b.received.is_empty()));
}

#[tokio::test]
async fn another_instrument_is_refused() {
    let device = device(500.0);
    let other = "KEITHLEY INSTRUMENTS INC.,MODEL 6220,1234567,D04";
    simulator(&device, |b| b.reply_faults.push(ReplyFault::Says(other)));
    let refused = Keithley6221::connect(link(plug(&device))).await;
    assert!(matches!(refused, Err(RigError::WrongInstrument { .. })));
}

#[tokio::test]
async fn old_errors_are_drained_and_new_ones_name_the_command() {
    let device = device(500.0);
    simulator(&device, |b| {
        for _ in 0..20 {
            b.simulator.receive("XYZ", Duration::ZERO, &mut b.load);
        }
    });
    let mut source = connected(&device).await;
    assert_eq!(simulator(&device, |b| b.simulator.errors()), 0);
    source.prepare(Amps(1e-3), Volts(5.0)).await.unwrap();
    simulator(&device, |b| {
        b.simulator
            .set_interlock(false, Duration::ZERO, &mut b.load);
        b.simulator.receive("XYZ", Duration::ZERO, &mut b.load);
    });
    match source.set_output(true).await {
        Err(RigError::Refused { command, code, .. }) => {
            assert_eq!(command, "OUTP 1;:OUTP?");
            assert_eq!(code, -113);
        }
        other => panic!("{other:?}"),
    }
    // The second error was removed with the first: the next command does not report it.
    source.off().await.unwrap();
    source.set_current(Amps(0.0)).await.unwrap();
}

#[tokio::test]
async fn a_refusal_is_reported_also_if_the_link_breaks_after_it() {
    let device = device(500.0);
    let mut source = connected(&device).await;
    source.prepare(Amps(1e-3), Volts(5.0)).await.unwrap();
    simulator(&device, |b| {
        // faults are taken from the end of the list
        let refused = ReplyFault::Says("0.000000E+00;-221,\"Settings conflict\"");
        b.reply_faults.extend([ReplyFault::HangUp, refused]);
    });
    let refused = source.set_current(Amps(1e-3)).await;
    assert!(
        matches!(&refused, Err(RigError::Refused { command, code: -221, .. }) if command.starts_with("SOUR:CURR 1E-3")),
        "{refused:?}"
    );
}

#[tokio::test]
async fn a_read_back_that_differs_is_a_mismatch() {
    let device = device(500.0);
    let mut source = connected(&device).await;
    source.prepare(Amps(1e-3), Volts(5.0)).await.unwrap();
    for reply in ["1.100000E-03;0,\"No error\"", "0.000000E+00;0,\"No error\""] {
        simulator(&device, |b| b.reply_faults.push(ReplyFault::Says(reply)));
        let refused = source.set_current(Amps(1e-3)).await;
        assert!(
            matches!(refused, Err(RigError::Mismatch { .. })),
            "{refused:?}"
        );
    }
    for reply in ["9.9E37;0,\"No error\"", "0,\"No error\"", "", "1E-3;x"] {
        simulator(&device, |b| b.reply_faults.push(ReplyFault::Says(reply)));
        let refused = source.set_current(Amps(1e-3)).await;
        assert!(
            matches!(refused, Err(RigError::Garbled { .. })),
            "{refused:?}"
        );
    }
}

#[tokio::test]
async fn a_source_that_stays_on_is_not_off() {
    let device = device(500.0);
    let mut source = connected(&device).await;
    let live = "1.000000E-03;1;0,\"No error\"";
    simulator(&device, |b| {
        b.reply_faults
            .extend([ReplyFault::Says(live), ReplyFault::Says(live)]);
    });
    match source.off().await {
        Err(RigError::NotOff { output, level, .. }) => {
            assert_eq!((output.as_str(), level), ("on", Amps(1e-3)));
        }
        other => panic!("{other:?}"),
    }
}

#[tokio::test(start_paused = true)]
async fn a_lost_answer_leaves_the_source_off_all_the_same() {
    let device = device(500.0);
    let mut source = connected(&device).await;
    source.prepare(Amps(1e-3), Volts(5.0)).await.unwrap();
    source.set_output(true).await.unwrap();
    simulator(&device, |b| b.reply_faults.push(ReplyFault::Silence));
    let lost = source.set_current(Amps(1e-3)).await;
    assert!(matches!(
        lost,
        Err(RigError::Link(LinkError::Timeout { .. }))
    ));
    assert_eq!(simulator(&device, |b| b.load.flowing), Amps(1e-3));
    source.off().await.unwrap();
    assert_eq!(simulator(&device, |b| b.load.flowing), Amps(0.0));
}

#[tokio::test]
async fn the_output_survives_its_client_and_is_switched_off_on_return() {
    let device = device(500.0);
    let mut source = connected(&device).await;
    source.prepare(Amps(1e-3), Volts(5.0)).await.unwrap();
    source.set_output(true).await.unwrap();
    source.set_current(Amps(1e-3)).await.unwrap();
    simulator(&device, |b| b.reply_faults.push(ReplyFault::HangUp));
    assert!(matches!(
        source.in_compliance().await,
        Err(RigError::Link(LinkError::Lost { .. }))
    ));
    assert_eq!(simulator(&device, |b| b.load.flowing), Amps(1e-3));
    let mut source = connected(&device).await;
    assert_eq!(source.output().await.unwrap(), (Amps(1e-3), true));
    // the source must be prepared again
    assert!(source.set_current(Amps(1e-3)).await.is_err());
    source.off().await.unwrap();
    assert_eq!(simulator(&device, |b| b.load.flowing), Amps(0.0));
}
