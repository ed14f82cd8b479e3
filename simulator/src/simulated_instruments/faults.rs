//! Faults inside the instruments, and between them and the sheet.

use std::time::Duration;

use scpi::ParseError;

use crate::instrument::fault::Fault;
use crate::instrument::{Instrument, Pace};
use crate::simulated_instruments::{ReplyTiming, SimulatedInstruments};

/// More messages than the error queue of any instrument holds.
const OVERFLOWING: usize = 64;

impl SimulatedInstruments {
    /// Queues an error that does not belong to a message; returns the instrument's reply, if any.
    pub(crate) fn refuse(
        &mut self,
        instrument: Instrument,
        session: u32,
        refusal: ParseError,
    ) -> Option<String> {
        self.catch_up();
        let at = self.now();
        let refused = self.act(instrument, |instrument, outside| {
            instrument.refuse(session, refusal, at, outside)
        });
        refused.0
    }

    /// The faults of the time line that are due.
    pub(crate) fn take_due_faults(&mut self) -> Vec<Fault> {
        let now = self.now();
        let due = self.time_line.iter().take_while(|timed| timed.at <= now);
        let due = due.count();
        self.time_line
            .drain(..due)
            .map(|timed| timed.fault)
            .collect()
    }

    /// Real time until the next fault of the time line.
    pub(crate) fn next_fault_in(&self) -> Option<Duration> {
        let left = self.time_line.front()?.at.saturating_sub(self.now());
        match self.pace {
            Pace::Real => Some(left),
            Pace::Scaled(speed) => Some(survey::duration(left.as_secs_f64() / speed)),
            Pace::Instant => None,
        }
    }

    /// Whether a module or the voltmeter is removed.
    pub(crate) fn has_part_removed(&self) -> bool {
        let mut instruments = self.places.iter().map(|place| &place.instrument);
        instruments.any(|instrument| instrument.has_part_removed())
    }

    /// Applies a fault inside the instruments or between them and the sheet.
    pub(crate) fn fault(&mut self, fault: &Fault) {
        let at = self.now();
        match fault {
            Fault::QueueOverflow(role) => {
                if !self.place_mut(*role).instrument.overflow_errors() {
                    for _ in 0..OVERFLOWING {
                        self.receive(*role, 0, "TACTUS:FAULT", ReplyTiming::AtOnce);
                    }
                }
            }
            Fault::StuckOpen(relay) => self.sheet.stick(*relay, false),
            Fault::StuckClosed(relay) => self.sheet.stick(*relay, true),
            Fault::Free(relay) => self.sheet.unstick(*relay),
            Fault::Overload(on) => self.sheet.overload = *on,
            Fault::TerminalBlock(slot, shut) => {
                self.sheet.set_block(*slot, *shut);
                self.fault_of_instruments(fault, at);
            }
            Fault::Interlock(_)
            | Fault::Pulse(_)
            | Fault::Slot(..)
            | Fault::Module(..)
            | Fault::Voltmeter(_) => self.fault_of_instruments(fault, at),
            Fault::None => {
                self.sheet.unstick_all();
                self.sheet.overload = false;
                self.sheet.shut_blocks();
                self.fault_of_instruments(fault, at);
                self.time_line.clear();
            }
            Fault::Wire(..)
            | Fault::Drop(_)
            | Fault::Replies(..)
            | Fault::Slow(..)
            | Fault::Reset(_)
            | Fault::PowerCut
            | Fault::Serial(_) => {}
        }
        self.catch_up();
    }

    /// Passes a fault to all instruments, the source first; each handles the faults that concern it.
    fn fault_of_instruments(&mut self, fault: &Fault, at: Duration) {
        for role in Instrument::ALL {
            self.act(role, |instrument, outside| {
                instrument.fault(fault, at, outside);
            });
        }
    }
}
