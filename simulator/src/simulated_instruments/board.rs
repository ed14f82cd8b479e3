//! The multiplexer board of the simulated rig.

use std::time::Duration;

use gpio_mux::{Settings, SimulatorGpioMux};
use scpi::{ErrorEntry, ParseError};

use crate::simulated_instruments::instrument::{ExternalCircuit, Reply, SimulatedInstrument};

/// A multiplexer board.
#[derive(Debug)]
pub(crate) struct Board(SimulatorGpioMux);

impl Board {
    /// A board after power on.
    pub(crate) fn new(settings: Settings) -> Self {
        Self(SimulatorGpioMux::new(settings))
    }
}

impl SimulatedInstrument for Board {
    fn receive(
        &mut self,
        _: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Reply {
        let reply = self.0.receive(line, at, outside);
        Reply {
            text: reply.text,
            busy: reply.busy,
            later: false,
        }
    }

    fn pass(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) {
        self.0.pass(at, outside);
    }

    fn latest_error(&self) -> (u64, Option<&ErrorEntry>) {
        self.0.latest_error()
    }

    fn refuse(
        &mut self,
        _: u32,
        _: ParseError,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Option<String> {
        self.0.receive_oversized(at, outside).text
    }

    fn power_cycle(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) -> Option<String> {
        Some(self.0.reset(at, outside))
    }
}
