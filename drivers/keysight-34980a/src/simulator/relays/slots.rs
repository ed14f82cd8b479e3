//! The slots of the mainframe: module, terminal block, settling time.

use std::time::Duration;

use survey::Relay;

use super::Relays;
use crate::command::Protection;
use crate::modules::{Model, Module};
use crate::simulator::errors::QueuedError;

/// One slot of the mainframe.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Slot {
    pub(super) module: Option<Module>,
    pub(super) protection: Protection,
    /// Whether the terminal block is open.
    pub(super) interlocked: bool,
    /// Time at which all relays moved so far have settled.
    pub(super) settled: Duration,
}

/// Time that the moving relays of each slot need.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct MoveTimes([Duration; 8]);

impl MoveTimes {
    /// Time until the relays of all slots have settled.
    pub(crate) fn longest(&self) -> Duration {
        self.0.into_iter().max().unwrap_or_default()
    }

    pub(crate) fn at_least(&mut self, relay: Relay, time: Duration) {
        if let Some(slot) = self.0.get_mut((relay.0 / 1000) as usize - 1) {
            *slot = time.max(*slot);
        }
    }

    pub(crate) fn then(mut self, after: Self) -> Self {
        for (slot, more) in self.0.iter_mut().zip(after.0) {
            *slot += more;
        }
        self
    }
}

impl Relays {
    /// Replaces or removes the module of a slot. The relays of the slot are then open.
    pub(crate) fn replace(&mut self, slot: u32, module: Option<Module>) {
        if let Some(place) = self.place_mut(slot) {
            *place = Slot {
                module,
                ..Slot::default()
            };
            self.closed.retain(|relay| relay.0 / 1000 != slot);
        }
    }

    /// Opens or closes a terminal block. An open one opens the relays to the buses (section 3).
    pub(crate) fn interlock(&mut self, slot: u32, open: bool) {
        if let Some(place) = self.place_mut(slot) {
            place.interlocked = open;
        }
        if open {
            self.open(|relays, relay| relay.0 / 1000 == slot && relays.is_bus(relay));
        }
    }

    fn place_mut(&mut self, slot: u32) -> Option<&mut Slot> {
        self.slots.get_mut((slot as usize).checked_sub(1)?)
    }

    /// The slot, if it holds a 34934A; other modules have no row protection.
    fn protected(&mut self, slot: u32) -> Result<&mut Slot, QueuedError> {
        if self.module(slot)?.model() != Model::M34934A {
            return Err(QueuedError::UNABLE);
        }
        self.place_mut(slot).ok_or(QueuedError::SLOT)
    }

    pub(crate) fn protection(&self, slot: u32) -> Result<Protection, QueuedError> {
        if self.module(slot)?.model() != Model::M34934A {
            return Err(QueuedError::UNABLE);
        }
        let place = self.slots.get(slot as usize - 1);
        Ok(place.map_or(Protection::default(), |place| place.protection))
    }

    pub(crate) fn protect(&mut self, slot: u32, protection: Protection) -> Result<(), QueuedError> {
        self.protected(slot)?.protection = protection;
        Ok(())
    }

    /// Sets the row protection of all slots to its state after `*RST`.
    pub(crate) fn reset_protection(&mut self) {
        for slot in &mut self.slots {
            slot.protection = Protection::default();
        }
    }

    /// The name of a slot's terminal block.
    pub(crate) fn terminal_type(&self, slot: u32) -> Result<String, QueuedError> {
        let module = self.module(slot)?;
        Ok(if self.slots[slot as usize - 1].interlocked {
            "NONE".to_owned()
        } else {
            module.terminal_type()
        })
    }

    /// Starts the settling time of these moves, and returns when all relays will have settled.
    pub(crate) fn settle(&mut self, moves: MoveTimes, now: Duration) -> Duration {
        let mut until = now;
        for (slot, time) in self.slots.iter_mut().zip(moves.0) {
            if !time.is_zero() {
                slot.settled = slot.settled.max(now) + time;
                until = until.max(slot.settled);
            }
        }
        until
    }

    /// Time at which the relays of one slot, or of all slots, have settled.
    pub(crate) fn settled_at(&self, slot: Option<u32>) -> Duration {
        let of = |slot: u32| self.slots.get(slot as usize - 1);
        match slot {
            Some(slot) => of(slot).map_or(Duration::ZERO, |place| place.settled),
            None => {
                let settled = self.slots.iter().map(|place| place.settled);
                settled.max().unwrap_or_default()
            }
        }
    }
}
