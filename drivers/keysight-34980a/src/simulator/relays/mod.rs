//! The closed relays, and the rules for closing relays: fact sheet sections 2 to 4.

mod slots;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use scpi::{ChannelEntry, ChannelList};
use survey::Relay;

use super::Wires;
use crate::modules::{Contact, Model, Module, Terminal, join, split};
use crate::simulator::errors::QueuedError;
pub(crate) use slots::MoveTimes;
use slots::Slot;

/// The relays closed for one reading: the channel, its relay to bus 1, the sensing channel, its relay to bus 2.
pub(crate) type ScanRelays = [Option<Relay>; 4];

#[derive(Debug)]
pub(crate) struct Relays {
    slots: [Slot; 8],
    closed: BTreeSet<Relay>,
    cycles: BTreeMap<Relay, u64>,
}

impl Relays {
    pub(crate) fn new(modules: [Option<Module>; 8]) -> Self {
        Self {
            slots: modules.map(|module| Slot {
                module,
                ..Slot::default()
            }),
            closed: BTreeSet::new(),
            cycles: BTreeMap::new(),
        }
    }

    /// Passes the closed relays to the wires.
    pub(crate) fn tell(&self, at: Duration, wires: &mut dyn Wires) {
        wires.relays(&self.closed, at);
    }

    pub(crate) fn closed(&self) -> &BTreeSet<Relay> {
        &self.closed
    }

    /// Counts the closures of the relays of skipped readings.
    pub(crate) fn count_skipped(&mut self, relays: ScanRelays, times: u32) {
        for relay in relays.into_iter().flatten() {
            self.count(relay, u64::from(times));
        }
    }

    fn count(&mut self, relay: Relay, closures: u64) {
        let counts = |(module, _): (Module, Contact)| module.model() != Model::M34925A;
        if self.contact(relay).is_ok_and(counts) {
            *self.cycles.entry(relay).or_default() += closures;
        }
    }

    /// The relay that connects a channel to bus 1.
    fn bus_relay(&self, channel: Relay) -> Option<Relay> {
        self.bus_relay_to(channel, 1)
    }

    fn bus_relay_to(&self, channel: Relay, bus: u32) -> Option<Relay> {
        let (module, contact) = self.contact(channel).ok()?;
        let relay = module.bus_relay(contact.bank()?, bus)?;
        Some(join(channel.0 / 1000, relay))
    }

    pub(crate) fn clear_cycles(&mut self, relays: &[Relay]) {
        for relay in relays {
            self.cycles.remove(relay);
        }
    }

    pub(crate) fn cycles(&self, relay: Relay) -> u64 {
        self.cycles.get(&relay).copied().unwrap_or(0)
    }

    /// The module of a slot.
    pub(crate) fn module(&self, slot: u32) -> Result<Module, QueuedError> {
        let index = slot.checked_sub(1).ok_or(QueuedError::SLOT)?;
        let place = self.slots.get(index as usize);
        place
            .and_then(|place| place.module)
            .ok_or(QueuedError::SLOT)
    }

    /// The switch behind a relay number, and its module.
    pub(crate) fn contact(&self, relay: Relay) -> Result<(Module, Contact), QueuedError> {
        let (slot, channel) = split(relay).ok_or(QueuedError::SLOT)?;
        let module = self.module(slot)?;
        let contact = module.contact(channel).ok_or(QueuedError::CHANNEL)?;
        Ok((module, contact))
    }

    /// The relays of a list, in its order. A range is ascending and skips channels that do not exist and all ABus
    /// relays; its ends must exist and must not be ABus relays (section 2).
    pub(crate) fn expand(&self, list: &ChannelList) -> Result<Vec<Relay>, QueuedError> {
        let mut relays = Vec::new();
        for entry in list.entries() {
            match *entry {
                ChannelEntry::One(number) => {
                    self.contact(Relay(number))?;
                    relays.push(Relay(number));
                }
                ChannelEntry::Range(first, last) => {
                    for end in [first, last] {
                        if let (_, Contact::AnalogBus { .. }) = self.contact(Relay(end))? {
                            return Err(QueuedError::CHANNEL);
                        }
                    }
                    // both ends exist, so that the range has fewer than 8,000 numbers
                    relays.extend(
                        (first.min(last)..=first.max(last))
                            .map(Relay)
                            .filter(|relay| {
                                self.contact(*relay).is_ok_and(|(_, contact)| {
                                    !matches!(contact, Contact::AnalogBus { .. })
                                })
                            }),
                    );
                }
            }
        }
        Ok(relays)
    }

    /// As [`Relays::expand`], for commands that need a non-empty list.
    pub(crate) fn expand_some(&self, list: &ChannelList) -> Result<Vec<Relay>, QueuedError> {
        let relays = self.expand(list)?;
        if relays.is_empty() {
            return Err(QueuedError::EMPTY);
        }
        Ok(relays)
    }

    /// Closes all of the relays or none, and returns the time for it.
    pub(crate) fn close(
        &mut self,
        relays: &[Relay],
        scan: &[Relay],
    ) -> Result<MoveTimes, QueuedError> {
        let mut after = self.closed.clone();
        after.extend(relays);
        self.check(relays, &after, scan)?;
        Ok(self.become_closed(after))
    }

    /// Opens all other relays in the slots of the list, then closes those of the list.
    pub(crate) fn close_exclusive(
        &mut self,
        relays: &[Relay],
        scan: &[Relay],
    ) -> Result<MoveTimes, QueuedError> {
        let slots: BTreeSet<u32> = relays.iter().map(|relay| relay.0 / 1000).collect();
        let mut after: BTreeSet<Relay> = self
            .closed
            .iter()
            .filter(|relay| !slots.contains(&(relay.0 / 1000)))
            .copied()
            .collect();
        after.extend(relays);
        self.check(relays, &after, scan)?;
        let opened = self.open(|_, relay| !after.contains(&relay));
        Ok(opened.then(self.become_closed(after)))
    }

    /// Checks that relays may be closed: the scan rule of section 4, the interlock, and the number of coils of
    /// section 3. `after` holds all closed relays afterwards.
    fn check(
        &self,
        relays: &[Relay],
        after: &BTreeSet<Relay>,
        scan: &[Relay],
    ) -> Result<(), QueuedError> {
        if relays.is_empty() {
            return Err(QueuedError::EMPTY);
        }
        let committed: BTreeSet<(u32, Option<u32>)> =
            scan.iter().map(|relay| self.bank(*relay)).collect();
        for relay in relays {
            let (module, contact) = self.contact(*relay)?;
            let place = self.bank(*relay);
            let bus = matches!(contact, Contact::AnalogBus { .. });
            if committed.contains(&place)
                || (bus && committed.iter().any(|(slot, _)| *slot == place.0))
            {
                return Err(QueuedError::COMMITTED);
            }
            // `contact` has checked the slot
            let interlocked = self.slots[relay.0 as usize / 1000 - 1].interlocked;
            let matrix = module.model() == Model::M34934A;
            if (bus || matrix) && (interlocked || module.terminal() == Terminal::None) {
                return Err(QueuedError::UNABLE);
            }
        }
        for slot in 1..=8 {
            let Ok(module) = self.module(slot) else {
                continue;
            };
            let channels = after
                .range(join(slot, 0)..join(slot + 1, 0))
                .map(|relay| relay.0 % 1000);
            module
                .check_closed(channels)
                .map_err(|_| QueuedError::UNABLE)?;
        }
        Ok(())
    }

    fn is_bus(&self, relay: Relay) -> bool {
        matches!(self.contact(relay), Ok((_, Contact::AnalogBus { .. })))
    }

    /// The relays of a list of high-side channels with their low-side partners.
    pub(crate) fn expand_pairs(&self, list: &ChannelList) -> Result<Vec<[Relay; 2]>, QueuedError> {
        self.expand_some(list)?
            .into_iter()
            .map(|high| {
                let (module, _) = self.contact(high)?;
                let low = module
                    .pair(high.0 % 1000)
                    .ok_or(QueuedError::CHANNEL_UNABLE)?;
                Ok([high, join(high.0 / 1000, low)])
            })
            .collect()
    }

    /// Slot and bank of a relay.
    fn bank(&self, relay: Relay) -> (u32, Option<u32>) {
        let bank = self
            .contact(relay)
            .ok()
            .and_then(|(_, contact)| contact.bank());
        (relay.0 / 1000, bank)
    }

    fn become_closed(&mut self, after: BTreeSet<Relay>) -> MoveTimes {
        let mut moves = MoveTimes::default();
        let closing: Vec<Relay> = after.difference(&self.closed).copied().collect();
        for relay in closing {
            if let Ok((module, _)) = self.contact(relay) {
                moves.at_least(relay, module.model().close_time());
                self.count(relay, 1);
            }
        }
        self.closed = after;
        moves
    }

    /// Opens the closed relays that `meant` selects, and returns the time for it.
    pub(crate) fn open(&mut self, meant: impl Fn(&Self, Relay) -> bool) -> MoveTimes {
        let mut moves = MoveTimes::default();
        let closed = self.closed.iter().copied();
        let opened: Vec<Relay> = closed.filter(|relay| meant(self, *relay)).collect();
        for relay in opened {
            self.closed.remove(&relay);
            if let Ok((module, _)) = self.contact(relay) {
                moves.at_least(relay, module.model().open_time());
            }
        }
        moves
    }

    pub(crate) fn open_buses(&mut self, which: Option<u32>) -> MoveTimes {
        self.open(|relays, relay| match relays.contact(relay) {
            Ok((_, Contact::AnalogBus { bus, .. })) => which.is_none_or(|which| which == bus),
            _ => false,
        })
    }

    /// Opens the relays that must be open for a scan: every channel of the scanned banks, and every relay to bus 1
    /// (section 4).
    pub(crate) fn clear_for_scan(&mut self, scan: &[Relay]) {
        let banks: BTreeSet<(u32, Option<u32>)> =
            scan.iter().map(|relay| self.bank(*relay)).collect();
        self.open(|relays, relay| match relays.contact(relay) {
            Ok((_, Contact::AnalogBus { bus, .. })) => bus == 1,
            _ => banks.contains(&relays.bank(relay)),
        });
    }

    /// The relays of a reading: they connect its channel to bus 1, and for a four-wire reading its partner in the other
    /// bank to bus 2.
    pub(crate) fn of_reading(&self, channel: Relay, four_wire: bool) -> ScanRelays {
        // the search for the partner takes longer than the rest of a reading
        let partner = four_wire.then(|| self.partner(channel)).flatten();
        let sense = partner.and_then(|partner| self.bus_relay_to(partner, 2));
        // the relays to the buses stay open while the terminal block is open
        let closes = |bus: &Relay| !self.slots[bus.0 as usize / 1000 - 1].interlocked;
        let bus = self.bus_relay(channel).filter(closes);
        [Some(channel), bus, partner, sense.filter(closes)]
    }

    /// Closes the relays of a reading, and returns them. [`Relays::unjoin`] opens them.
    pub(crate) fn join_to_bus(&mut self, channel: Relay, four_wire: bool) -> ScanRelays {
        let joined = self.of_reading(channel, four_wire);
        let mut after = self.closed.clone();
        after.extend(joined.into_iter().flatten());
        self.become_closed(after);
        joined
    }

    pub(crate) fn unjoin(&mut self, joined: ScanRelays) {
        for relay in joined.into_iter().flatten() {
            self.closed.remove(&relay);
        }
    }

    /// The channel of bank 2 that senses for a driven channel of bank 1: n + 20, or n + 35 on the larger modules.
    pub(crate) fn partner(&self, channel: Relay) -> Option<Relay> {
        let (module, contact) = self.contact(channel).ok()?;
        if contact != (Contact::Channel { bank: 1 }) {
            return None;
        }
        let last = module
            .channels()
            .filter(|number| module.contact(*number) == Some(contact))
            .last()?;
        let partner = Relay(channel.0 + last);
        let (_, sense) = self.contact(partner).ok()?;
        (sense == Contact::Channel { bank: 2 }).then_some(partner)
    }

    /// At power off latching relays keep their state, and all other relays (ABus relays included) open (section 3).
    pub(crate) fn lose_power(&mut self) {
        self.open(|relays, relay| match relays.contact(relay) {
            Ok((_, Contact::AnalogBus { .. })) | Err(_) => true,
            Ok((module, _)) => !module.model().latching(),
        });
        self.reset_protection();
        for slot in &mut self.slots {
            slot.settled = Duration::ZERO;
        }
    }
}
