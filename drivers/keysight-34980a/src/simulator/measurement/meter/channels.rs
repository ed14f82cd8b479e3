//! Settings of each channel.

use scpi::{ChannelList, Numeric};
use survey::Relay;

use crate::command::{Channels, Function, Quantity, Range, Setting};
use crate::modules::Contact;
use crate::simulator::errors::QueuedError;
use crate::simulator::measurement::meter::Meter;
use crate::simulator::measurement::setup::{Setup, Timing};
use crate::simulator::relays::Relays;

impl Meter {
    /// Executes CONF for DC volts: sets the scan list if there is a channel list and every other setting to its
    /// default, and switches off the fields of readings. Returns the number of channels.
    pub(crate) fn configure(
        &mut self,
        relays: &Relays,
        range: Range,
        resolution: Option<Numeric>,
        channels: &Channels,
    ) -> Result<usize, QueuedError> {
        self.need_voltmeter()?;
        let setup = Setup::configured(range, resolution)?;
        if let Some(list) = channels {
            let list = self.arranged(relays, relays.expand(list)?)?;
            for relay in &list {
                if let (_, Contact::Current { .. }) = relays.contact(*relay)? {
                    return Err(QueuedError::CHANNEL_UNABLE);
                }
            }
            self.configure_scan(relays, list)?;
        }
        self.settings.format.fields.clear();
        self.reset_samples();
        for target in self.targets(relays, channels)? {
            self.forget_computations(target);
        }
        self.change(relays, channels, |target, _| {
            *target = setup;
            Ok(())
        })
    }

    /// Changes one setting, and returns the number of channels.
    pub(crate) fn set(
        &mut self,
        relays: &Relays,
        setting: Setting,
        channels: &Channels,
    ) -> Result<usize, QueuedError> {
        let channels = self.channels_of(setting.quantity(), channels);
        let line_hz = self.line_hz;
        self.change(relays, &channels, |setup, timing| {
            setup.change(setting, timing, line_hz)
        })
    }

    /// Changes a setting of all channels, or of none if one of them rejects it.
    fn change(
        &mut self,
        relays: &Relays,
        channels: &Channels,
        change: impl Fn(&mut Setup, Timing) -> Result<(), QueuedError>,
    ) -> Result<usize, QueuedError> {
        self.need_voltmeter()?;
        let mut changed = Vec::new();
        for target in self.targets(relays, channels)? {
            let mut setup = self.setup(relays, target);
            let (_, timing, _) = self.plan(target, &setup);
            change(&mut setup, timing)?;
            changed.push((target, setup));
        }
        let count = changed.len();
        for (target, setup) in changed {
            self.put(target, setup);
        }
        self.memory.clear();
        Ok(count)
    }

    /// Reply with one setting of every channel.
    pub(crate) fn ask(
        &self,
        relays: &Relays,
        quantity: Quantity,
        limit: Option<Numeric>,
        channels: &Channels,
    ) -> Result<String, QueuedError> {
        let channels = self.channels_of(quantity, channels);
        self.answers(relays, &channels, |target, setup| {
            let (_, timing, _) = self.plan(target, &setup);
            setup.answer(quantity, limit, self.line_hz, timing)
        })
    }

    /// Reply with function, range and resolution of every channel.
    pub(crate) fn configuration(
        &self,
        relays: &Relays,
        channels: &Channels,
    ) -> Result<String, QueuedError> {
        self.answers(relays, channels, |target, setup| {
            Ok(match setup.function {
                Function::DcVolts => setup.configuration(self.line_hz),
                function => self
                    .function_settings(target, function)
                    .configuration(self.line_hz),
            })
        })
    }

    pub(crate) fn answers(
        &self,
        relays: &Relays,
        channels: &Channels,
        answer: impl Fn(Option<Relay>, Setup) -> Result<String, QueuedError>,
    ) -> Result<String, QueuedError> {
        self.need_voltmeter()?;
        let targets = self.targets(relays, channels)?;
        let answers: Result<Vec<String>, QueuedError> = targets
            .into_iter()
            .map(|target| answer(target, self.setup(relays, target)))
            .collect();
        Ok(answers?.join(","))
    }

    /// Only channels have a delay: without a list the setting applies to the channels of the scan list.
    fn channels_of(&self, quantity: Quantity, channels: &Channels) -> Channels {
        match (quantity, channels) {
            (Quantity::Delay | Quantity::DelayAuto, None) => {
                let scan = self.settings.scan.iter().map(|relay| relay.0);
                Some(ChannelList::of(scan))
            }
            _ => channels.clone(),
        }
    }

    /// The channels of a setting. Without a list the setting applies to the internal voltmeter (`None`), not to the
    /// channels of the scan list (corrections of 2026-11-22).
    pub(crate) fn targets(
        &self,
        relays: &Relays,
        channels: &Channels,
    ) -> Result<Vec<Option<Relay>>, QueuedError> {
        let list = match channels {
            Some(list) => {
                // a query replies in the order of its list; all channels must be scannable
                let list = relays.expand(list)?;
                self.arranged(relays, list.clone())?;
                list
            }
            None => Vec::new(),
        };
        if list.is_empty() {
            Ok(vec![None])
        } else {
            Ok(list.into_iter().map(Some).collect())
        }
    }
}
