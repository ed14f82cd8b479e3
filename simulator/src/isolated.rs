//! One simulated instrument on its own, for conversations whose times are given: goldens and transcripts.

use std::collections::BTreeSet;
use std::time::Duration;

use gpio_mux::Poles;
use keithley_6221::{Load, Resistor, Settings6221};
use keysight_34980a::{MeterRequest, Module, Settings34980a, Wires};
use survey::{Amps, Electrode, Ohms, Relay, Volts};

use crate::Instrument;
use crate::simulated_instruments::instrument::SimulatedInstrument;
use crate::simulated_instruments::{Board, Mainframe, Source};

/// What an instrument is made of and what its terminals meet.
#[derive(Debug, Clone, PartialEq)]
pub struct InstrumentSetup {
    /// Which instrument.
    pub instrument: Instrument,
    /// First field of the mainframe's `*IDN?`; without one as it comes.
    pub vendor: Option<String>,
    /// The mainframe's modules.
    pub slots: [Option<Module>; 8],
    /// What hangs on the source's terminals, ohm; infinite where nothing does.
    pub ohms: f64,
    /// What the voltmeter sees, V.
    pub volts: f64,
}

impl InstrumentSetup {
    /// An instrument as it comes: no modules, nothing on its terminals.
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

/// What an isolated instrument meets: one resistor, one voltage wherever it is measured, poles that lead nowhere.
#[derive(Debug)]
struct FixedSurroundings {
    resistor: Resistor,
    volts: Volts,
}

impl Load for FixedSurroundings {
    fn resistance(&mut self, at: Duration) -> Ohms {
        self.resistor.resistance(at)
    }

    fn drive(&mut self, flowing: Amps, range: Amps, at: Duration) {
        self.resistor.drive(flowing, range, at);
    }
}

impl Wires for FixedSurroundings {
    fn relays(&mut self, _: &BTreeSet<Relay>, _: Duration) {}

    fn measure(&mut self, _: Duration, _: MeterRequest) -> Volts {
        self.volts
    }
}

impl Poles for FixedSurroundings {
    fn poles(&mut self, _: [Option<Electrode>; 4], _: Duration) {}
}

/// An instrument just switched on.
#[derive(Debug)]
pub(crate) struct IsolatedInstrument {
    instrument: Box<dyn SimulatedInstrument>,
    surroundings: FixedSurroundings,
}

impl IsolatedInstrument {
    pub(crate) fn new(setup: &InstrumentSetup) -> Self {
        let instrument: Box<dyn SimulatedInstrument> = match setup.instrument {
            Instrument::Source => Box::new(Source::new(Settings6221::default())),
            Instrument::Mainframe => {
                let mut settings = Settings34980a {
                    slots: setup.slots,
                    ..Settings34980a::default()
                };
                if let Some(vendor) = &setup.vendor {
                    settings.vendor.clone_from(vendor);
                }
                Box::new(Mainframe::new(settings))
            }
            Instrument::Board => Box::new(Board::new(gpio_mux::Settings::default())),
        };
        Self {
            instrument,
            surroundings: FixedSurroundings {
                resistor: Resistor::new(Ohms(setup.ohms)),
                volts: Volts(setup.volts),
            },
        }
    }

    /// Receives a message at a time since power on: the reply, and how long the instrument is busy with it.
    pub(crate) fn receive(&mut self, line: &str, at: Duration) -> (Option<String>, Duration) {
        // Readings that were due meanwhile are taken at their own times.
        while let Some(due) = self.instrument.due().filter(|due| *due < at) {
            self.instrument.pass(due, &mut self.surroundings);
        }
        let reply = self.instrument.receive(0, line, at, &mut self.surroundings);
        (reply.text, reply.busy)
    }
}
