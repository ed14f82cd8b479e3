//! Functions other than DC volts on each channel.

use scpi::{Numeric, ParseError};
use survey::Relay;

use crate::command::{
    Channels, Detail, Function, MeasurementRequest, Quantity, Setting, SettingValue,
};
use crate::modules::{Contact, Model};
use crate::simulator::errors::QueuedError;
use crate::simulator::measurement::functions::FunctionSettings;
use crate::simulator::measurement::meter::Meter;
use crate::simulator::measurement::run::Measured;
use crate::simulator::measurement::setup::{Setup, Timing};
use crate::simulator::relays::Relays;

impl Meter {
    /// Executes CONF for a function other than DC volts; see [`Meter::configure`].
    pub(crate) fn configure_function(
        &mut self,
        relays: &Relays,
        request: MeasurementRequest,
        channels: &Channels,
    ) -> Result<usize, QueuedError> {
        self.need_voltmeter()?;
        let targets = match channels {
            Some(list) => {
                let list = self.arranged(relays, relays.expand(list)?)?;
                list.into_iter().map(Some).collect()
            }
            None => self.targets(relays, channels)?,
        };
        let targets = match targets.is_empty() {
            true => vec![None],
            false => targets,
        };
        let mut new = Vec::new();
        for target in targets {
            let settings = self
                .function_settings(target, request.function)
                .configured(request)?;
            permit(relays, target, settings)?;
            new.push((target, settings));
        }
        if channels.is_some() {
            let list: Vec<Relay> = new.iter().filter_map(|(target, _)| *target).collect();
            self.configure_scan(relays, list)?;
        }
        self.settings.format.fields.clear();
        self.reset_samples();
        self.memory.clear();
        let count = new.len();
        for (target, settings) in new {
            self.settings
                .others
                .insert(key(target, request.function), settings);
            self.put(target, Setup::default().measuring(request.function));
            self.forget_computations(target);
        }
        Ok(count)
    }

    /// Selects a function; its settings stay as they are. Returns the number of channels.
    pub(crate) fn select(
        &mut self,
        relays: &Relays,
        function: Function,
        channels: &Channels,
    ) -> Result<usize, QueuedError> {
        self.need_voltmeter()?;
        let targets = self.targets(relays, channels)?;
        for target in &targets {
            permit(relays, *target, self.function_settings(*target, function))?;
        }
        self.memory.clear();
        for target in &targets {
            let setup = self.setup(relays, *target).measuring(function);
            self.put(*target, setup);
            self.suspend_computations(*target);
        }
        Ok(targets.len())
    }

    /// Reply with the selected function.
    pub(crate) fn selected(
        &self,
        relays: &Relays,
        channels: &Channels,
    ) -> Result<String, QueuedError> {
        let name = |target, setup: Setup| {
            let _: Option<Relay> = target;
            Ok(format!("\"{}\"", setup.function.word()))
        };
        self.answers(relays, channels, name)
    }

    /// Changes one setting of a function, and returns the number of channels.
    pub(crate) fn set_detail(
        &mut self,
        relays: &Relays,
        (function, detail): (Function, Detail),
        value: SettingValue,
        channels: &Channels,
    ) -> Result<usize, QueuedError> {
        match (detail, value) {
            (Detail::Autozero, SettingValue::Switch(on)) => {
                return self.set(relays, Setting::Autozero(on), channels);
            }
            (Detail::Autozero, _) => return self.set(relays, Setting::AutozeroOnce, channels),
            _ => {}
        }
        self.need_voltmeter()?;
        let mut new = Vec::new();
        for target in self.targets(relays, channels)? {
            let mut settings = self.function_settings(target, function);
            settings.change(detail, value)?;
            if (detail, value) == (Detail::JunctionSource, SettingValue::Word("INT")) {
                has_thermometer(relays, target)?;
            }
            new.push((target, settings));
        }
        self.memory.clear();
        let count = new.len();
        let times = matches!(detail, Detail::Nplc | Detail::Aperture | Detail::Resolution);
        let unit = matches!(
            detail,
            Detail::Probe | Detail::Couple | Detail::Rtd | Detail::Thermistor | Detail::Degrees
        );
        for (target, settings) in new {
            if unit {
                self.suspend_computations(target);
            }
            self.settings.others.insert(key(target, function), settings);
            let mut setup = self.setup(relays, target);
            if times && setup.without_zero_below_a_cycle(settings.cycles(self.line_hz)) {
                self.put(target, setup);
            }
        }
        Ok(count)
    }

    /// Reply with one setting of a function.
    pub(crate) fn detail(
        &self,
        relays: &Relays,
        (function, detail): (Function, Detail),
        limit: Option<Numeric>,
        channels: &Channels,
    ) -> Result<String, QueuedError> {
        if detail == Detail::Autozero {
            return self.ask(relays, Quantity::Autozero, limit, channels);
        }
        self.answers(relays, channels, |target, _| {
            self.function_settings(target, function)
                .answer(detail, limit, self.line_hz)
        })
    }

    /// The measured quantity, the times of a reading, and the integration time (power-line cycles) of a channel.
    pub(crate) fn plan(&self, target: Option<Relay>, setup: &Setup) -> (Measured, Timing, f64) {
        match setup.function {
            Function::DcVolts => (
                Measured::Volts(setup.range),
                setup.timing(self.line_hz),
                setup.cycles(self.line_hz),
            ),
            function => {
                let settings = self.function_settings(target, function);
                let timing = settings.timing(self.line_hz);
                (
                    Measured::Other(settings),
                    timing,
                    settings.cycles(self.line_hz),
                )
            }
        }
    }

    pub(crate) fn function_settings(
        &self,
        target: Option<Relay>,
        function: Function,
    ) -> FunctionSettings {
        let settings = self.settings.others.get(&key(target, function)).copied();
        settings
            .unwrap_or_else(|| FunctionSettings::new(function))
            .measuring(function)
    }

    /// Rejects a scan list that contains both a channel of a four-wire measurement and its sensing partner (+306).
    pub(crate) fn check_pairs(&self, relays: &Relays, list: &[Relay]) -> Result<(), QueuedError> {
        for relay in list {
            let setup = self.setup(relays, Some(*relay));
            if setup.function != Function::DcVolts
                && self
                    .function_settings(Some(*relay), setup.function)
                    .four_wire()
                && let Some(partner) = relays.partner(*relay)
                && list.contains(&partner)
            {
                return Err(QueuedError::PART_OF_PAIR);
            }
        }
        Ok(())
    }
}

/// The key of the settings of a function; two- and four-wire resistance share theirs.
fn key(target: Option<Relay>, function: Function) -> (Option<Relay>, Function) {
    match function {
        Function::FourWire => (target, Function::Resistance),
        function => (target, function),
    }
}

/// Checks that a channel can measure a function: currents only on current channels, which measure nothing else;
/// four-wire measurements only on channels of bank 1.
fn permit(
    relays: &Relays,
    target: Option<Relay>,
    settings: FunctionSettings,
) -> Result<(), QueuedError> {
    let Some(relay) = target else {
        return Ok(());
    };
    let (_, contact) = relays.contact(relay)?;
    let on_current = matches!(contact, Contact::Current { .. });
    let current = matches!(settings.function, Function::DcCurrent | Function::AcCurrent);
    if on_current != current || (settings.four_wire() && relays.partner(relay).is_none()) {
        return Err(QueuedError::CHANNEL_UNABLE);
    }
    Ok(())
}

/// Checks that the channel's terminal block contains a temperature sensor; only that of a 34921A does.
fn has_thermometer(relays: &Relays, target: Option<Relay>) -> Result<(), QueuedError> {
    match target {
        None => Err(ParseError::SettingsConflict.into()),
        Some(relay) => match relays.contact(relay)?.0.model() {
            Model::M34921A => Ok(()),
            _ => Err(QueuedError::CHANNEL_UNABLE),
        },
    }
}
