//! One simulated instrument on its own, for conversations whose times are given: goldens and transcripts.

use std::collections::BTreeSet;
use std::time::Duration;

use gpio_mux::{Poles, SimulatorGpioMux};
use keithley_6221::{Resistor, Settings6221, Simulator6221};
use keysight_34980a::{MeterRequest, Module, Settings34980a, Simulator34980a, Wires};
use survey::{Electrode, Ohms, Relay, Volts};

use crate::Instrument;

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

/// The same voltage wherever it is measured.
#[derive(Debug)]
pub(crate) struct ConstantVoltage(f64);

impl Wires for ConstantVoltage {
    fn relays(&mut self, _: &BTreeSet<Relay>, _: Duration) {}

    fn measure(&mut self, _: Duration, _: MeterRequest) -> Volts {
        Volts(self.0)
    }
}

/// Poles that lead nowhere.
#[derive(Debug)]
pub(crate) struct UnconnectedPoles;

impl Poles for UnconnectedPoles {
    fn poles(&mut self, _: [Option<Electrode>; 4], _: Duration) {}
}

/// An instrument just switched on.
#[derive(Debug)]
pub(crate) enum IsolatedInstrument {
    Source(Box<Simulator6221>, Resistor),
    Mainframe(Box<Simulator34980a>, ConstantVoltage),
    Board(Box<SimulatorGpioMux>),
}

impl IsolatedInstrument {
    pub(crate) fn new(setup: &InstrumentSetup) -> Self {
        match setup.instrument {
            Instrument::Source => Self::Source(
                Box::new(Simulator6221::new(Settings6221::default())),
                Resistor::new(Ohms(setup.ohms)),
            ),
            Instrument::Mainframe => {
                let mut settings = Settings34980a {
                    slots: setup.slots,
                    ..Settings34980a::default()
                };
                if let Some(vendor) = &setup.vendor {
                    settings.vendor.clone_from(vendor);
                }
                Self::Mainframe(
                    Box::new(Simulator34980a::new(settings)),
                    ConstantVoltage(setup.volts),
                )
            }
            Instrument::Board => Self::Board(Box::new(SimulatorGpioMux::new(
                gpio_mux::Settings::default(),
            ))),
        }
    }

    /// Hears a message at a time since power on: the reply, and how long the instrument is busy with it.
    pub(crate) fn receive(&mut self, line: &str, at: Duration) -> (Option<String>, Duration) {
        match self {
            Self::Source(source, load) => {
                let reply = source.receive(line, at, load);
                (reply.text, reply.busy)
            }
            Self::Mainframe(unit, wires) => {
                // Readings that were due meanwhile are taken at their own times.
                while let Some(due) = unit.due().filter(|due| *due < at) {
                    unit.pass(due, wires);
                }
                let reply = unit.receive(line, at, wires);
                (reply.text, reply.busy)
            }
            Self::Board(board) => {
                let reply = board.receive(line, at, &mut UnconnectedPoles);
                (reply.text, reply.busy)
            }
        }
    }
}
