//! The sheet on the bench, with the wires that lead to it now.

use std::collections::BTreeSet;
use std::time::Duration;

use phantom::{Phantom, PhantomError, ReadingContext};
use survey::{Amps, Electrode, Ohms, Relay, Volts};

use crate::circuit::{Flow, METER_HI, METER_LO, Resistor};
use crate::fixture::{self, Fixture};

/// A phantom behind a fixture: what the source sees, and what the voltmeter sees.
#[derive(Debug)]
pub(crate) struct Sheet {
    pub(crate) phantom: Phantom,
    fixture: Fixture,
    closed: BTreeSet<Relay>,
    /// The channel that the voltmeter's scan has closed for the reading under way, with its bank's bus relay.
    scanned: Vec<Relay>,
    poles: [Option<Electrode>; 4],
    flowing: Amps,
    /// What the phantom could not compute; the source then sees an open circuit and readings are over range.
    fault: Option<PhantomError>,
}

impl Sheet {
    pub(crate) fn new(phantom: Phantom, fixture: Fixture) -> Self {
        Self {
            phantom,
            fixture,
            closed: BTreeSet::new(),
            scanned: Vec::new(),
            poles: [None; 4],
            flowing: Amps(0.0),
            fault: None,
        }
    }

    pub(crate) fn set_closed(&mut self, closed: &BTreeSet<Relay>) {
        self.closed.clone_from(closed);
    }

    pub(crate) fn set_poles(&mut self, poles: [Option<Electrode>; 4]) {
        self.poles = poles;
    }

    /// Says which channel a scan reads; `None` when it reads none.
    pub(crate) fn set_scanned(&mut self, channel: Option<Relay>) {
        self.scanned.clear();
        if let Some(channel) = channel {
            self.scanned.push(channel);
            self.scanned.extend(self.fixture.scanned_by(channel));
        }
    }

    pub(crate) fn closed(&self) -> &BTreeSet<Relay> {
        &self.closed
    }

    pub(crate) fn poles(&self) -> [Option<Electrode>; 4] {
        self.poles
    }

    pub(crate) fn flowing(&self) -> Amps {
        self.flowing
    }

    pub(crate) fn fault(&self) -> Option<&PhantomError> {
        self.fault.as_ref()
    }

    /// What an ideal voltmeter has at its terminals.
    pub(crate) fn voltage(&mut self, at: Duration) -> Volts {
        let flowing = self.flowing.0;
        if flowing == 0.0 {
            return Volts(0.0);
        }
        let resistors = self.resistors();
        match self.phantom.transfer_impedance(at) {
            Ok(z) => {
                let flow = Flow::solve(resistors, z);
                Volts(flowing * flow.across(z, METER_HI, METER_LO))
            }
            Err(fault) => {
                self.fault = Some(fault);
                Volts(f64::INFINITY)
            }
        }
    }

    /// What the voltmeter is given to measure: the ideal voltage, bent by the scene's effects.
    pub(crate) fn measured(&mut self, context: ReadingContext) -> Volts {
        let exact = self.voltage(context.at);
        if exact.0.is_finite() {
            self.phantom.reading(exact, context)
        } else {
            exact
        }
    }

    fn resistors(&self) -> Vec<Resistor> {
        let scanned = self
            .scanned
            .iter()
            .filter(|relay| !self.closed.contains(relay));
        self.closed
            .iter()
            .chain(scanned)
            .flat_map(|relay| self.fixture.resistors(*relay))
            .copied()
            .chain(fixture::board(self.poles))
            .collect()
    }
}

impl keithley_6221::Load for Sheet {
    fn resistance(&mut self, at: Duration) -> Ohms {
        let resistors = self.resistors();
        match self.phantom.transfer_impedance(at) {
            Ok(z) => Ohms(Flow::solve(resistors, z).resistance(z)),
            Err(fault) => {
                self.fault = Some(fault);
                Ohms(f64::INFINITY)
            }
        }
    }

    fn drive(&mut self, flowing: Amps, _range: Amps, _at: Duration) {
        self.flowing = flowing;
    }
}
