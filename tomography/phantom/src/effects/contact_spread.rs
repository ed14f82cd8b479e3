//! Contact resistances differ: R_c exp(s n), n normal, a constant for each electrode.
//!
//! s = 0.2 to 0.7 about 10 ohm to 10 kohm (fact sheet, section 2.3). 1 % of 100 ohm changes readings by 3e-6 rms. Leave
//! it out if no electrode both injects and measures at a time, as in the adjacent pattern.

use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::bounds::parameters;
use super::{Effect, Effects, OnContacts, SheetResponse, stream};

parameters! {
    /// Size of the differences.
    ContactSpreadSettings {
        /// Standard deviation of ln(contact resistance).
        std = 0.4, in [0.0, 3.0];
    }
}

impl Effect for ContactSpreadSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.contacts() * self.std
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.contacts.push(Box::new(ContactSpread {
            std: self.std,
            stream: stream(seed, "contact-spread"),
            drawn: Vec::new(),
        }));
    }
}

#[derive(Debug)]
pub(super) struct ContactSpread {
    std: f64,
    stream: ChaCha8Rng,
    drawn: Vec<f64>,
}

impl OnContacts for ContactSpread {
    fn act(&mut self, _at: Duration, contacts: &mut [f64]) {
        while self.drawn.len() < contacts.len() {
            self.drawn.push(StandardNormal.sample(&mut self.stream));
        }
        for (contact, draw) in contacts.iter_mut().zip(&self.drawn) {
            *contact *= (self.std * draw).exp();
        }
    }

    fn epoch(&self, _at: Duration) -> u64 {
        0
    }
}
