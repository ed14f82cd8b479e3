//! Faults of a running rig.

use std::collections::VecDeque;
use std::sync::{MutexGuard, PoisonError};
use std::time::Duration;

use crate::fault::{Fault, FaultError, ReplyFault};
use crate::instrument::{Instrument, Wire};
use crate::simulated_rig::SimulatedRig;
use survey::Relay;

impl SimulatedRig {
    /// Applies or ends a fault.
    ///
    /// # Errors
    /// A fault of a part that this rig does not have.
    pub fn fault(&self, fault: &Fault) -> Result<(), FaultError> {
        self.check_is_here(fault)?;
        tracing::info!("fault: {fault}");
        match fault {
            Fault::Wire(instrument, wire) => self.set_wire(*instrument, *wire),
            Fault::Drop(instrument) => {
                let wire = self.shared.wires[instrument.index()].borrow().wire;
                self.set_wire(*instrument, Wire::Cut);
                self.set_wire(*instrument, wire);
            }
            Fault::Replies(instrument, reply_fault, count) => {
                let next = (*reply_fault, *count);
                self.link_faults()[instrument.index()].next.push_back(next);
            }
            Fault::Slow(instrument, by) => {
                self.link_faults()[instrument.index()].slower_by = *by;
            }
            Fault::Reset(Instrument::Board) => {
                let banner = self.instruments().power_cycle(Instrument::Board);
                self.shared.banner.send_replace(banner.unwrap_or_default());
            }
            Fault::Reset(instrument) => self.power_cycle(*instrument),
            Fault::Serial(plugged) => {
                if *plugged {
                    self.instruments().power_cycle(Instrument::Board);
                }
                let wire = if *plugged { Wire::Sound } else { Wire::Cut };
                self.set_wire(Instrument::Board, wire);
            }
            Fault::Slot(..) | Fault::Voltmeter(_) => {
                // A mainframe must be switched off to be opened.
                self.set_wire(Instrument::Mainframe, Wire::Cut);
                self.instruments().fault(fault);
                self.set_wire(Instrument::Mainframe, Wire::Sound);
            }
            Fault::None => {
                for instrument in Instrument::ALL {
                    self.link_faults()[instrument.index()] = LinkFaults::default();
                    if self.shared.wires[instrument.index()].borrow().wire != Wire::Sound {
                        self.set_wire(instrument, Wire::Sound);
                    }
                }
                if self.instruments().is_opened_up() {
                    self.set_wire(Instrument::Mainframe, Wire::Cut);
                    self.set_wire(Instrument::Mainframe, Wire::Sound);
                }
                self.instruments().fault(fault);
            }
            Fault::QueueOverflow(_)
            | Fault::StuckOpen(_)
            | Fault::StuckClosed(_)
            | Fault::Free(_)
            | Fault::Overload(_)
            | Fault::Interlock(_)
            | Fault::TerminalBlock(..)
            | Fault::Pulse(_) => self.instruments().fault(fault),
        }
        self.shared.changed.notify_waiters();
        Ok(())
    }

    /// Checks that this rig has the part that a fault concerns.
    fn check_is_here(&self, fault: &Fault) -> Result<(), FaultError> {
        match fault {
            Fault::Wire(Instrument::Board, _)
            | Fault::Drop(Instrument::Board)
            | Fault::Replies(Instrument::Board, ..)
            | Fault::Slow(Instrument::Board, _)
            | Fault::QueueOverflow(Instrument::Board)
            | Fault::Reset(Instrument::Board)
            | Fault::Serial(_) => self.need_board(),
            Fault::StuckOpen(relay) | Fault::StuckClosed(relay) => self.check_relay(*relay),
            Fault::Free(relay) => {
                self.check_relay(*relay)?;
                match self.instruments().sheet.is_stuck(*relay) {
                    true => Ok(()),
                    false => Err(FaultError::NotStuck(*relay)),
                }
            }
            Fault::Slot(slot, _) | Fault::TerminalBlock(slot, _) => {
                match self.instruments().sheet.has_module(*slot) {
                    true => Ok(()),
                    false => Err(FaultError::NoModule(*slot)),
                }
            }
            _ => Ok(()),
        }
    }

    fn check_relay(&self, relay: Relay) -> Result<(), FaultError> {
        let on_board = self.shared.has_board;
        match self.instruments().sheet.has_relay(relay, on_board) {
            true => Ok(()),
            false => Err(FaultError::NoRelay(relay)),
        }
    }

    fn need_board(&self) -> Result<(), FaultError> {
        if self.shared.has_board {
            Ok(())
        } else {
            Err(FaultError::NotHere("there is no multiplexer board"))
        }
    }

    /// Applies the faults of the time line that are due.
    pub(crate) fn apply_due_faults(&self) {
        let due = self.instruments().take_due_faults();
        for fault in due {
            if let Err(refusal) = self.fault(&fault) {
                tracing::warn!("the time line's fault '{fault}' cannot be: {refusal}");
            }
        }
    }

    /// Real time until the time line's next fault; `None` if there is none, or if time only advances with messages.
    pub(crate) fn next_fault_in(&self) -> Option<Duration> {
        self.instruments().next_fault_in()
    }

    /// Additional delay of an instrument's replies.
    pub(crate) fn slowness(&self, instrument: Instrument) -> Duration {
        self.link_faults()[instrument.index()].slower_by
    }

    /// The fault of an instrument's next reply.
    pub(crate) fn reply_fault(&self, instrument: Instrument) -> Option<ReplyFault> {
        self.link_faults()[instrument.index()].take()
    }

    fn link_faults(&self) -> MutexGuard<'_, Vec<LinkFaults>> {
        let link_faults = self.shared.link_faults.lock();
        link_faults.unwrap_or_else(PoisonError::into_inner)
    }
}

/// Faults of replies, and their delay.
#[derive(Debug, Default)]
pub(crate) struct LinkFaults {
    next: VecDeque<(ReplyFault, u32)>,
    slower_by: Duration,
}

impl LinkFaults {
    /// The fault of the next reply.
    fn take(&mut self) -> Option<ReplyFault> {
        let (reply_fault, left) = self.next.front_mut()?;
        let reply_fault = *reply_fault;
        *left -= 1;
        if *left == 0 {
            self.next.pop_front();
        }
        Some(reply_fault)
    }
}
