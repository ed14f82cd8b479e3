//! Arbitrary bytes at the simulated mainframe, from two sessions, with time advancing: nothing panics or hangs, queues
//! stay bounded, and readings are taken in the order of time.

#![no_main]

use std::collections::BTreeSet;
use std::time::Duration;

use keysight_34980a::{MeterRequest, Module, Session, Settings34980a, Simulator34980a, Wires};
use libfuzzer_sys::fuzz_target;
use scpi::{Framer, ParseError};
use survey::{Relay, Volts};

const LONGEST: usize = 512;

/// A constant voltage; records how many relays are closed.
#[derive(Default)]
struct Steady {
    closed: usize,
}

impl Wires for Steady {
    fn relays(&mut self, closed: &BTreeSet<Relay>, _: Duration) {
        self.closed = closed.len();
    }

    fn measure(&mut self, _: Duration, request: MeterRequest) -> Volts {
        assert!(request.range.0 > 0.0 && request.nplc > 0.0);
        Volts(self.closed as f64 * 0.1)
    }
}

fuzz_target!(|bytes: &[u8]| {
    let mut settings = Settings34980a {
        memory: 200,
        ..Settings34980a::default()
    };
    let modules = [
        "34924A",
        "34921A",
        "34925A",
        "34934A,4x32",
        "34932A,4x32",
        "34934A,none",
    ];
    for (slot, module) in settings.slots.iter_mut().zip(modules) {
        *slot = Some(module.parse::<Module>().expect("each is a module"));
    }
    let (mut unit, mut wires) = (Simulator34980a::new(settings), Steady::default());
    let mut framer = Framer::new(LONGEST);
    framer.push(bytes);
    let mut at = Duration::ZERO;
    for (number, message) in framer.flatten().enumerate() {
        let line = String::from_utf8_lossy(&message);
        let session = Session(u32::from(number % 3 == 2));
        let busy = if number % 5 == 4 {
            let response = unit.receive_from(session, &line, at, &mut wires);
            unit.fault_of_session(ParseError::QueryInterrupted);
            response.busy
        } else if number % 5 == 3 {
            let (response, later) = unit.begin_from(session, &line, at, &mut wires);
            if later {
                unit.pass(at + response.busy / 2, &mut wires);
                unit.fetch(session, at + response.busy, &mut wires);
            }
            response.busy
        } else {
            let response = unit.receive_from(session, &line, at, &mut wires);
            assert!(response.text.is_none_or(|text| !text.is_empty()));
            response.busy
        };
        assert!(unit.errors_waiting() <= 20);
        assert!(
            unit.due()
                .is_none_or(|due| due + Duration::from_secs(1) > at)
        );
        at += busy.min(Duration::from_secs(5)) + Duration::from_millis(3);
        unit.pass(at, &mut wires);
    }
});
