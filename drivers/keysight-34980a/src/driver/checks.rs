//! Checks of wirings, relays and ranges against the modules and the voltmeter, before anything is sent.

use std::collections::{BTreeMap, BTreeSet};

use rig::{RigError, Stream};
use survey::{Relay, Volts, Wiring};

use super::Keysight34980a;
use crate::meter::RANGES;
use crate::modules::{Module, split};

impl<S: Stream> Keysight34980a<S> {
    /// Checks that every relay of a wiring exists, and can be scanned if it must be.
    ///
    /// # Errors
    /// The first unsuitable relay, with slot, module found, channel and electrodes: [`RigError::WrongModule`] for a
    /// slot without a known module, or whose module lacks the channel; [`RigError::Unable`] for a channel that cannot
    /// be scanned.
    pub fn check_wiring(&self, wiring: &Wiring) -> Result<(), RigError> {
        let measuring = wiring.measuring_relays();
        let moved = wiring.injecting_relays().into_iter();
        for relay in moved
            .chain(wiring.bus.iter().copied())
            .chain(measuring.iter().copied())
        {
            self.check_part(relay, &wiring.purpose(relay))?;
        }
        match wiring.sensing {
            survey::Sensing::Scan => self.check_scan(&measuring),
            survey::Sensing::Single | survey::Sensing::Chain => Ok(()),
        }
    }

    /// Checks that the slots hold the modules for which a wiring was planned, because times, limits and noise depend on
    /// them.
    ///
    /// # Errors
    /// [`RigError::WrongModule`] for the first slot with another module, or none.
    pub fn check_modules(&self, planned: &BTreeMap<u32, Module>) -> Result<(), RigError> {
        for (slot, module) in planned {
            let index = (*slot as usize).wrapping_sub(1);
            let found = self.identification.modules.get(index).copied().flatten();
            if found != Some(*module) {
                return Err(self.wrong_module(*slot, format!("a {module}")));
            }
        }
        Ok(())
    }

    fn wrong_module(&self, slot: u32, expected: String) -> RigError {
        let index = (slot as usize).wrapping_sub(1);
        let card = self.identification.cards.get(index).cloned().flatten();
        RigError::WrongModule {
            instrument: self.identification.instrument.clone(),
            slot,
            found: card.map_or_else(|| "no module".to_owned(), |card| format!("a {card}")),
            expected,
        }
    }

    fn check_part(&self, relay: Relay, purpose: &str) -> Result<(), RigError> {
        let Some((slot, channel)) = split(relay) else {
            return Err(self.unable(format!(
                "reach relay {relay}, which {purpose}: numbers are slot x 1000 + channel, slots 1 to 8"
            )));
        };
        // `split` yields slots 1 to 8.
        let module = self.identification.modules[slot as usize - 1];
        match module.is_some_and(|module| module.contact(channel).is_some()) {
            true => Ok(()),
            false => Err(self.wrong_module(
                slot,
                format!("a module with channel {channel}: relay {relay} {purpose}"),
            )),
        }
    }

    pub(super) fn module_of(&self, relay: Relay) -> Result<(Module, u32), RigError> {
        let Some((slot, channel)) = split(relay) else {
            return Err(self.unable(format!(
                "reach relay {relay}: numbers are slot x 1000 + channel, slots 1 to 8"
            )));
        };
        // `split` yields slots 1 to 8.
        let module = self.identification.modules[slot as usize - 1]
            .ok_or_else(|| self.wrong_module(slot, format!("a module with channel {channel}")))?;
        if module.contact(channel).is_none() {
            return Err(self.unable(format!(
                "reach relay {relay}: the {module} in slot {slot} has no channel {channel}"
            )));
        }
        Ok((module, channel))
    }

    pub(super) fn check_exist(&self, relays: &[Relay]) -> Result<(), RigError> {
        relays
            .iter()
            .try_for_each(|relay| self.module_of(*relay).map(drop))
    }

    pub(super) fn check_scan(&self, relays: &[Relay]) -> Result<(), RigError> {
        let mut seen = BTreeSet::new();
        for relay in relays {
            let (module, channel) = self.module_of(*relay)?;
            if !module.scannable(channel) {
                return Err(self.unable(format!(
                    "scan relay {relay}: channel {channel} of a {module} cannot be scanned"
                )));
            }
            if !seen.insert(relay) {
                return Err(self.unable(format!("scan relay {relay} twice in one list")));
            }
        }
        Ok(())
    }

    pub(super) fn check_range(&self, range: Volts) -> Result<(), RigError> {
        if RANGES.contains(&range.0) {
            return Ok(());
        }
        Err(RigError::VoltageOutOfRange {
            instrument: self.identification.instrument.clone(),
            requested: range,
            allowed: "0.1, 1, 10, 100 and 300 V".to_owned(),
        })
    }

    pub(super) fn unable(&self, what: String) -> RigError {
        RigError::Unable {
            instrument: self.identification.instrument.clone(),
            what,
        }
    }
}
