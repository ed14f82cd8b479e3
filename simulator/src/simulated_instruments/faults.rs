//! Faults inside the instruments, and between them and the sheet.

use std::time::Duration;

use keysight_34980a::Session;
use scpi::ParseError;

use crate::fault::Fault;
use crate::profile::Pace;
use crate::simulated_instruments::{Ends, ReplyTiming, SimulatedInstruments};
use crate::simulated_rig::Instrument;

/// More messages than any instrument's error queue holds.
const OVERFLOWING: usize = 64;

impl SimulatedInstruments {
    /// Queues an error that arose outside of any message; what the instrument says to it, if it says anything.
    pub(crate) fn refuse(
        &mut self,
        instrument: Instrument,
        session: u32,
        refusal: ParseError,
    ) -> Option<String> {
        match instrument {
            Instrument::Source => self.source.refuse(refusal),
            Instrument::Mainframe => self.mainframe.fault_of_session(Session(session), refusal),
            Instrument::Board => {
                self.catch_up();
                let at = self.now();
                let mut ends = Ends {
                    source: &mut self.source,
                    sheet: &mut self.sheet,
                    readings: 0,
                };
                return self.board.receive_oversized(at, &mut ends).text;
            }
        }
        None
    }

    /// What the time line holds until now.
    pub(crate) fn take_due_faults(&mut self) -> Vec<Fault> {
        let now = self.now();
        let due = self.time_line.iter().take_while(|timed| timed.at <= now);
        let due = due.count();
        self.time_line
            .drain(..due)
            .map(|timed| timed.fault)
            .collect()
    }

    /// Time on the wall until the next of the time line.
    pub(crate) fn next_fault_in(&self) -> Option<Duration> {
        let left = self.time_line.front()?.at.saturating_sub(self.now());
        match self.pace {
            Pace::Real => Some(left),
            Pace::Scaled(speed) => Some(survey::duration(left.as_secs_f64() / speed)),
            Pace::Instant => None,
        }
    }

    /// Whether a module or the voltmeter has been taken out.
    pub(crate) fn is_opened_up(&self) -> bool {
        self.voltmeter_missing || self.emptied.contains(&true)
    }

    /// A fault inside the instruments or between them and the sheet.
    pub(crate) fn fault(&mut self, fault: &Fault) {
        let at = self.now();
        match fault {
            Fault::QueueOverflow(Instrument::Mainframe) => self.mainframe.overflow_errors(),
            Fault::QueueOverflow(instrument) => {
                for _ in 0..OVERFLOWING {
                    self.receive(*instrument, 0, "TACTUS:FAULT", ReplyTiming::AtOnce);
                }
            }
            Fault::StuckOpen(relay) => self.sheet.stick(*relay, false),
            Fault::StuckClosed(relay) => self.sheet.stick(*relay, true),
            Fault::Free(relay) => self.sheet.free(*relay),
            Fault::Overload(on) => self.sheet.overload = *on,
            Fault::Interlock(closed) => self.source.set_interlock(*closed, at, &mut self.sheet),
            Fault::TerminalBlock(slot, shut) => {
                self.on_mainframe(|mainframe, ends| {
                    mainframe.set_interlock(*slot, !shut, at, ends);
                });
            }
            Fault::Pulse(Some(line)) => {
                let event = keithley_6221::Trigger::Link(*line);
                self.source.trigger(event, at, &mut self.sheet);
            }
            Fault::Pulse(None) => self.on_mainframe(|mainframe, ends| mainframe.pulse(at, ends)),
            Fault::Slot(slot, filled) => self.set_slot(*slot, *filled),
            Fault::Voltmeter(present) => self.set_voltmeter(*present),
            Fault::None => {
                self.sheet.free_all();
                self.sheet.overload = false;
                self.source.set_interlock(true, at, &mut self.sheet);
                for slot in 1..=8 {
                    self.on_mainframe(|mainframe, ends| {
                        mainframe.set_interlock(slot, false, at, ends);
                    });
                    if self.emptied[slot as usize - 1] {
                        self.set_slot(slot, true);
                    }
                }
                if self.voltmeter_missing {
                    self.set_voltmeter(true);
                }
                self.time_line.clear();
            }
            Fault::Wire(..)
            | Fault::Drop(_)
            | Fault::Replies(..)
            | Fault::Slow(..)
            | Fault::Reset(_)
            | Fault::Serial(_) => {}
        }
        self.catch_up();
    }

    fn set_slot(&mut self, slot: u32, filled: bool) {
        let at = self.now();
        let index = slot as usize - 1;
        let module = self.slots[index].filter(|_| filled);
        self.emptied[index] = !filled && self.slots[index].is_some();
        self.on_mainframe(|mainframe, ends| {
            mainframe.power_cycle(at, ends);
            mainframe.set_module(slot, module, at, ends);
        });
    }

    fn set_voltmeter(&mut self, present: bool) {
        let at = self.now();
        self.voltmeter_missing = !present;
        self.on_mainframe(|mainframe, ends| {
            mainframe.power_cycle(at, ends);
            mainframe.set_voltmeter(present, at, ends);
        });
    }
}
