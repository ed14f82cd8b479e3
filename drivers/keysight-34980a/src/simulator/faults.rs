//! Faults that a scene or a user can inject (section 10). Faults of the connection are injected by the server.

use std::time::Duration;

use scpi::ParseError;

use super::{Simulator34980a, Wires};
use crate::command::{Protection, TriggerSource};
use crate::modules::Module;

impl Simulator34980a {
    /// Removes the voltmeter, or installs it again.
    pub fn set_voltmeter(&mut self, installed: bool, at: Duration, wires: &mut dyn Wires) {
        self.pass(at, wires);
        if !installed {
            self.stop_measuring(at, wires);
        }
        self.meter.install(installed);
    }

    /// Replaces the module of a slot (1 to 8), or removes it. The relays of the new module are open, and its channels
    /// are not in the scan list.
    pub fn set_module(
        &mut self,
        slot: u32,
        module: Option<Module>,
        at: Duration,
        wires: &mut dyn Wires,
    ) {
        self.pass(at, wires);
        self.stop_measuring(at, wires);
        self.meter.forget_slot(slot);
        self.relays.replace(slot, module);
        self.relays.tell(at, wires);
    }

    /// Opens or closes the terminal block of a slot. While it is open, the relays to the buses and all relays of a
    /// 34934A cannot be closed.
    pub fn set_interlock(&mut self, slot: u32, open: bool, at: Duration, wires: &mut dyn Wires) {
        self.pass(at, wires);
        self.relays.interlock(slot, open);
        self.relays.tell(at, wires);
    }

    /// An external trigger pulse at the rear, for `TRIG:SOUR EXT`.
    pub fn pulse(&mut self, at: Duration, wires: &mut dyn Wires) {
        self.pass(at, wires);
        // A pulse that is not awaited is not an error.
        if self.meter.trigger(TriggerSource::External, at).is_ok() {
            self.pass(at, wires);
        }
    }

    /// Fills the error queue until it overflows.
    pub fn overflow_errors(&mut self) {
        while self.errors.len() < super::ERRORS {
            self.fail(ParseError::Syntax.into());
        }
        self.fail(ParseError::Syntax.into());
    }

    /// Row protection of a 34934A; `None` for any other slot.
    pub fn protection(&self, slot: u32) -> Option<Protection> {
        self.relays.protection(slot).ok()
    }
}
