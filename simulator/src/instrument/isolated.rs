//! A single simulated instrument for conversations with given times: goldens and transcripts.

use std::collections::BTreeSet;
use std::time::Duration;

use gpio_mux::Poles;
use keithley_6221::{Load, Resistor};
use keysight_34980a::{MeterRequest, Module, Wires};
use survey::{Amps, Electrode, Ohms, Relay, Volts};

use crate::instrument::Instrument;
use crate::instrument::simulated::SimulatedInstrument;

/// Configuration of an instrument, and the circuit at its terminals.
#[derive(Debug, Clone, PartialEq)]
pub struct InstrumentSetup {
    /// Which instrument.
    pub instrument: Instrument,
    /// First field of the mainframe's `*IDN?`; `None` for the default.
    pub vendor: Option<String>,
    /// The mainframe's modules.
    pub slots: [Option<Module>; 8],
    /// Resistance at the source's terminals, ohm; infinite if open.
    pub ohms: f64,
    /// Voltage at the voltmeter, V.
    pub volts: f64,
}

impl InstrumentSetup {
    /// An instrument with default settings: no modules, nothing on its terminals.
    pub fn of(instrument: Instrument) -> Self {
        Self {
            instrument,
            vendor: None,
            slots: [None; 8],
            ohms: f64::INFINITY,
            volts: 0.0,
        }
    }
}

/// The surroundings of an isolated instrument: one resistor, one voltage everywhere, unconnected poles.
#[derive(Debug)]
struct FixedCircuit {
    resistor: Resistor,
    volts: Volts,
}

impl Load for FixedCircuit {
    fn resistance(&mut self, at: Duration) -> Ohms {
        self.resistor.resistance(at)
    }

    fn drive(&mut self, flowing: Amps, range: Amps, at: Duration) {
        self.resistor.drive(flowing, range, at);
    }
}

impl Wires for FixedCircuit {
    fn relays(&mut self, _: &BTreeSet<Relay>, _: Duration) {}

    fn measure(&mut self, _: Duration, _: MeterRequest) -> Volts {
        self.volts
    }
}

impl Poles for FixedCircuit {
    fn poles(&mut self, _: [Option<Electrode>; 4], _: Duration) {}
}

/// An instrument after power on.
#[derive(Debug)]
pub(crate) struct IsolatedInstrument {
    instrument: Box<dyn SimulatedInstrument>,
    surroundings: FixedCircuit,
}

impl IsolatedInstrument {
    pub(crate) fn new(setup: &InstrumentSetup) -> Self {
        Self {
            instrument: (setup.instrument.kind().isolated)(setup),
            surroundings: FixedCircuit {
                resistor: Resistor::new(Ohms(setup.ohms)),
                volts: Volts(setup.volts),
            },
        }
    }

    /// Receives a message at a time since power on; returns the reply, and the time that the instrument is busy.
    pub(crate) fn receive(&mut self, line: &str, at: Duration) -> (Option<String>, Duration) {
        let reply = self.instrument.receive(0, line, at, &mut self.surroundings);
        (reply.text, reply.busy)
    }
}
