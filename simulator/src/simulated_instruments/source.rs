//! The current source (6221) of the simulated rig.

use std::time::Duration;

use keithley_6221::{Load, Settings6221, Simulator6221, Trigger};
use scpi::{ErrorEntry, ParseError};
use survey::Amps;

use crate::fault::Fault;
use crate::simulated_instruments::instrument::{ExternalCircuit, Reply, SimulatedInstrument};

/// A 6221, with the settings that a power cycle restores.
#[derive(Debug)]
pub(crate) struct Source {
    simulator: Simulator6221,
    settings: Settings6221,
}

impl Source {
    /// A source after power on.
    pub(crate) fn new(settings: Settings6221) -> Self {
        Self {
            simulator: Simulator6221::new(settings.clone()),
            settings,
        }
    }
}

impl SimulatedInstrument for Source {
    fn receive(
        &mut self,
        _: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Reply {
        let reply = self.simulator.receive(line, at, outside);
        Reply {
            text: reply.text,
            busy: reply.busy,
            later: false,
        }
    }

    fn pass(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) {
        self.simulator.load_changed(at, outside);
    }

    fn load_changed(&mut self, at: Duration, load: &mut dyn Load) {
        self.simulator.load_changed(at, load);
    }

    fn current_source(&self) -> Option<&Simulator6221> {
        Some(&self.simulator)
    }

    fn latest_error(&self) -> (u64, Option<&ErrorEntry>) {
        self.simulator.latest_error()
    }

    fn refuse(
        &mut self,
        _: u32,
        refusal: ParseError,
        _: Duration,
        _: &mut dyn ExternalCircuit,
    ) -> Option<String> {
        self.simulator.refuse(refusal);
        None
    }

    fn end_session(&mut self, _: u32) {
        self.simulator.forget_answer();
    }

    fn power_cycle(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) -> Option<String> {
        self.simulator = Simulator6221::new(self.settings.clone());
        outside.drive(Amps(0.0), self.simulator.range(), at);
        None
    }

    fn fault(&mut self, fault: &Fault, at: Duration, outside: &mut dyn ExternalCircuit) {
        match fault {
            Fault::Interlock(closed) => self.simulator.set_interlock(*closed, at, outside),
            Fault::Pulse(Some(line)) => {
                self.simulator.trigger(Trigger::Link(*line), at, outside);
            }
            Fault::None => self.simulator.set_interlock(true, at, outside),
            _ => {}
        }
    }
}
