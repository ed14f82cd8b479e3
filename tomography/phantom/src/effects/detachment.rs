//! An electrode comes off: its contact resistance rises to 1e6 ohm and more, at once or over weeks.
//!
//! On a logarithmic scale from its own value to the last, straight in time (fact sheet, section 2.3). A driven electrode
//! then runs into compliance; a sensed one floats.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::bounds::{Bounds, Fault};
use super::{Effect, Effects, OnContacts};

/// Which electrode comes off, and when.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DetachmentSettings {
    /// Electrode, from 1.
    pub electrode: usize,
    /// It begins at this moment, s.
    #[serde(default)]
    pub from_s: f64,
    /// It takes so long, s; 0 for at once.
    #[serde(default)]
    pub over_s: f64,
    /// Contact resistance in the end, as a multiple of what it was.
    #[serde(default = "times")]
    pub times: f64,
}

fn times() -> f64 {
    1e7
}

impl Effect for DetachmentSettings {
    fn check(&self) -> Result<(), Fault> {
        Bounds::new()
            .within("electrode", self.electrode as f64, [1.0, 256.0], "")
            .within("from_s", self.from_s, [0.0, 1e9], "s")
            .within("over_s", self.over_s, [0.0, 1e9], "s")
            .within("times", self.times, [1.0, 1e12], "")
            .end()
    }

    fn check_on(&self, electrodes: usize) -> Result<(), Fault> {
        Fault::beyond("electrode", self.electrode, electrodes)
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.contacts.push(Box::new(Detachment(self.clone())));
    }
}

#[derive(Debug)]
pub(super) struct Detachment(DetachmentSettings);

/// Steps that the way is computed in.
const STEPS: f64 = 200.0;

impl OnContacts for Detachment {
    fn act(&mut self, at: Duration, contacts: &mut [f64]) {
        let share = self.epoch(at) as f64 / STEPS;
        if let Some(contact) = self
            .0
            .electrode
            .checked_sub(1)
            .and_then(|index| contacts.get_mut(index))
        {
            *contact *= self.0.times.powf(share);
        }
    }

    fn epoch(&self, at: Duration) -> u64 {
        let gone = at.as_secs_f64() - self.0.from_s;
        match gone {
            ..0.0 => 0,
            _ if gone >= self.0.over_s => STEPS as u64,
            _ => (STEPS * gone / self.0.over_s) as u64,
        }
    }
}
