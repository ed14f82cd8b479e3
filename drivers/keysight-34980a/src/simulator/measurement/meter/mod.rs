//! The internal voltmeter: settings of every channel, scan list, trigger, and the running measurement (section 5).

mod channels;
mod computations;
mod functions;
mod settings;
mod triggers;

use std::collections::BTreeSet;
use std::time::Duration;

use scpi::ParseError;
use survey::Relay;

pub(crate) use crate::simulator::measurement::meter::settings::Settings;

use crate::command::{Function, TriggerSource};
use crate::modules::Contact;
use crate::simulator::Wires;
use crate::simulator::errors::QueuedError;
use crate::simulator::measurement::memory::Memory;
use crate::simulator::measurement::run::{Run, ScanEntry, StatusEvents, SweepStart};
use crate::simulator::measurement::setup::Setup;
use crate::simulator::relays::Relays;

#[derive(Debug)]
pub(crate) struct Meter {
    line_hz: f64,
    installed: bool,
    enabled: bool,
    pub(crate) settings: Settings,
    memory: Memory,
    run: Option<Run>,
    /// Start of the last measurement.
    began: Duration,
    /// Time up to which readings have been taken ahead of their time.
    ahead: Duration,
    noticed: StatusEvents,
}

impl Meter {
    pub(crate) fn new(line_hz: f64, memory: usize) -> Self {
        Self {
            line_hz,
            installed: true,
            enabled: true,
            settings: Settings::default(),
            memory: Memory::new(memory),
            run: None,
            began: Duration::ZERO,
            ahead: Duration::ZERO,
            noticed: StatusEvents::default(),
        }
    }

    /// Restores the state after `*RST`. The caller stops a running measurement first.
    pub(crate) fn as_new(&mut self) {
        *self = Self {
            installed: self.installed,
            ..Self::new(self.line_hz, self.memory.most())
        };
    }

    pub(crate) fn install(&mut self, installed: bool) {
        self.installed = installed;
    }

    pub(crate) fn is_installed(&self) -> bool {
        self.installed
    }

    fn need_voltmeter(&self) -> Result<(), QueuedError> {
        match (self.installed, self.enabled) {
            (true, true) => Ok(()),
            (true, false) => Err(QueuedError::UNABLE),
            (false, _) => Err(ParseError::HardwareMissing.into()),
        }
    }

    pub(crate) fn enable(&mut self, enabled: bool) {
        self.enabled = enabled;
        self.memory.clear();
        if !enabled {
            self.stop_computations();
        }
    }

    pub(crate) fn is_enabled(&self) -> bool {
        self.enabled
    }

    pub(crate) fn scan_list(&self) -> &[Relay] {
        &self.settings.scan
    }

    pub(crate) fn ordered(&self) -> bool {
        self.settings.ordered
    }

    pub(crate) fn memory(&self) -> &Memory {
        &self.memory
    }

    pub(crate) fn memory_mut(&mut self) -> &mut Memory {
        &mut self.memory
    }

    pub(crate) fn began(&self) -> Duration {
        self.began
    }

    pub(crate) fn take_noticed(&mut self) -> StatusEvents {
        std::mem::take(&mut self.noticed)
    }

    pub(crate) fn is_measuring(&self, now: Duration) -> bool {
        now < self.ahead || self.run.as_ref().is_some_and(|run| !run.is_waiting())
    }

    pub(crate) fn is_waiting(&self) -> bool {
        self.run.as_ref().is_some_and(Run::is_waiting)
    }

    fn is_busy(&self, now: Duration) -> bool {
        now < self.ahead || self.run.is_some()
    }

    /// End of the running measurement, if it can be foreseen; without a measurement a time in the past.
    pub(crate) fn ends_at(&self) -> Option<Duration> {
        match &self.run {
            Some(run) => run.ends_at().map(|end| end.max(self.ahead)),
            None => Some(self.ahead),
        }
    }

    /// Whether the running measurement continues until a trigger or ABOR ends it.
    pub(crate) fn is_endless(&self) -> bool {
        self.run
            .as_ref()
            .is_some_and(|run| run.is_waiting() || run.ends_at().is_none())
    }

    pub(crate) fn due(&self) -> Option<Duration> {
        self.run.as_ref()?.due()
    }

    /// Takes the readings that are due up to this time.
    pub(crate) fn advance(&mut self, to: Duration, relays: &mut Relays, wires: &mut dyn Wires) {
        let Some(run) = &mut self.run else {
            return;
        };
        let before = self.memory.points(to);
        let ended = run.advance(to, relays, wires, &mut self.memory, &mut self.noticed);
        let (before, after) = (before as u64, self.memory.points(to) as u64);
        let threshold = u64::from(self.settings.threshold);
        self.noticed.threshold |= before < threshold && threshold <= after;
        if ended {
            self.run = None;
        }
    }

    /// Starts a measurement into memory.
    pub(crate) fn initiate(
        &mut self,
        now: Duration,
        relays: &mut Relays,
        wires: &mut dyn Wires,
    ) -> Result<(), QueuedError> {
        let pace = self.pace();
        self.begin(
            &self.settings.scan.clone(),
            pace,
            self.settings.count,
            now,
            relays,
            wires,
        )
    }

    /// Starts a measurement, and returns its end.
    pub(crate) fn read(
        &mut self,
        list: &[Relay],
        now: Duration,
        relays: &mut Relays,
        wires: &mut dyn Wires,
    ) -> Result<Duration, QueuedError> {
        let count = match self.settings.count {
            Some(count) if !self.settings.source.waits() => count,
            _ => return Err(QueuedError::DEADLOCK),
        };
        self.read_sweeps(list, self.pace(), count, now, relays, wires)
    }

    /// Starts one immediate sweep, independent of the trigger settings: through the scan list, or one reading of the
    /// bare voltmeter. Returns its end.
    pub(crate) fn read_once(
        &mut self,
        scans: bool,
        now: Duration,
        relays: &mut Relays,
        wires: &mut dyn Wires,
    ) -> Result<Duration, QueuedError> {
        let list = match scans {
            true => self.settings.scan.clone(),
            false => Vec::new(),
        };
        self.read_sweeps(&list, SweepStart::Continuous, 1, now, relays, wires)
    }

    fn read_sweeps(
        &mut self,
        list: &[Relay],
        pace: SweepStart,
        count: u32,
        now: Duration,
        relays: &mut Relays,
        wires: &mut dyn Wires,
    ) -> Result<Duration, QueuedError> {
        if list.len().max(1) * count as usize * self.settings.samples as usize > self.memory.most()
        {
            return Err(QueuedError::MEMORY);
        }
        self.begin(list, pace, Some(count), now, relays, wires)?;
        // the end can be foreseen: the number of sweeps is finite, and none waits for a trigger
        Ok(self.ends_at().unwrap_or(now))
    }

    /// Takes all readings of the measurement that has just begun, ahead of their time.
    pub(crate) fn take_ahead(&mut self, end: Duration, relays: &mut Relays, wires: &mut dyn Wires) {
        self.advance(end, relays, wires);
        self.ahead = end;
    }

    /// Whether a measurement is running.
    pub(crate) fn is_at_work(&self) -> bool {
        self.run.is_some()
    }

    fn pace(&self) -> SweepStart {
        match self.settings.source {
            TriggerSource::Immediate => SweepStart::Continuous,
            TriggerSource::Timer => SweepStart::Timer(survey::duration(self.settings.timer)),
            TriggerSource::Bus | TriggerSource::External | TriggerSource::Alarm(_) => {
                SweepStart::Triggered
            }
        }
    }

    fn begin(
        &mut self,
        list: &[Relay],
        pace: SweepStart,
        sweeps: Option<u32>,
        now: Duration,
        relays: &mut Relays,
        wires: &mut dyn Wires,
    ) -> Result<(), QueuedError> {
        self.need_voltmeter()?;
        if self.is_busy(now) {
            return Err(ParseError::InitIgnored.into());
        }
        let entry = |channel: Option<Relay>| {
            let setup = self.setup(relays, channel);
            let (measured, timing, nplc) = self.plan(channel, &setup);
            let rate = channel
                .and_then(|relay| relays.contact(relay).ok())
                .and_then(|(module, _)| module.model().scan_rate());
            ScanEntry {
                channel,
                period: setup.period(timing, rate, self.line_hz),
                nplc,
                measured,
                again: false,
                scale: self.scale(channel),
                limits: self.limits(channel),
                alarm: self.alarm_of(channel),
            }
        };
        if list.len().max(1) * self.settings.samples as usize > self.memory.most() {
            return Err(QueuedError::MEMORY);
        }
        let first = if list.is_empty() {
            let mut bare = entry(None);
            bare.period += survey::duration(self.settings.trigger_delay.unwrap_or(0.0));
            vec![bare]
        } else {
            list.iter().map(|relay| entry(Some(*relay))).collect()
        };
        // further samples of a channel need no relay move and no delay
        let entries: Vec<ScanEntry> = first
            .into_iter()
            .flat_map(|entry| {
                let setup = self.setup(relays, entry.channel);
                let (_, timing, _) = self.plan(entry.channel, &setup);
                let more = ScanEntry {
                    period: setup.period(timing, None, self.line_hz),
                    again: true,
                    ..entry
                };
                let more = std::iter::repeat_n(more, self.settings.samples as usize - 1);
                std::iter::once(entry).chain(more)
            })
            .collect();
        if !list.is_empty() {
            let sensing = entries
                .iter()
                .filter(|entry| entry.measured.four_wire())
                .filter_map(|entry| relays.partner(entry.channel?));
            let banks: Vec<Relay> = list.iter().copied().chain(sensing).collect();
            relays.clear_for_scan(&banks);
            relays.tell(now, wires);
        }
        self.memory.restart();
        let run = Run::new(entries, pace, sweeps, now);
        self.began = run.start();
        self.run = Some(run);
        self.noticed.measured |= pace != SweepStart::Triggered;
        self.advance(now, relays, wires);
        Ok(())
    }

    /// Receives a trigger from the bus or the rear input.
    pub(crate) fn trigger(
        &mut self,
        from: TriggerSource,
        now: Duration,
    ) -> Result<(), QueuedError> {
        let taken =
            self.settings.source == from && self.run.as_mut().is_some_and(|run| run.trigger(now));
        if taken {
            Ok(())
        } else {
            Err(ParseError::TriggerIgnored.into())
        }
    }

    pub(crate) fn abort(&mut self, now: Duration, relays: &mut Relays, wires: &mut dyn Wires) {
        if let Some(mut run) = self.run.take() {
            run.stop(now, relays, wires);
        }
        self.memory.forget_after(now);
        self.ahead = self.ahead.min(now);
    }

    /// Builds a scan list; all channels must be scannable. The list is ascending without repeats, unless ordering is
    /// off.
    pub(crate) fn arranged(
        &self,
        relays: &Relays,
        list: Vec<Relay>,
    ) -> Result<Vec<Relay>, QueuedError> {
        for relay in &list {
            let (module, _) = relays.contact(*relay)?;
            if !module.scannable(relay.0 % 1000) {
                return Err(QueuedError::CHANNEL_UNABLE);
            }
        }
        Ok(if self.settings.ordered {
            let distinct: BTreeSet<Relay> = list.into_iter().collect();
            distinct.into_iter().collect()
        } else {
            list
        })
    }

    pub(crate) fn set_scan(
        &mut self,
        relays: &Relays,
        list: Vec<Relay>,
    ) -> Result<(), QueuedError> {
        if list.len() > LONGEST_SCAN {
            return Err(ParseError::TooMuchData.into());
        }
        let list = self.arranged(relays, list)?;
        self.check_pairs(relays, &list)?;
        self.settings.scan = list;
        self.memory.clear();
        Ok(())
    }

    /// Sets the scan list to channels that are about to be configured: they have no settings of their own before. Of a
    /// refused list nothing is changed.
    fn configure_scan(&mut self, relays: &Relays, list: Vec<Relay>) -> Result<(), QueuedError> {
        let before = self.settings.channels.clone();
        // `set_scan` checks sensing partners by the functions of the channels
        self.settings
            .channels
            .retain(|relay, _| !list.contains(relay));
        let set = self.set_scan(relays, list);
        if set.is_err() {
            self.settings.channels = before;
        }
        set
    }

    pub(crate) fn set_ordered(
        &mut self,
        relays: &Relays,
        ordered: bool,
    ) -> Result<(), QueuedError> {
        self.settings.ordered = ordered;
        self.set_scan(relays, self.settings.scan.clone())
    }

    /// Removes the channels of a slot from the scan list.
    pub(crate) fn forget_slot(&mut self, slot: u32) {
        self.settings.scan.retain(|relay| relay.0 / 1000 != slot);
        self.settings
            .channels
            .retain(|relay, _| relay.0 / 1000 != slot);
        self.settings
            .others
            .retain(|(relay, _), _| relay.is_none_or(|relay| relay.0 / 1000 != slot));
        self.settings
            .computations
            .retain(|relay| relay.0 / 1000 != slot);
    }

    fn setup(&self, relays: &Relays, channel: Option<Relay>) -> Setup {
        let Some(relay) = channel else {
            return self.settings.bare;
        };
        self.settings
            .channels
            .get(&relay)
            .copied()
            .unwrap_or_else(|| {
                let contact = relays.contact(relay).map(|(_, contact)| contact);
                let function = match contact {
                    Ok(Contact::Current { .. }) => Function::DcCurrent,
                    _ => Function::DcVolts,
                };
                Setup::default().measuring(function)
            })
    }

    fn put(&mut self, target: Option<Relay>, setup: Setup) {
        match target {
            Some(relay) => drop(self.settings.channels.insert(relay, setup)),
            None => self.settings.bare = setup,
        }
    }
}

/// Longest scan list. With ordering off a list may repeat channels; its length is limited by the instrument's memory,
/// and this number is assumed because the sources give none.
const LONGEST_SCAN: usize = 5000;
