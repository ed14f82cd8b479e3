//! An electrode detaches: its contact resistance rises to 1e6 ohm or more, at once or over weeks.
//!
//! The logarithm of the resistance rises linearly with time (fact sheet, section 2.3). A driven electrode then reaches
//! compliance; a sensed one floats.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::bounds::{Bounds, Fault, Parameters};
use super::{Effect, Effects, OnContacts, SheetResponse};

/// The electrode, and the time and size of the change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DetachmentSettings {
    /// Electrode, from 1.
    pub electrode: usize,
    /// Start of the change, s.
    #[serde(default)]
    pub from_s: f64,
    /// Duration of the change, s; 0 for a step.
    #[serde(default)]
    pub over_s: f64,
    /// Final contact resistance as a multiple of the original.
    #[serde(default = "times")]
    pub times: f64,
}

fn times() -> f64 {
    1e7
}

impl Default for DetachmentSettings {
    /// The first electrode, as a step.
    fn default() -> Self {
        Self {
            electrode: 1,
            from_s: 0.0,
            over_s: 0.0,
            times: times(),
        }
    }
}

impl DetachmentSettings {
    /// Progress of the change at a time, s: 0 to 1.
    fn share(&self, at: f64) -> f64 {
        let gone = at - self.from_s;
        match gone {
            ..0.0 => 0.0,
            _ if gone >= self.over_s => 1.0,
            _ => gone / self.over_s,
        }
    }

    /// Raises the contact impedance (ohm m) according to the progress.
    fn lift(&self, share: f64, contacts: &mut [f64]) {
        let index = self.electrode.checked_sub(1);
        if let Some(contact) = index.and_then(|index| contacts.get_mut(index)) {
            *contact *= self.times.powf(share);
        }
    }
}

impl Parameters for DetachmentSettings {
    fn check(&self) -> Result<(), Fault> {
        Bounds::new()
            .within("electrode", self.electrode as f64, [1.0, 256.0], "")
            .within("from_s", self.from_s, [0.0, 1e9], "s")
            .within("over_s", self.over_s, [0.0, 1e9], "s")
            .within("times", self.times, [1.0, 1e12], "")
            .end()
    }
}

impl Effect for DetachmentSettings {
    fn check_on(&self, electrodes: usize) -> Result<(), Fault> {
        Fault::beyond("electrode", self.electrode, electrodes)
    }

    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        let off = response.solved(&|_, _, contacts| self.lift(1.0, contacts));
        // The effect is proportional to the loss of the contact's conductance, not of its logarithm.
        off * response.over_time(&|at| 1.0 - self.times.powf(-self.share(at)))
    }

    fn assumes(&self) -> Option<String> {
        Some(format!(
            "electrode {} comes off at {} s",
            self.electrode, self.from_s
        ))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.contacts.push(Box::new(self.clone()));
    }
}

/// Number of steps in which the change is computed.
const STEPS: f64 = 200.0;

impl OnContacts for DetachmentSettings {
    fn act(&mut self, at: Duration, contacts: &mut [f64]) {
        self.lift(self.epoch(at) as f64 / STEPS, contacts);
    }

    fn epoch(&self, at: Duration) -> u64 {
        (STEPS * self.share(at.as_secs_f64())) as u64
    }
}
