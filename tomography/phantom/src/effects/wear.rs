//! Wear: a relay sticks, open or closed, at the end of its life.
//!
//! The life of each relay is drawn from a Weibull distribution: life (-ln u)^(1/k) closures with the shape k; for k > 1
//! the hazard rises with use. Whether it sticks open or closed is drawn too. 1e7 to 1e8 closures at light load (fact
//! sheet, section 2.2). The caller counts the closures. Leave it out below 1e6 closures.

use std::time::Duration;

use rand::RngExt;
use survey::Relay;

use super::bounds::parameters;
use super::{Effect, Effects, OnWires, RelayContact, SheetResponse, stream};

parameters! {
    /// Life of the relays.
    WearSettings {
        /// Number of closures that 63 % of the relays do not reach.
        life_closures = 3e7, in [1.0, 1e12], "closures";
        /// Shape of the Weibull distribution: 1 for failures independent of age, more for wear.
        shape = 2.0, in [0.2, 20.0];
        /// Number of closures of every relay before the start.
        behind_closures = 0.0, in [0.0, 1e12], "closures";
        /// Share of the relays that stick closed, %; the others stick open.
        closed_percent = 30.0, in [0.0, 100.0], "%";
    }
}

impl Effect for WearSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        // a worn channel gives no reading; each relay of the sheet closes about once per reading of its pair
        let scan = response.scan();
        let closures = (scan.frames * scan.protocol.len()) as f64;
        let each = closures / scan.protocol.drives().len().max(1) as f64;
        let used = (self.behind_closures + 0.5 * each) / self.life_closures;
        let worn = -(-used.powf(self.shape)).exp_m1();
        response.rms(&|sight| sight.exact) * (worn * (1.0 - self.closed_percent / 100.0)).sqrt()
    }

    fn assumes(&self) -> Option<String> {
        let behind = self.behind_closures;
        Some(format!("every relay has closed {behind} times before"))
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.wires.push(Box::new(Wear {
            settings: self.clone(),
            seed,
        }));
    }
}

#[derive(Debug)]
struct Wear {
    settings: WearSettings,
    seed: u64,
}

impl OnWires for Wear {
    fn act(&mut self, relay: Relay, closures: u64, _at: Duration, contact: &mut RelayContact) {
        // one random stream per relay, so that its life does not depend on the order of closures
        let mut stream = stream(self.seed, &format!("wear {}", relay.0));
        let [life, way]: [f64; 2] = [(); 2].map(|()| stream.random());
        // 1 - life is in (0, 1], so its logarithm is finite
        let life =
            self.settings.life_closures * (-(1.0 - life).ln()).powf(1.0 / self.settings.shape);
        if self.settings.behind_closures + closures as f64 > life {
            contact.stuck = Some(way < self.settings.closed_percent / 100.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lives_are_weibulls_and_so_many_stick_closed() {
        let settings = WearSettings::default();
        let mut effects = Effects::default();
        settings.add(3, &mut effects);
        let mut failed = |closures: u64| {
            let contacts = (0..4000).map(|relay| {
                let mut contact = RelayContact::default();
                effects.wires[0].act(Relay(relay), closures, Duration::ZERO, &mut contact);
                contact.stuck
            });
            let stuck: Vec<bool> = contacts.flatten().collect();
            let closed = stuck.iter().filter(|closed| **closed).count();
            [stuck.len(), closed].map(|count| count as f64 / 4000.0)
        };
        assert_eq!(failed(0), [0.0, 0.0]);
        for part in [0.5, 1.0, 2.0] {
            let [all, closed] = failed((part * settings.life_closures) as u64);
            // 1 - exp(-(n / life)^2), known to 0.008 from 4000 relays
            let wanted = 1.0 - (-part * part).exp();
            assert!((all - wanted).abs() < 0.03, "{all} {wanted}");
            assert!((closed / all - 0.3).abs() < 0.05, "{closed} of {all}");
        }
    }
}
