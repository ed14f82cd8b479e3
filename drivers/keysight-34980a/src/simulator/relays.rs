//! Which relays are closed, and which may be: fact sheet sections 2 to 4.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use scpi::{ChannelEntry, ChannelList};
use survey::Relay;

use super::trouble::Trouble;
use crate::modules::{Contact, Model, Module, Terminal, join, split};

#[derive(Debug)]
pub(super) struct Relays {
    slots: [Option<Module>; 8],
    closed: BTreeSet<Relay>,
    cycles: BTreeMap<Relay, u64>,
}

impl Relays {
    pub(super) fn new(slots: [Option<Module>; 8]) -> Self {
        Self {
            slots,
            closed: BTreeSet::new(),
            cycles: BTreeMap::new(),
        }
    }

    pub(super) fn closed(&self) -> &BTreeSet<Relay> {
        &self.closed
    }

    pub(super) fn cycles(&self, relay: Relay) -> u64 {
        self.cycles.get(&relay).copied().unwrap_or(0)
    }

    /// The module of a slot.
    pub(super) fn module(&self, slot: u32) -> Result<Module, Trouble> {
        let index = slot.checked_sub(1).ok_or(Trouble::SLOT)?;
        self.slots
            .get(index as usize)
            .copied()
            .flatten()
            .ok_or(Trouble::SLOT)
    }

    /// What a relay is, and of which module.
    pub(super) fn contact(&self, relay: Relay) -> Result<(Module, Contact), Trouble> {
        let (slot, channel) = split(relay).ok_or(Trouble::SLOT)?;
        let module = self.module(slot)?;
        let contact = module.contact(channel).ok_or(Trouble::CHANNEL)?;
        Ok((module, contact))
    }

    /// The relays of a list, in its order. A range is ascending, skips what does not exist and all ABus relays, and
    /// must have ends that exist and are none (section 2).
    pub(super) fn expand(&self, list: &ChannelList) -> Result<Vec<Relay>, Trouble> {
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
                            return Err(Trouble::CHANNEL);
                        }
                    }
                    // Both ends exist, so the range is shorter than 8,000.
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

    /// As [`Relays::expand`], where an empty list makes no sense.
    pub(super) fn expand_some(&self, list: &ChannelList) -> Result<Vec<Relay>, Trouble> {
        let relays = self.expand(list)?;
        if relays.is_empty() {
            return Err(Trouble::EMPTY);
        }
        Ok(relays)
    }

    /// Closes all or none, and says how long that takes.
    pub(super) fn close(&mut self, relays: &[Relay], scan: &[Relay]) -> Result<Duration, Trouble> {
        let mut after = self.closed.clone();
        after.extend(relays);
        self.check(relays, &after, scan)?;
        Ok(self.become_closed(after))
    }

    /// Opens everything else in the slots of the list, then closes it.
    pub(super) fn close_exclusive(
        &mut self,
        relays: &[Relay],
        scan: &[Relay],
    ) -> Result<Duration, Trouble> {
        let slots: BTreeSet<u32> = relays.iter().map(|relay| relay.0 / 1000).collect();
        let mut after: BTreeSet<Relay> = self
            .closed
            .iter()
            .filter(|relay| !slots.contains(&(relay.0 / 1000)))
            .copied()
            .collect();
        after.extend(relays);
        self.check(relays, &after, scan)?;
        let opened = self.open(|relay| !after.contains(&relay));
        Ok(opened + self.become_closed(after))
    }

    /// The scan rule of section 4, the interlock, and the coils of section 3.
    fn check(
        &self,
        relays: &[Relay],
        after: &BTreeSet<Relay>,
        scan: &[Relay],
    ) -> Result<(), Trouble> {
        if relays.is_empty() {
            return Err(Trouble::EMPTY);
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
                return Err(Trouble::COMMITTED);
            }
            if bus && module.terminal() == Terminal::None {
                return Err(Trouble::UNABLE);
            }
        }
        for slot in 1..=8 {
            let Ok(module) = self.module(slot) else {
                continue;
            };
            let channels = after
                .range(join(slot, 0)..join(slot + 1, 0))
                .map(|relay| relay.0 % 1000);
            module.check_closed(channels).map_err(|_| Trouble::UNABLE)?;
        }
        Ok(())
    }

    /// Slot and bank.
    fn bank(&self, relay: Relay) -> (u32, Option<u32>) {
        let bank = self
            .contact(relay)
            .ok()
            .and_then(|(_, contact)| contact.bank());
        (relay.0 / 1000, bank)
    }

    fn become_closed(&mut self, after: BTreeSet<Relay>) -> Duration {
        let mut took = Duration::ZERO;
        for relay in after.difference(&self.closed) {
            if let Ok((module, _)) = self.contact(*relay) {
                took = took.max(module.model().close_time());
                if module.model() != Model::M34925A {
                    *self.cycles.entry(*relay).or_default() += 1;
                }
            }
        }
        self.closed = after;
        took
    }

    /// Opens those of the closed relays that are meant, and says how long that takes.
    pub(super) fn open(&mut self, meant: impl Fn(Relay) -> bool) -> Duration {
        let slots = self.slots;
        let mut took = Duration::ZERO;
        self.closed.retain(|relay| {
            let stays = !meant(*relay);
            let slot = (relay.0 / 1000) as usize;
            if let (false, Some(module)) = (stays, slots.get(slot - 1).copied().flatten()) {
                took = took.max(module.model().open_time());
            }
            stays
        });
        took
    }

    pub(super) fn open_buses(&mut self, which: Option<u32>) -> Duration {
        let meant: BTreeSet<Relay> = self
            .closed
            .iter()
            .filter(|relay| match self.contact(**relay) {
                Ok((_, Contact::AnalogBus { bus, .. })) => which.is_none_or(|which| which == bus),
                _ => false,
            })
            .copied()
            .collect();
        self.open(|relay| meant.contains(&relay))
    }

    /// Opens what a scan must find open: every channel of the scanned banks, and every relay to bus 1 (section 4).
    pub(super) fn clear_for_scan(&mut self, scan: &[Relay]) {
        let banks: BTreeSet<(u32, Option<u32>)> =
            scan.iter().map(|relay| self.bank(*relay)).collect();
        let meant: BTreeSet<Relay> = self
            .closed
            .iter()
            .filter(|relay| match self.contact(**relay) {
                Ok((_, Contact::AnalogBus { bus, .. })) => bus == 1,
                _ => banks.contains(&self.bank(**relay)),
            })
            .copied()
            .collect();
        self.open(|relay| meant.contains(&relay));
    }

    /// Joins one channel to bus 1 for its reading. What is closed for it is to be opened by [`Relays::unjoin`].
    pub(super) fn join_to_bus(&mut self, channel: Relay) -> [Option<Relay>; 2] {
        let bus = self.contact(channel).ok().and_then(|(module, contact)| {
            let relay = module.bus_relay(contact.bank()?, 1)?;
            Some(join(channel.0 / 1000, relay))
        });
        let joined = [Some(channel), bus];
        let mut after = self.closed.clone();
        after.extend(joined.into_iter().flatten());
        self.become_closed(after);
        joined
    }

    pub(super) fn unjoin(&mut self, joined: [Option<Relay>; 2]) {
        for relay in joined.into_iter().flatten() {
            self.closed.remove(&relay);
        }
    }

    /// Reeds and ABus relays fall open, latching relays stay (section 3).
    pub(super) fn lose_power(&mut self) {
        let stay: BTreeSet<Relay> = self
            .closed
            .iter()
            .filter(|relay| match self.contact(**relay) {
                Ok((_, Contact::AnalogBus { .. })) | Err(_) => false,
                Ok((module, _)) => module.model().latching(),
            })
            .copied()
            .collect();
        self.closed = stay;
    }
}
