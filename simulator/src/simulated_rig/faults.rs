//! Faults of a running rig.

use std::collections::VecDeque;
use std::sync::{MutexGuard, PoisonError};
use std::time::Duration;

use crate::instrument::fault::{Fault, FaultError, ReplyFault};
use crate::instrument::{Instrument, Port, Wire};
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
            Fault::Drop(instrument) => self.while_cut(*instrument, || {}),
            Fault::Replies(instrument, reply_fault, count) => {
                let next = (*reply_fault, *count);
                self.link_faults()[instrument.index()].next.push_back(next);
            }
            Fault::Slow(instrument, by) => {
                self.link_faults()[instrument.index()].slower_by = *by;
            }
            Fault::Reset(instrument) => match instrument.kind().port {
                Port::Network => self.power_cycle(*instrument),
                Port::Serial => {
                    let banner = self.instruments().power_cycle(*instrument);
                    if let Some(banner) = banner {
                        self.shared.banners[instrument.index()].send_replace(banner);
                    }
                }
            },
            Fault::Serial(plugged) => {
                if *plugged {
                    self.instruments().power_cycle(Instrument::Board);
                }
                let wire = if *plugged { Wire::Sound } else { Wire::Cut };
                self.set_wire(Instrument::Board, wire);
            }
            Fault::PowerCut => {
                let here = Instrument::ALL.into_iter();
                for instrument in here.filter(|instrument| self.has(*instrument)) {
                    self.fault(&Fault::Reset(instrument))?;
                    // The line of a serial port stays: it belongs to the computer.
                    if instrument.kind().port == Port::Network {
                        self.fault(&Fault::Drop(instrument))?;
                    }
                }
            }
            Fault::Slot(..) | Fault::Module(..) | Fault::Voltmeter(_) => {
                // A mainframe must be switched off to be opened.
                self.while_cut(Instrument::Mainframe, || self.instruments().fault(fault));
            }
            Fault::None => {
                for instrument in Instrument::ALL {
                    self.link_faults()[instrument.index()] = LinkFaults::default();
                    if self.shared.wires[instrument.index()].borrow().wire != Wire::Sound {
                        self.set_wire(instrument, Wire::Sound);
                    }
                }
                if self.instruments().has_part_removed() {
                    self.while_cut(Instrument::Mainframe, || {});
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
            Fault::Wire(instrument, _)
            | Fault::Drop(instrument)
            | Fault::Replies(instrument, ..)
            | Fault::Slow(instrument, _)
            | Fault::QueueOverflow(instrument)
            | Fault::Reset(instrument) => self.check_instrument(*instrument),
            Fault::Serial(_) => self.check_instrument(Instrument::Board),
            Fault::StuckOpen(relay) | Fault::StuckClosed(relay) => self.check_relay(*relay),
            Fault::Free(relay) => {
                self.check_relay(*relay)?;
                match self.instruments().sheet.is_stuck(*relay) {
                    true => Ok(()),
                    false => Err(FaultError::NotStuck(*relay)),
                }
            }
            Fault::Slot(slot, _) | Fault::Module(slot, _) | Fault::TerminalBlock(slot, _) => {
                match self.instruments().sheet.has_module(*slot) {
                    true => Ok(()),
                    false => Err(FaultError::NoModule(*slot)),
                }
            }
            _ => Ok(()),
        }
    }

    fn check_relay(&self, relay: Relay) -> Result<(), FaultError> {
        let on_board = self.has_board();
        match self.instruments().sheet.has_relay(relay, on_board) {
            true => Ok(()),
            false => Err(FaultError::NoRelay(relay)),
        }
    }

    fn check_instrument(&self, instrument: Instrument) -> Result<(), FaultError> {
        match self.shared.lacking[instrument.index()] {
            None => Ok(()),
            Some(lacking) => Err(FaultError::NotHere(lacking)),
        }
    }

    /// Applies the faults of the time line that are due.
    pub(crate) fn apply_due_faults(&self) {
        let due = self.instruments().take_due_faults();
        for fault in due {
            if let Err(refusal) = self.fault(&fault) {
                tracing::warn!("the fault '{fault}' of the time line is not possible: {refusal}");
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

    /// Takes the fault of an instrument's next reply; returns it with the reply, whose readings are altered by a
    /// fault of readings. `measured`: whether the numbers of the reply are readings, not settings.
    pub(crate) fn reply_fault(
        &self,
        instrument: Instrument,
        reply: String,
        measured: bool,
    ) -> (Option<ReplyFault>, String) {
        self.link_faults()[instrument.index()].take(reply, measured)
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
    /// The last reply with readings, before any fault.
    last_measured: String,
}

impl LinkFaults {
    /// As [`SimulatedRig::reply_fault`].
    fn take(&mut self, reply: String, measured: bool) -> (Option<ReplyFault>, String) {
        let measured = measured && readings(&reply).next().is_some();
        let next = self.next.front_mut();
        let next = next.filter(|(fault, _)| measured || !fault.is_of_readings());
        let taken = next.map(|(fault, left)| {
            *left -= 1;
            (*fault, *left == 0)
        });
        if taken.is_some_and(|(_, last)| last) {
            self.next.pop_front();
        }
        let fault = taken.map(|(fault, _)| fault);
        let changed = match fault {
            Some(ReplyFault::NotANumber) => Some(with_readings(&reply, |_| "NAN")),
            Some(ReplyFault::Stale) if !self.last_measured.is_empty() => {
                let last: Vec<&str> = readings(&self.last_measured).collect();
                Some(with_readings(&reply, |index| last[index % last.len()]))
            }
            _ => None,
        };
        if measured {
            self.last_measured.clone_from(&reply);
        }
        (fault, changed.unwrap_or(reply))
    }
}

/// The words of a reply that are readings: numbers with an exponent. A block has none, because its length would no
/// longer match.
fn readings(reply: &str) -> impl Iterator<Item = &str> {
    let words = (!reply.starts_with('#')).then(|| reply.split([',', ';', ' ']));
    words.into_iter().flatten().filter(|word| is_reading(word))
}

fn is_reading(word: &str) -> bool {
    word.contains(['E', 'e']) && word.parse::<f64>().is_ok_and(f64::is_finite)
}

/// The reply with other words in place of its readings, by their index.
fn with_readings<'a>(reply: &str, other: impl Fn(usize) -> &'a str) -> String {
    let mut index = 0;
    let mut out = String::with_capacity(reply.len());
    for part in reply.split_inclusive([',', ';', ' ']) {
        let word = part.trim_end_matches([',', ';', ' ']);
        if is_reading(word) {
            out.push_str(other(index));
            out.push_str(&part[word.len()..]);
            index += 1;
        } else {
            out.push_str(part);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_readings_of_a_reply_go_wrong() {
        let mut faults = LinkFaults::default();
        faults.next.push_back((ReplyFault::NotANumber, 1));
        faults.next.push_back((ReplyFault::Stale, 2));
        assert_eq!(
            faults.take("+1.0E+00".to_owned(), false),
            (None, "+1.0E+00".to_owned())
        );
        let mut take = |reply: &str| faults.take(reply.to_owned(), true);
        // no reading in it: the reply is unchanged, and the fault still applies to a later one
        assert_eq!(take("1"), (None, "1".to_owned()));
        assert_eq!(take("#17+1.0E-3"), (None, "#17+1.0E-3".to_owned()));
        let (fault, reply) = take("+1.5E-03 VDC,+2.5E-03 VDC;+0,\"No error\"");
        assert_eq!(fault, Some(ReplyFault::NotANumber));
        assert_eq!(reply, "NAN VDC,NAN VDC;+0,\"No error\"");
        let (fault, reply) = take("+3.5E-03,+4.5E-03,+5.5E-03;+0,\"No error\"");
        assert_eq!(fault, Some(ReplyFault::Stale));
        assert_eq!(reply, "+1.5E-03,+2.5E-03,+1.5E-03;+0,\"No error\"");
        assert_eq!(take("+9.5E-03").1, "+3.5E-03");
        assert_eq!(take("+8.5E-03"), (None, "+8.5E-03".to_owned()));
    }
}
