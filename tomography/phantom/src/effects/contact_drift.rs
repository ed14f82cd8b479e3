//! Contact drift: ln R_c of each electrode follows its own Ornstein-Uhlenbeck process.
//!
//! 1 to 30 % per day (fact sheet, section 2.3). The drift approaches its rms within about one time constant.

use std::time::Duration;

use super::bounds::parameters;
use super::wander::Wander;
use super::{Effect, Effects, OnContacts, SheetResponse, stream};

parameters! {
    /// Size and speed of the drift.
    ContactDriftSettings {
        /// Rms of the contact resistance's change, %.
        percent = 10.0, in [0.0, 300.0], "%";
        /// Time constant, h.
        tau_h = 24.0, in [0.001, 10_000.0], "h";
        /// Interval at which the contacts are recomputed, s; changes in between are ignored.
        every_s = 60.0, in [0.001, 86_400.0], "s";
    }
}

impl Effect for ContactDriftSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.contacts() * self.percent / 100.0
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.contacts.push(Box::new(ContactDrift {
            settings: self.clone(),
            seed,
            contacts: Vec::new(),
        }));
    }
}

#[derive(Debug)]
pub(super) struct ContactDrift {
    settings: ContactDriftSettings,
    seed: u64,
    contacts: Vec<Wander>,
}

impl OnContacts for ContactDrift {
    fn act(&mut self, at: Duration, contacts: &mut [f64]) {
        let tau = survey::duration(self.settings.tau_h * 3600.0);
        let at = survey::duration(self.epoch(at) as f64 * self.settings.every_s);
        for electrode in self.contacts.len()..contacts.len() {
            let stream = stream(self.seed, &format!("contact-drift {electrode}"));
            self.contacts.push(Wander::new(tau, stream));
        }
        for (contact, wander) in contacts.iter_mut().zip(&mut self.contacts) {
            *contact *= (self.settings.percent / 100.0 * wander.at(at)).exp();
        }
    }

    fn epoch(&self, at: Duration) -> u64 {
        (at.as_secs_f64() / self.settings.every_s) as u64
    }
}
