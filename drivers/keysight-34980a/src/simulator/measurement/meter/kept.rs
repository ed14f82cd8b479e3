//! The voltmeter settings stored by `*SAV`.

use std::collections::BTreeMap;

use survey::Relay;

use crate::command::{Function, TriggerSource};
use crate::simulator::measurement::functions::FunctionSettings;
use crate::simulator::measurement::memory::ReadingFormat;
use crate::simulator::measurement::meter::Meter;
use crate::simulator::measurement::setup::Setup;
use crate::simulator::relays::Relays;

/// All settings of the voltmeter, its scan and its triggers; no readings.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    bare: Setup,
    channels: BTreeMap<Relay, Setup>,
    others: BTreeMap<(Option<Relay>, Function), FunctionSettings>,
    scan: Vec<Relay>,
    ordered: bool,
    source: TriggerSource,
    timer: f64,
    count: Option<u32>,
    samples: u32,
    trigger_delay: Option<f64>,
    format: ReadingFormat,
    threshold: u32,
}

impl Meter {
    pub(crate) fn settings(&self) -> Settings {
        Settings {
            bare: self.bare,
            channels: self.channels.clone(),
            others: self.others.clone(),
            scan: self.scan.clone(),
            ordered: self.ordered,
            source: self.source,
            timer: self.timer,
            count: self.count,
            samples: self.samples,
            trigger_delay: self.trigger_delay,
            format: self.format.clone(),
            threshold: self.threshold,
        }
    }

    /// Restores stored settings; channels of modules that are gone are left out. Clears the memory.
    pub(crate) fn take_settings(&mut self, kept: Settings, relays: &Relays) {
        let Settings {
            bare,
            channels,
            others,
            scan,
            ordered,
            source,
            timer,
            count,
            samples,
            trigger_delay,
            format,
            threshold,
        } = kept;
        let is_there = |relay: &Relay| relays.contact(*relay).is_ok();
        (self.bare, self.ordered, self.source) = (bare, ordered, source);
        (self.timer, self.count, self.threshold) = (timer, count, threshold);
        (self.samples, self.trigger_delay) = (samples, trigger_delay);
        self.format = format;
        self.channels = channels;
        self.channels.retain(|relay, _| is_there(relay));
        self.others = others;
        self.others
            .retain(|(relay, _), _| relay.as_ref().is_none_or(is_there));
        self.scan = scan;
        self.scan.retain(is_there);
        self.memory.clear();
    }
}
