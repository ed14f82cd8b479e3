//! The settings of the voltmeter, which `*SAV` stores.

use std::collections::BTreeMap;

use survey::Relay;

use crate::command::{Function, TriggerSource};
use crate::simulator::measurement::computation::{Limits, Scale};
use crate::simulator::measurement::functions::FunctionSettings;
use crate::simulator::measurement::memory::ReadingFormat;
use crate::simulator::measurement::meter::Meter;
use crate::simulator::measurement::setup::Setup;
use crate::simulator::relays::Relays;

/// All settings of the voltmeter, its scan and its triggers; no readings.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    pub(super) bare: Setup,
    pub(super) channels: BTreeMap<Relay, Setup>,
    /// Settings of functions other than DC volts, where they have been set.
    pub(super) others: BTreeMap<(Option<Relay>, Function), FunctionSettings>,
    pub(super) scan: Vec<Relay>,
    pub(super) ordered: bool,
    pub(crate) source: TriggerSource,
    /// Time from sweep to sweep, s.
    pub(crate) timer: f64,
    /// Number of sweeps; `None`: until the measurement is stopped.
    pub(crate) count: Option<u32>,
    /// Readings of a channel for each trigger.
    pub(crate) samples: u32,
    /// Delay after a trigger for the bare voltmeter, s; `None`: automatic.
    pub(crate) trigger_delay: Option<f64>,
    pub(crate) format: ReadingFormat,
    pub(crate) threshold: u32,
    pub(super) computations: Computations,
}

/// Settings of computations on readings, for the channels that have any. `SYST:PRES` does not change them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Computations {
    pub(super) scales: BTreeMap<Option<Relay>, Scale>,
    pub(super) limits: BTreeMap<Relay, Limits>,
    /// The alarms to which channels were assigned; all other channels raise alarm 1 (34970A manual p. 250).
    pub(super) alarms: BTreeMap<Relay, u8>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            bare: Setup::default(),
            channels: BTreeMap::new(),
            others: BTreeMap::new(),
            scan: Vec::new(),
            ordered: true,
            source: TriggerSource::Immediate,
            timer: 10.0,
            count: Some(1),
            samples: 1,
            trigger_delay: None,
            format: ReadingFormat::default(),
            threshold: 1,
            computations: Computations::default(),
        }
    }
}

impl Meter {
    /// Restores stored settings; channels of modules that have been removed are left out. Clears the memory.
    pub(crate) fn take_settings(&mut self, stored: Settings, relays: &Relays) {
        let is_there = |relay: &Relay| relays.contact(*relay).is_ok();
        self.settings = stored;
        self.settings.channels.retain(|relay, _| is_there(relay));
        self.settings
            .others
            .retain(|(relay, _), _| relay.as_ref().is_none_or(is_there));
        self.settings.scan.retain(is_there);
        self.settings.computations.retain(is_there);
        self.memory.clear();
    }
}
