//! When and how often the voltmeter measures: trigger source, timer, counts, delay (section 5). Changing one of these
//! settings clears the memory.

use scpi::{Numeric, format_nr3_signed};

use crate::command::{
    LONGEST_TIMER, LONGEST_TRIGGER_DELAY, MOST_SAMPLES, MOST_SWEEPS, TriggerSource,
};
use crate::simulator::measurement::meter::Meter;

impl Meter {
    pub(crate) fn threshold(&self) -> u32 {
        self.settings.threshold
    }

    pub(crate) fn set_threshold(&mut self, threshold: u32) {
        self.settings.threshold = threshold;
    }

    pub(crate) fn source(&self) -> TriggerSource {
        self.settings.source
    }

    pub(crate) fn set_source(&mut self, source: TriggerSource) {
        self.settings.source = source;
        self.memory.clear();
    }

    /// Reply with the timer, or its smallest, largest or default value.
    pub(crate) fn timer(&self, limit: Option<Numeric>) -> String {
        let value = match limit {
            None => self.settings.timer,
            Some(Numeric::Min) => 0.0,
            Some(Numeric::Max) => LONGEST_TIMER,
            Some(_) => 10.0,
        };
        format_nr3_signed(value, 8)
    }

    pub(crate) fn set_timer(&mut self, timer: f64) {
        self.settings.timer = timer;
        self.memory.clear();
    }

    /// Reply with the number of sweeps, or its smallest, largest or default value.
    pub(crate) fn sweeps(&self, limit: Option<Numeric>) -> String {
        let count = match limit {
            None => self.settings.count,
            Some(Numeric::Max) => Some(MOST_SWEEPS),
            Some(_) => Some(1),
        };
        match count {
            Some(count) => format!("{count:+}"),
            None => format_nr3_signed(f64::INFINITY, 8),
        }
    }

    pub(crate) fn set_count(&mut self, count: Option<u32>) {
        self.settings.count = count;
        self.memory.clear();
    }

    /// Reply with the number of samples, or its smallest, largest or default value.
    pub(crate) fn samples(&self, limit: Option<Numeric>) -> String {
        let count = match limit {
            None => self.settings.samples,
            Some(Numeric::Max) => MOST_SAMPLES,
            Some(_) => 1,
        };
        format!("{count:+}")
    }

    pub(crate) fn set_samples(&mut self, samples: u32) {
        self.settings.samples = samples;
        self.memory.clear();
    }

    /// Reply with the delay after a trigger, or its smallest, largest or default value.
    pub(crate) fn trigger_delay(&self, limit: Option<Numeric>) -> String {
        let delay = match limit {
            None => self.settings.trigger_delay.unwrap_or(0.0),
            Some(Numeric::Max) => LONGEST_TRIGGER_DELAY,
            Some(_) => 0.0,
        };
        format_nr3_signed(delay, 8)
    }

    pub(crate) fn trigger_delay_is_auto(&self) -> bool {
        self.settings.trigger_delay.is_none()
    }

    pub(crate) fn set_trigger_delay(&mut self, delay: Option<f64>) {
        self.settings.trigger_delay = delay;
        self.memory.clear();
    }

    /// Executes the part of CONF and MEAS? that sets one sample, and an automatic delay after a trigger.
    pub(super) fn reset_samples(&mut self) {
        (self.settings.samples, self.settings.trigger_delay) = (1, None);
    }
}
