//! When and how often the voltmeter measures: trigger source, timer, counts, delay (section 5). Changing one of these
//! settings clears the memory.

use scpi::{Numeric, format_nr3_signed};

use crate::command::{LONGEST_TIMER, LONGEST_TRIGGER_DELAY, MOST_SAMPLES, MOST_SWEEPS};
use crate::simulator::measurement::meter::Meter;
use crate::simulator::measurement::meter::settings::Settings;
use crate::simulator::measurement::setup::at;

impl Meter {
    /// The settings, to change one of the triggers.
    pub(crate) fn triggers_mut(&mut self) -> &mut Settings {
        self.memory.clear();
        &mut self.settings
    }

    /// Reply with the timer, or its smallest, largest or default value.
    pub(crate) fn timer(&self, limit: Option<Numeric>) -> String {
        let timer = self.settings.timer;
        format_nr3_signed(at(limit, timer, [0.0, LONGEST_TIMER, 10.0]), 8)
    }

    /// Reply with the number of sweeps, or its smallest, largest or default value.
    pub(crate) fn sweeps(&self, limit: Option<Numeric>) -> String {
        let limits = [1, MOST_SWEEPS, 1].map(Some);
        match at(limit, self.settings.count, limits) {
            Some(count) => format!("{count:+}"),
            None => format_nr3_signed(f64::INFINITY, 8),
        }
    }

    /// Reply with the number of samples, or its smallest, largest or default value.
    pub(crate) fn samples(&self, limit: Option<Numeric>) -> String {
        let samples = self.settings.samples;
        format!("{:+}", at(limit, samples, [1, MOST_SAMPLES, 1]))
    }

    /// Reply with the delay after a trigger, or its smallest, largest or default value.
    pub(crate) fn trigger_delay(&self, limit: Option<Numeric>) -> String {
        let delay = self.settings.trigger_delay.unwrap_or(0.0);
        format_nr3_signed(at(limit, delay, [0.0, LONGEST_TRIGGER_DELAY, 0.0]), 8)
    }

    /// Executes the part of CONF and MEAS? that sets one sample, and an automatic delay after a trigger.
    pub(super) fn reset_samples(&mut self) {
        (self.settings.samples, self.settings.trigger_delay) = (1, None);
    }
}
