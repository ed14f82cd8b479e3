//! Channel resistance: each pole of a relay adds about an ohm, and a dirty one up to 50.
//!
//! Each relay has its own constant resistance, ohm exp(s n). Some also have a film on the contact, which currents below
//! 10 mA do not break. Below 1.5 ohm for armature and reed relays; dirt up to 50 ohm below 10 mA or after a week idle
//! (fact sheet, section 2.2). The resistance counts towards compliance, and changes readings by the current that the
//! voltmeter draws (`input-resistance`, `bias-current`). It is added to the resistance in the modules' data sheets.

use std::time::Duration;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use survey::Relay;

use super::bounds::parameters;
use super::{Effect, Effects, OnWires, RelayContact, SheetResponse, stream};

parameters! {
    /// Resistances added to relays.
    ChannelResistanceSettings {
        /// Median resistance of a pole above its data sheet's, ohm.
        ohm = 0.5, in [0.0, 1000.0], "ohm";
        /// Standard deviation of its logarithm.
        std = 0.3, in [0.0, 3.0];
        /// Share of the relays that are dirty, %.
        dirty_percent = 10.0, in [0.0, 100.0], "%";
        /// Resistance added by dirt to each pole, ohm.
        dirty_ohm = 50.0, in [0.0, 1e6], "ohm";
    }
}

impl Effect for ChannelResistanceSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        // two poles of a channel and two of the relay to the bus form a divider with the voltmeter's input
        let mean = self.ohm * (0.5 * self.std * self.std).exp();
        let each = mean + self.dirty_percent / 100.0 * self.dirty_ohm;
        let share = 4.0 * each / response.input_ohm();
        response.rms(&|sight| sight.exact * share)
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.wires.push(Box::new(ChannelResistance {
            settings: self.clone(),
            seed,
        }));
    }
}

#[derive(Debug)]
struct ChannelResistance {
    settings: ChannelResistanceSettings,
    seed: u64,
}

impl OnWires for ChannelResistance {
    fn act(&mut self, relay: Relay, _closures: u64, _at: Duration, contact: &mut RelayContact) {
        let settings = &self.settings;
        // one random stream per relay, so that the numbers do not depend on the order of closures
        let mut stream = stream(self.seed, &format!("channel-resistance {}", relay.0));
        let draw: f64 = StandardNormal.sample(&mut stream);
        let dirty: f64 = stream.random();
        contact.ohms.0 += settings.ohm * (settings.std * draw).exp();
        if dirty < settings.dirty_percent / 100.0 {
            contact.ohms.0 += settings.dirty_ohm;
        }
    }
}
