//! Thermal voltages of the relays: each channel has its own, which fluctuates slowly.
//!
//! Less than 3 uV on armature and FET modules, less than 50 uV on reed modules; Ornstein-Uhlenbeck with a time constant
//! of 5 to 30 minutes and 30 % of that figure as rms (fact sheet, section 2.2). Does not reverse with the current, so
//! current reversal removes it.

use std::collections::BTreeMap;

use survey::{Relay, Volts};

use super::bounds::parameters;
use super::wander::Wander;
use super::{Effect, Effects, OnReading, SheetResponse, stream};
use crate::scan::ReadingContext;

parameters! {
    /// Size of the thermal voltages.
    ThermalEmfSettings {
        /// Rms of a channel's voltage, uV.
        uv = 0.9, in [0.0, 200.0], "uV";
        /// Time constant, s.
        tau_s = 900.0, in [1.0, 1e6], "s";
    }
}

impl Effect for ThermalEmfSettings {
    fn predict(&self, _response: &dyn SheetResponse) -> f64 {
        self.uv * 1e-6
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(ThermalEmf {
            settings: self.clone(),
            seed,
            channels: BTreeMap::new(),
        }));
    }
}

#[derive(Debug)]
pub(super) struct ThermalEmf {
    settings: ThermalEmfSettings,
    seed: u64,
    /// The process of each channel to the voltmeter; the key `None` is its direct input.
    channels: BTreeMap<Option<Relay>, Wander>,
}

impl OnReading for ThermalEmf {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        let (seed, tau) = (self.seed, survey::duration(self.settings.tau_s));
        let channel = self.channels.entry(context.relay).or_insert_with(|| {
            // one random stream per channel, so that the numbers do not depend on the order of readings
            let name = format!("thermal-emf {:?}", context.relay.map(|relay| relay.0));
            Wander::new(tau, stream(seed, &name))
        });
        Volts(volts.0 + self.settings.uv * 1e-6 * channel.at(context.at))
    }
}
