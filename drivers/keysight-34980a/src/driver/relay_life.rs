//! Data of a mainframe's relays: closure counts and bus relays.

use rig::{RigError, Stream};
use survey::Relay;

use super::Keysight34980a;
use super::unit::compact;
use crate::command::System;
use crate::modules::join;

impl<S: Stream> Keysight34980a<S> {
    /// Number of closures of each relay since its manufacture, or since the count was cleared (`DIAG:REL:CYCL?`). The
    /// count of a FET of a 34925A is always 0.
    ///
    /// # Errors
    /// A relay that does not exist, a broken connection, or a reply with another number of counts.
    pub async fn relay_cycles(&self, relays: &[Relay]) -> Result<Vec<u64>, RigError> {
        self.check_exist(relays)?;
        if relays.is_empty() {
            return Ok(Vec::new());
        }
        let mut unit = self.unit.lock().await;
        let deadline = unit.conversation.link().deadline();
        let query = System::RelayCycles(compact(relays)).into();
        let (message, answer) = unit.ask(vec![query], deadline).await?;
        let counts: Option<Vec<u64>> = unit
            .numbers(&message, &answer, relays.len())?
            .iter()
            .map(|count| {
                // 2^53: above it, a number written with an exponent is not an exact count
                let count = count.value().filter(|count| {
                    count.fract() == 0.0 && (0.0..=9_007_199_254_740_992.0).contains(count)
                })?;
                Some(count as u64)
            })
            .collect();
        counts.ok_or_else(|| {
            unit.conversation
                .garbled(&message, &answer, "whole numbers")
        })
    }

    /// The relays that connect the banks of scanned channels to the voltmeter's bus, each once. A scan closes them by
    /// itself; for a reading without a scan the caller closes them first.
    pub fn meter_relays(&self, scanned: &[Relay]) -> Vec<Relay> {
        let mut buses = Vec::new();
        for relay in scanned {
            let Ok((module, channel)) = self.module_of(*relay) else {
                continue;
            };
            let bank = module.contact(channel).and_then(|contact| contact.bank());
            let bus = bank.and_then(|bank| module.bus_relay(bank, 1));
            if let Some(bus) = bus.map(|bus| join(relay.0 / 1000, bus))
                && !buses.contains(&bus)
            {
                buses.push(bus);
            }
        }
        buses
    }
}
