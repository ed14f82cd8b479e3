//! Scaling, limits and statistics of each channel (help pages CALCulate:SCALe, CALCulate:LIMit, CALCulate:AVERage,
//! OUTPut:ALARm).
//!
//! The help pages contradict each other about the effect of a change of the configuration. Here CONF and MEAS? reset
//! gain, offset, unit and limits; selecting another function, probe or unit of temperatures switches scaling off and
//! clears the limits. Switching scaling on clears the channel's limits.

use std::time::Duration;

use scpi::{ChannelList, Numeric, ParseError, format_nr3_signed, quote};
use survey::Relay;

use crate::command::{
    Channels, FREQUENCIES, Function, LARGEST, Limit, Scaling, ScalingQuantity, Statistic,
};
use crate::simulator::calendar::Calendar;
use crate::simulator::errors::QueuedError;
use crate::simulator::measurement::computation::{Limits, Mark, Scale};
use crate::simulator::measurement::functions::OVER_RANGE;
use crate::simulator::measurement::meter::Meter;
use crate::simulator::measurement::meter::settings::Computations;
use crate::simulator::measurement::setup::at;
use crate::simulator::relays::Relays;

impl Computations {
    pub(super) fn retain(&mut self, is_there: impl Fn(&Relay) -> bool) {
        self.scales
            .retain(|relay, _| relay.as_ref().is_none_or(&is_there));
        self.limits.retain(|relay, _| is_there(relay));
        self.alarms.retain(|relay, _| is_there(relay));
    }
}

impl Meter {
    pub(super) fn scale(&self, target: Option<Relay>) -> Scale {
        let scale = self.settings.computations.scales.get(&target);
        scale.copied().unwrap_or_default()
    }

    pub(super) fn limits(&self, target: Option<Relay>) -> Limits {
        let limits = target.and_then(|relay| self.settings.computations.limits.get(&relay));
        limits.copied().unwrap_or_default()
    }

    pub(super) fn alarm_of(&self, target: Option<Relay>) -> u8 {
        let alarm = target.and_then(|relay| self.settings.computations.alarms.get(&relay));
        alarm.copied().unwrap_or(1)
    }

    /// The settings that `SYST:PRES` does not change.
    pub(crate) fn computations(&self) -> Computations {
        self.settings.computations.clone()
    }

    pub(crate) fn take_computations(&mut self, computations: Computations) {
        self.settings.computations = computations;
    }

    /// Resets scaling and limits of a channel.
    pub(super) fn forget_computations(&mut self, target: Option<Relay>) {
        self.settings.computations.scales.remove(&target);
        if let Some(relay) = target {
            self.settings.computations.limits.remove(&relay);
        }
    }

    /// Switches scaling of a channel off, and clears its limits.
    pub(super) fn suspend_computations(&mut self, target: Option<Relay>) {
        if let Some(scale) = self.settings.computations.scales.get_mut(&target) {
            scale.on = false;
        }
        if let Some(relay) = target {
            self.settings.computations.limits.remove(&relay);
        }
    }

    /// Switches all scaling and all limits off.
    pub(super) fn stop_computations(&mut self) {
        let computations = &mut self.settings.computations;
        for scale in computations.scales.values_mut() {
            scale.on = false;
        }
        for limits in computations.limits.values_mut() {
            limits.switch(Limit::Lower, false);
            limits.switch(Limit::Upper, false);
        }
    }

    pub(crate) fn set_scaling(
        &mut self,
        relays: &Relays,
        scaling: &Scaling,
        channels: &Channels,
    ) -> Result<(), QueuedError> {
        self.need_voltmeter()?;
        for target in self.targets(relays, channels)? {
            let mut scale = self.scale(target);
            match scaling {
                Scaling::Gain(gain) => scale.gain = *gain,
                Scaling::Offset(offset) => scale.offset = *offset,
                Scaling::Unit(unit) => scale.unit = Mark::custom(unit),
                Scaling::State(on) => scale.on = *on,
            }
            if *scaling == Scaling::State(true) {
                self.suspend_computations(target);
            }
            self.settings.computations.scales.insert(target, scale);
        }
        Ok(())
    }

    pub(crate) fn scaling(
        &self,
        relays: &Relays,
        quantity: ScalingQuantity,
        channels: &Channels,
    ) -> Result<String, QueuedError> {
        self.answers(relays, channels, |target, _| {
            let scale = self.scale(target);
            Ok(match quantity {
                ScalingQuantity::Gain => format_nr3_signed(scale.gain, 8),
                ScalingQuantity::Offset => format_nr3_signed(scale.offset, 8),
                ScalingQuantity::Unit => quote(scale.unit.as_ref().map_or("", Mark::text)),
                ScalingQuantity::State => u8::from(scale.on).to_string(),
            })
        })
    }

    /// Largest limit of a channel: 120 % of the highest range of its function. `None` if scaled readings or
    /// temperatures are compared.
    fn largest_limit(&self, relays: &Relays, target: Option<Relay>) -> Option<f64> {
        let function = self.setup(relays, target).function;
        let most = match function {
            Function::Frequency => Some(FREQUENCIES[1]),
            Function::Period => Some(1.0 / FREQUENCIES[0]),
            other => other.ranges().last().copied(),
        };
        most.filter(|_| !self.scale(target).on)
            .map(|most| most * OVER_RANGE)
    }

    pub(crate) fn set_limit(
        &mut self,
        relays: &Relays,
        limit: Limit,
        value: Numeric,
        channels: &ChannelList,
    ) -> Result<(), QueuedError> {
        self.need_voltmeter()?;
        let mut changed = Vec::new();
        for target in self.listed(relays, channels)? {
            let largest = self.largest_limit(relays, Some(target)).unwrap_or(LARGEST);
            let value = match value {
                Numeric::Def => Limits::default().get(limit),
                value => value.within(-largest, largest, 0.0)?,
            };
            let limits = self.limits(Some(target)).with(limit, value);
            changed.push((target, limits.ok_or(ParseError::SettingsConflict)?));
        }
        self.settings.computations.limits.extend(changed);
        Ok(())
    }

    pub(crate) fn limit(
        &self,
        relays: &Relays,
        limit: Limit,
        end: Option<Numeric>,
        channels: &ChannelList,
    ) -> Result<String, QueuedError> {
        self.of_listed(relays, channels, |target| {
            let largest = self.largest_limit(relays, Some(target)).unwrap_or(LARGEST);
            let now = self.limits(Some(target)).get(limit);
            let limits = [-largest, largest, Limits::default().get(limit)];
            format_nr3_signed(at(end, now, limits), 8)
        })
    }

    pub(crate) fn switch_limit(
        &mut self,
        relays: &Relays,
        limit: Limit,
        on: bool,
        channels: &ChannelList,
    ) -> Result<(), QueuedError> {
        self.need_voltmeter()?;
        for target in self.listed(relays, channels)? {
            let mut limits = self.limits(Some(target));
            limits.switch(limit, on);
            self.settings.computations.limits.insert(target, limits);
        }
        Ok(())
    }

    pub(crate) fn limit_state(
        &self,
        relays: &Relays,
        limit: Limit,
        channels: &ChannelList,
    ) -> Result<String, QueuedError> {
        self.of_listed(relays, channels, |target| {
            u8::from(self.limits(Some(target)).is_on(limit)).to_string()
        })
    }

    /// Assigns channels to an alarm; an empty list removes all channels from it.
    pub(crate) fn assign_alarm(
        &mut self,
        relays: &Relays,
        alarm: u8,
        channels: &ChannelList,
    ) -> Result<(), QueuedError> {
        let list = self.arranged(relays, relays.expand(channels)?)?;
        let alarms = &mut self.settings.computations.alarms;
        alarms.retain(|_, assigned| *assigned != alarm);
        alarms.extend(list.into_iter().map(|relay| (relay, alarm)));
        Ok(())
    }

    pub(crate) fn assigned(&self, alarm: u8) -> ChannelList {
        let alarms = self.settings.computations.alarms.iter();
        let assigned = alarms.filter(|(_, assigned)| **assigned == alarm);
        ChannelList::of(assigned.map(|(relay, _)| relay.0))
    }

    pub(crate) fn statistic(
        &self,
        relays: &Relays,
        statistic: Statistic,
        channels: &Channels,
        (calendar, now): (&Calendar, Duration),
    ) -> Result<String, QueuedError> {
        self.answers(relays, channels, |target, _| {
            let summary = self.memory.summary(target, now);
            let stamp = |at: Option<Duration>| {
                at.map_or_else(|| "0,0,0,0,0,0".to_owned(), |at| calendar.stamp(at))
            };
            let value = match statistic {
                Statistic::MinimumTime => return Ok(stamp(summary.map(|all| all.least.at))),
                Statistic::MaximumTime => return Ok(stamp(summary.map(|all| all.most.at))),
                Statistic::Minimum => summary.map(|all| all.least.value),
                Statistic::Maximum => summary.map(|all| all.most.value),
                Statistic::Average => summary.map(|all| all.mean()),
                Statistic::PeakToPeak => summary.map(|all| all.most.value - all.least.value),
                Statistic::Count => summary.map(|all| f64::from(all.count)),
            };
            Ok(format_nr3_signed(value.unwrap_or(0.0), 8))
        })
    }

    pub(crate) fn clear_statistics(
        &mut self,
        relays: &Relays,
        channels: &Channels,
        now: Duration,
    ) -> Result<(), QueuedError> {
        self.need_voltmeter()?;
        for target in self.targets(relays, channels)? {
            self.memory.clear_summary(target, now);
        }
        Ok(())
    }

    /// The channels of a list, which must not be empty and contain only channels that can be scanned.
    fn listed(&self, relays: &Relays, channels: &ChannelList) -> Result<Vec<Relay>, QueuedError> {
        let list = relays.expand_some(channels)?;
        self.arranged(relays, list.clone())?;
        Ok(list)
    }

    fn of_listed(
        &self,
        relays: &Relays,
        channels: &ChannelList,
        answer: impl Fn(Relay) -> String,
    ) -> Result<String, QueuedError> {
        self.need_voltmeter()?;
        let answers = self.listed(relays, channels)?.into_iter().map(answer);
        Ok(answers.collect::<Vec<_>>().join(","))
    }
}
