//! A test implementation of the wires: records relay states, and computes voltages by a rule.
#![allow(dead_code, reason = "each test file uses its part")]

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use keysight_34980a::{MeterRequest, Module, Settings34980a, Simulator34980a, Wires};
use survey::{Relay, Volts};

/// The voltage of a measuring channel is its own number times 1 mV plus 1 V for injecting pair 1, 2 V for pair 2, ...
/// while exactly one injecting pair (a channel of bank 2 or of a source row) is closed. A reading of the bare voltmeter
/// is that of the channel of matrix row 1 or 5 that is closed together with relay 921.
#[derive(Debug, Default)]
pub struct Sheet {
    pub closed: BTreeSet<Relay>,
    pub history: Vec<(Duration, BTreeSet<Relay>)>,
    pub requests: Vec<(Duration, MeterRequest, BTreeSet<Relay>)>,
    pub volts: Option<f64>,
    /// Closures by skipped sweeps.
    pub skipped: BTreeMap<Relay, u32>,
}

impl Wires for Sheet {
    fn relays(&mut self, closed: &BTreeSet<Relay>, at: Duration) {
        self.closed.clone_from(closed);
        self.history.push((at, closed.clone()));
    }

    fn skipped(&mut self, relays: &[Relay], times: u32, _: Duration) {
        for relay in relays {
            *self.skipped.entry(*relay).or_default() += times;
        }
    }

    fn measure(&mut self, at: Duration, requested: MeterRequest) -> Volts {
        self.requests.push((at, requested, self.closed.clone()));
        if let Some(volts) = self.volts {
            return Volts(volts);
        }
        let channel = |relay: &Relay| relay.0 % 1000;
        let injecting = |relay: &&Relay| matches!(channel(relay), 36..=70 | 201..=216 | 601..=616);
        let sources: Vec<&Relay> = self.closed.iter().filter(injecting).collect();
        let [source] = sources.as_slice() else {
            return Volts(0.0);
        };
        let pair = match channel(source) {
            number @ 36..=70 => number - 35,
            number @ 201..=216 => number - 200,
            number => number - 600 + 16,
        };
        let measured = match requested.channel {
            Some(relay) => Some(channel(&relay)),
            None if self.closed.iter().any(|relay| channel(relay) == 921) => self
                .closed
                .iter()
                .map(channel)
                .find(|number| matches!(number, 101..=116 | 501..=516)),
            None => None,
        };
        measured.map_or(Volts(0.0), |number| {
            Volts(f64::from(pair) + f64::from(number) * 1e-3)
        })
    }
}

/// A mainframe with modules in its first slots.
pub fn mainframe(modules: &[&str]) -> Simulator34980a {
    Simulator34980a::new(Settings34980a {
        slots: mainframe_slots(modules),
        ..Settings34980a::default()
    })
}

/// Slots of which the first hold these modules; an empty name is an empty slot.
pub fn mainframe_slots(modules: &[&str]) -> [Option<Module>; 8] {
    let mut slots = [None; 8];
    for (slot, module) in slots.iter_mut().zip(modules) {
        *slot = (!module.is_empty()).then(|| module.parse().unwrap());
    }
    slots
}

/// Sends one message at time 0 and returns the reply.
pub fn say(unit: &mut Simulator34980a, sheet: &mut Sheet, message: &str) -> Option<String> {
    unit.receive(message, Duration::ZERO, sheet).text
}
