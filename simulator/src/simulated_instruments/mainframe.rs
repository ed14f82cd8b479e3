//! The switch and voltmeter (34980A) of the simulated rig.

use std::time::Duration;

use keysight_34980a::{Module, Session, Settings34980a, Simulator34980a};
use scpi::{ErrorEntry, ParseError};

use crate::fault::Fault;
use crate::simulated_instruments::instrument::{ExternalCircuit, Reply, SimulatedInstrument};

/// A 34980A whose modules can be removed and inserted by faults.
#[derive(Debug)]
pub(crate) struct Mainframe {
    simulator: Simulator34980a,
    slots: [Option<Module>; 8],
    /// Whose module is out, or another one.
    changed: [bool; 8],
    voltmeter_missing: bool,
}

impl Mainframe {
    /// A mainframe after power on.
    pub(crate) fn new(settings: Settings34980a) -> Self {
        Self {
            slots: settings.slots,
            changed: [false; 8],
            voltmeter_missing: false,
            simulator: Simulator34980a::new(settings),
        }
    }

    /// The module that the profile has in a slot, 1 to 8.
    fn own(&self, slot: u32) -> Option<Module> {
        self.slots[slot as usize - 1]
    }

    fn set_slot(
        &mut self,
        slot: u32,
        module: Option<Module>,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) {
        self.changed[slot as usize - 1] = module != self.own(slot);
        self.simulator.power_cycle(at, outside);
        self.simulator.set_module(slot, module, at, outside);
    }

    fn set_voltmeter(&mut self, present: bool, at: Duration, outside: &mut dyn ExternalCircuit) {
        self.voltmeter_missing = !present;
        self.simulator.power_cycle(at, outside);
        self.simulator.set_voltmeter(present, at, outside);
    }
}

impl SimulatedInstrument for Mainframe {
    fn receive(
        &mut self,
        session: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Reply {
        let reply = self
            .simulator
            .receive_from(Session(session), line, at, outside);
        Reply {
            text: reply.text,
            busy: reply.busy,
            later: false,
        }
    }

    fn begin(
        &mut self,
        session: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Reply {
        let (reply, later) = self
            .simulator
            .begin_from(Session(session), line, at, outside);
        Reply {
            text: reply.text,
            busy: reply.busy,
            later,
        }
    }

    fn fetch(
        &mut self,
        session: u32,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Option<String> {
        self.simulator.fetch(Session(session), at, outside)
    }

    fn has_reply(&self, session: u32) -> bool {
        self.simulator.has_readings_for(Session(session))
    }

    fn due(&self) -> Option<Duration> {
        self.simulator.due()
    }

    fn pass(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) {
        self.simulator.pass(at, outside);
    }

    fn latest_error(&self) -> (u64, Option<&ErrorEntry>) {
        self.simulator.latest_error()
    }

    fn refuse(
        &mut self,
        session: u32,
        refusal: ParseError,
        _: Duration,
        _: &mut dyn ExternalCircuit,
    ) -> Option<String> {
        self.simulator.fault_of_session(Session(session), refusal);
        None
    }

    fn name_session(&mut self, session: u32, name: &str) {
        self.simulator.name_session(Session(session), name);
    }

    fn end_session(&mut self, session: u32) {
        self.simulator.end_session(Session(session));
    }

    fn clear_session(&mut self, session: u32, at: Duration, outside: &mut dyn ExternalCircuit) {
        self.simulator.clear_session(Session(session), at, outside);
    }

    fn status_byte(&self) -> u8 {
        self.simulator.status_byte()
    }

    fn power_cycle(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) -> Option<String> {
        self.simulator.power_cycle(at, outside);
        None
    }

    fn overflow_errors(&mut self) -> bool {
        self.simulator.overflow_errors();
        true
    }

    fn fault(&mut self, fault: &Fault, at: Duration, outside: &mut dyn ExternalCircuit) {
        match fault {
            Fault::TerminalBlock(slot, shut) => {
                self.simulator.set_interlock(*slot, !shut, at, outside);
            }
            Fault::Pulse(None) => self.simulator.pulse(at, outside),
            Fault::Slot(slot, filled) => {
                let module = self.own(*slot).filter(|_| *filled);
                self.set_slot(*slot, module, at, outside);
            }
            Fault::Module(slot, module) => self.set_slot(*slot, Some(*module), at, outside),
            Fault::Voltmeter(present) => self.set_voltmeter(*present, at, outside),
            Fault::None => {
                for slot in 1..=8 {
                    self.simulator.set_interlock(slot, false, at, outside);
                    if self.changed[slot as usize - 1] {
                        self.set_slot(slot, self.own(slot), at, outside);
                    }
                }
                if self.voltmeter_missing {
                    self.set_voltmeter(true, at, outside);
                }
            }
            _ => {}
        }
    }

    fn has_part_removed(&self) -> bool {
        self.voltmeter_missing || self.changed.contains(&true)
    }
}
