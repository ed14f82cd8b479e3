//! Imperfections: none, until a scene asks. Each is one file with its physics, formula and source.
//!
//! An effect acts on the sheet's conductance, on the contacts, on the network between the electrodes, or on a reading;
//! a scene's effects are lists of those four kinds, so that one that is not named is not there to be asked. Each draws
//! from a stream of its own. What acts on sheet, contacts or network says by its **epoch** when it changes: between, the
//! same solution serves.

mod autozero_off;
mod bias_current;
mod bounds;
mod channel_noise;
mod charge_injection;
mod common_mode;
mod contact_drift;
mod contact_spread;
mod crack;
mod current_error;
mod current_noise;
mod detachment;
mod humidity;
mod input_resistance;
mod isolation;
mod leakage;
mod long_drift;
mod mains_pickup;
mod output_resistance;
mod quantisation;
mod short;
mod source_settling;
mod spray;
mod temperature;
mod thermal_emf;
mod voltmeter_gain;
mod voltmeter_noise;
mod wander;

use std::fmt;
use std::time::Duration;

use nalgebra::DMatrix;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use survey::{Amps, Ohms, Relay, Volts};

pub use autozero_off::AutozeroOffSettings;
pub use bias_current::BiasCurrentSettings;
pub use bounds::Fault as ParameterFault;
pub use channel_noise::ChannelNoiseSettings;
pub use charge_injection::ChargeInjectionSettings;
pub use common_mode::CommonModeSettings;
pub use contact_drift::ContactDriftSettings;
pub use contact_spread::ContactSpreadSettings;
pub use crack::CrackSettings;
pub use current_error::CurrentErrorSettings;
pub use current_noise::CurrentNoiseSettings;
pub use detachment::DetachmentSettings;
pub use humidity::HumiditySettings;
pub use input_resistance::InputResistanceSettings;
pub use isolation::IsolationSettings;
pub use leakage::LeakageSettings;
pub use long_drift::LongDriftSettings;
pub use mains_pickup::MainsPickupSettings;
pub use output_resistance::OutputResistanceSettings;
pub use quantisation::QuantisationSettings;
pub use short::ShortSettings;
pub use source_settling::SourceSettlingSettings;
pub use spray::SpraySettings;
pub use temperature::TemperatureSettings;
pub use thermal_emf::ThermalEmfSettings;
pub use voltmeter_gain::VoltmeterGainSettings;
pub use voltmeter_noise::VoltmeterNoiseSettings;

/// How a reading is taken, as far as an effect may depend on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadingContext {
    /// When the reading ends.
    pub at: Duration,
    /// How long the voltmeter has integrated until then.
    pub integration: Duration,
    /// The voltmeter's range.
    pub range: Volts,
    /// Integration in power-line cycles.
    pub nplc: f64,
    /// The channel that leads to the voltmeter; `None` for its bare input.
    pub relay: Option<Relay>,
    /// The current that the source was told to drive, or less in compliance.
    pub flowing: Amps,
    /// The source's range.
    pub source_range: Amps,
    /// From the last change of current or relays to the reading's end.
    pub since_change: Duration,
    /// Resistance between the voltmeter's terminals, looking into the sheet; asked for only where [`Needs`] says so.
    pub source_resistance: Ohms,
    /// Resistance that the source drives its current through; asked for only where [`Needs`] says so.
    pub load_resistance: Ohms,
}

impl ReadingContext {
    /// From the last change to the beginning of the integration.
    fn settled(&self) -> Duration {
        self.since_change.saturating_sub(self.integration)
    }
}

/// What a scene's effects must be told beside what is at hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Needs {
    /// [`ReadingContext::source_resistance`].
    pub source_resistance: bool,
    /// [`ReadingContext::load_resistance`].
    pub load_resistance: bool,
}

/// The effects that a scene names; the order of the fields is the order in which they act.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case", deny_unknown_fields)]
pub struct EffectSettings {
    /// Uneven spraying of the sheet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spray: Option<SpraySettings>,
    /// Temperature of the sheet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature: Option<TemperatureSettings>,
    /// Humidity of the foam.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub humidity: Option<HumiditySettings>,
    /// Drift over hours to months.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub long_drift: Option<LongDriftSettings>,
    /// A crack in the sheet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crack: Option<CrackSettings>,
    /// Contacts that differ.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact_spread: Option<ContactSpreadSettings>,
    /// Contacts that wander.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact_drift: Option<ContactDriftSettings>,
    /// An electrode that comes off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detachment: Option<DetachmentSettings>,
    /// A short between two electrodes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub short: Option<ShortSettings>,
    /// Leakage between wires.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub isolation: Option<IsolationSettings>,
    /// Gain and offset of the source.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current_error: Option<CurrentErrorSettings>,
    /// Noise of the source.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current_noise: Option<CurrentNoiseSettings>,
    /// The source's own resistance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub output_resistance: Option<OutputResistanceSettings>,
    /// The time that the current takes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source_settling: Option<SourceSettlingSettings>,
    /// Charge that a switching relay leaves behind.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub charge_injection: Option<ChargeInjectionSettings>,
    /// Thermal voltages of the relays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thermal_emf: Option<ThermalEmfSettings>,
    /// Channels noisier than the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub channel_noise: Option<ChannelNoiseSettings>,
    /// Leakage of a FET multiplexer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leakage: Option<LeakageSettings>,
    /// Mains in the leads.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mains_pickup: Option<MainsPickupSettings>,
    /// What both leads have in common.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub common_mode: Option<CommonModeSettings>,
    /// The share that the voltmeter's input takes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input_resistance: Option<InputResistanceSettings>,
    /// The current out of the voltmeter's input.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bias_current: Option<BiasCurrentSettings>,
    /// Gain and offset of the voltmeter.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voltmeter_gain: Option<VoltmeterGainSettings>,
    /// The zero of a voltmeter that does not look at it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub autozero_off: Option<AutozeroOffSettings>,
    /// Noise of the voltmeter.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voltmeter_noise: Option<VoltmeterNoiseSettings>,
    /// Steps of the voltmeter's converter.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quantisation: Option<QuantisationSettings>,
}

impl EffectSettings {
    /// The first parameter that is out of its range, and the effect that it belongs to.
    ///
    /// # Errors
    /// The name of the effect as scenes write it, the key, and what is allowed.
    pub fn check(&self) -> Result<(), (&'static str, ParameterFault)> {
        if let Some(settings) = &self.spray {
            settings.check().map_err(|fault| ("spray", fault))?;
        }
        if let Some(settings) = &self.temperature {
            settings.check().map_err(|fault| ("temperature", fault))?;
        }
        if let Some(settings) = &self.humidity {
            settings.check().map_err(|fault| ("humidity", fault))?;
        }
        if let Some(settings) = &self.long_drift {
            settings.check().map_err(|fault| ("long-drift", fault))?;
        }
        if let Some(settings) = &self.crack {
            settings.check().map_err(|fault| ("crack", fault))?;
        }
        if let Some(settings) = &self.contact_spread {
            settings
                .check()
                .map_err(|fault| ("contact-spread", fault))?;
        }
        if let Some(settings) = &self.contact_drift {
            settings.check().map_err(|fault| ("contact-drift", fault))?;
        }
        if let Some(settings) = &self.detachment {
            settings.check().map_err(|fault| ("detachment", fault))?;
        }
        if let Some(settings) = &self.short {
            settings.check().map_err(|fault| ("short", fault))?;
        }
        if let Some(settings) = &self.isolation {
            settings.check().map_err(|fault| ("isolation", fault))?;
        }
        if let Some(settings) = &self.current_error {
            settings.check().map_err(|fault| ("current-error", fault))?;
        }
        if let Some(settings) = &self.current_noise {
            settings.check().map_err(|fault| ("current-noise", fault))?;
        }
        if let Some(settings) = &self.output_resistance {
            settings
                .check()
                .map_err(|fault| ("output-resistance", fault))?;
        }
        if let Some(settings) = &self.source_settling {
            settings
                .check()
                .map_err(|fault| ("source-settling", fault))?;
        }
        if let Some(settings) = &self.charge_injection {
            settings
                .check()
                .map_err(|fault| ("charge-injection", fault))?;
        }
        if let Some(settings) = &self.thermal_emf {
            settings.check().map_err(|fault| ("thermal-emf", fault))?;
        }
        if let Some(settings) = &self.channel_noise {
            settings.check().map_err(|fault| ("channel-noise", fault))?;
        }
        if let Some(settings) = &self.leakage {
            settings.check().map_err(|fault| ("leakage", fault))?;
        }
        if let Some(settings) = &self.mains_pickup {
            settings.check().map_err(|fault| ("mains-pickup", fault))?;
        }
        if let Some(settings) = &self.common_mode {
            settings.check().map_err(|fault| ("common-mode", fault))?;
        }
        if let Some(settings) = &self.input_resistance {
            settings
                .check()
                .map_err(|fault| ("input-resistance", fault))?;
        }
        if let Some(settings) = &self.bias_current {
            settings.check().map_err(|fault| ("bias-current", fault))?;
        }
        if let Some(settings) = &self.voltmeter_gain {
            settings
                .check()
                .map_err(|fault| ("voltmeter-gain", fault))?;
        }
        if let Some(settings) = &self.autozero_off {
            settings.check().map_err(|fault| ("autozero-off", fault))?;
        }
        if let Some(settings) = &self.voltmeter_noise {
            settings
                .check()
                .map_err(|fault| ("voltmeter-noise", fault))?;
        }
        if let Some(settings) = &self.quantisation {
            settings.check().map_err(|fault| ("quantisation", fault))?;
        }
        Ok(())
    }
}

impl EffectSettings {
    /// Effects that name an electrode which the sheet has not.
    ///
    /// # Errors
    /// As [`EffectSettings::check`].
    pub fn check_electrodes(
        &self,
        electrodes: usize,
    ) -> Result<(), (&'static str, ParameterFault)> {
        let named = [
            (
                "detachment",
                "electrode",
                self.detachment.as_ref().map(|off| off.electrode),
            ),
            (
                "short",
                "electrodes",
                self.short.as_ref().map(|short| short.electrodes[0]),
            ),
            (
                "short",
                "electrodes",
                self.short.as_ref().map(|short| short.electrodes[1]),
            ),
        ];
        for (effect, key, number) in named {
            if let Some(number) = number
                && number > electrodes
            {
                let why = format!("names electrode {number}, the sheet has {electrodes}");
                return Err((effect, ParameterFault { key, why }));
            }
        }
        Ok(())
    }
}

/// Acts on the sheet.
pub(crate) trait OnSheet: fmt::Debug + Send {
    /// Changes the conductance of triangles (S per square) whose centroids are `places` (m).
    fn act(&mut self, at: Duration, places: &[[f64; 2]], sigma: &mut [f64]);

    /// Changes whenever [`OnSheet::act`] would give something else.
    fn epoch(&self, at: Duration) -> u64;
}

/// Acts on the contacts.
pub(crate) trait OnContacts: fmt::Debug + Send {
    /// Changes the contact impedances, ohm m, one an electrode.
    fn act(&mut self, at: Duration, contacts: &mut [f64]);

    /// Changes whenever [`OnContacts::act`] would give something else.
    fn epoch(&self, at: Duration) -> u64;
}

/// Acts on what lies between the electrodes beside the sheet.
pub(crate) trait OnNetwork: fmt::Debug + Send {
    /// Changes the transfer impedance, ohm.
    fn act(&mut self, at: Duration, z: &mut DMatrix<f64>);

    /// Changes whenever [`OnNetwork::act`] would give something else.
    fn epoch(&self, at: Duration) -> u64;
}

/// Acts on a reading.
pub(crate) trait OnReading: fmt::Debug + Send {
    /// The voltage as it leaves the effect.
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts;

    /// Whether it must be told [`ReadingContext::source_resistance`].
    fn needs_source_resistance(&self) -> bool {
        false
    }

    /// Whether it must be told [`ReadingContext::load_resistance`].
    fn needs_load_resistance(&self) -> bool {
        false
    }
}

/// The effects that a scene named, in order.
#[derive(Debug)]
pub(crate) struct Effects {
    pub(crate) sheet: Vec<Box<dyn OnSheet>>,
    pub(crate) contacts: Vec<Box<dyn OnContacts>>,
    pub(crate) network: Vec<Box<dyn OnNetwork>>,
    readings: Vec<Box<dyn OnReading>>,
}

impl Effects {
    pub(crate) fn new(settings: &EffectSettings, seed: u64) -> Self {
        let mut sheet: Vec<Box<dyn OnSheet>> = Vec::new();
        let mut contacts: Vec<Box<dyn OnContacts>> = Vec::new();
        let mut network: Vec<Box<dyn OnNetwork>> = Vec::new();
        let mut readings: Vec<Box<dyn OnReading>> = Vec::new();
        if let Some(named) = &settings.spray {
            sheet.push(Box::new(spray::Spray::new(named, stream(seed, "spray"))));
        }
        if let Some(named) = &settings.temperature {
            sheet.push(Box::new(temperature::Temperature(named.clone())));
        }
        if let Some(named) = &settings.humidity {
            sheet.push(Box::new(humidity::Humidity(named.clone())));
        }
        if let Some(named) = &settings.long_drift {
            sheet.push(Box::new(long_drift::LongDrift::new(named, seed)));
        }
        if let Some(named) = &settings.crack {
            sheet.push(Box::new(crack::Crack(named.clone())));
        }
        if let Some(named) = &settings.contact_spread {
            contacts.push(Box::new(contact_spread::ContactSpread::new(
                named,
                stream(seed, "contact-spread"),
            )));
        }
        if let Some(named) = &settings.contact_drift {
            contacts.push(Box::new(contact_drift::ContactDrift::new(named, seed)));
        }
        if let Some(named) = &settings.detachment {
            contacts.push(Box::new(detachment::Detachment(named.clone())));
        }
        if let Some(named) = &settings.short {
            network.push(Box::new(short::Short(named.clone())));
        }
        if let Some(named) = &settings.isolation {
            network.push(Box::new(isolation::Isolation(named.clone())));
        }
        if let Some(named) = &settings.current_error {
            readings.push(Box::new(current_error::CurrentError(named.clone())));
        }
        if let Some(named) = &settings.current_noise {
            readings.push(Box::new(current_noise::CurrentNoise::new(
                named,
                stream(seed, "current-noise"),
            )));
        }
        if let Some(named) = &settings.output_resistance {
            readings.push(Box::new(output_resistance::OutputResistance(named.clone())));
        }
        if let Some(named) = &settings.source_settling {
            readings.push(Box::new(source_settling::SourceSettling(named.clone())));
        }
        if let Some(named) = &settings.charge_injection {
            readings.push(Box::new(charge_injection::ChargeInjection(named.clone())));
        }
        if let Some(named) = &settings.thermal_emf {
            readings.push(Box::new(thermal_emf::ThermalEmf::new(named, seed)));
        }
        if let Some(named) = &settings.channel_noise {
            readings.push(Box::new(channel_noise::ChannelNoise::new(named, seed)));
        }
        if let Some(named) = &settings.leakage {
            readings.push(Box::new(leakage::Leakage(named.clone())));
        }
        if let Some(named) = &settings.mains_pickup {
            readings.push(Box::new(mains_pickup::MainsPickup(named.clone())));
        }
        if let Some(named) = &settings.common_mode {
            readings.push(Box::new(common_mode::CommonMode(named.clone())));
        }
        if let Some(named) = &settings.input_resistance {
            readings.push(Box::new(input_resistance::InputResistance(named.clone())));
        }
        if let Some(named) = &settings.bias_current {
            readings.push(Box::new(bias_current::BiasCurrent(named.clone())));
        }
        if let Some(named) = &settings.voltmeter_gain {
            readings.push(Box::new(voltmeter_gain::VoltmeterGain(named.clone())));
        }
        if let Some(named) = &settings.autozero_off {
            readings.push(Box::new(autozero_off::AutozeroOff::new(
                named,
                stream(seed, "autozero-off"),
            )));
        }
        if let Some(named) = &settings.voltmeter_noise {
            readings.push(Box::new(voltmeter_noise::VoltmeterNoise::new(
                named,
                stream(seed, "voltmeter-noise"),
            )));
        }
        if let Some(named) = &settings.quantisation {
            readings.push(Box::new(quantisation::Quantisation::new(named)));
        }
        Self {
            sheet,
            contacts,
            network,
            readings,
        }
    }

    pub(crate) fn needs(&self) -> Needs {
        let any =
            |asks: fn(&dyn OnReading) -> bool| self.readings.iter().any(|effect| asks(&**effect));
        Needs {
            source_resistance: any(|effect| effect.needs_source_resistance()),
            load_resistance: any(|effect| effect.needs_load_resistance()),
        }
    }

    /// The epochs of all that acts on sheet, contacts and network, in order.
    pub(crate) fn epochs(&self, at: Duration) -> Vec<u64> {
        let sheet = self.sheet.iter().map(|effect| effect.epoch(at));
        let contacts = self.contacts.iter().map(|effect| effect.epoch(at));
        let network = self.network.iter().map(|effect| effect.epoch(at));
        sheet.chain(contacts).chain(network).collect()
    }

    pub(crate) fn reading(&mut self, exact: Volts, context: &ReadingContext) -> Volts {
        self.readings
            .iter_mut()
            .fold(exact, |volts, effect| effect.bend(volts, context))
    }
}

/// An effect's own random stream: switching one on never changes another's numbers.
fn stream(seed: u64, effect: &str) -> ChaCha8Rng {
    let mut hasher = Sha256::new();
    hasher.update(seed.to_le_bytes());
    hasher.update(effect.as_bytes());
    ChaCha8Rng::from_seed(hasher.finalize().into())
}

/// The voltmeter's resolution as a share of its range, by integration time (34970A family, integration-time table; the
/// fact sheet, section 2.1, takes it as rms noise): straight lines in log-log between the table's points.
fn resolution(nplc: f64) -> f64 {
    const TABLE: [[f64; 2]; 8] = [
        [0.02, 1e-4],
        [0.2, 1e-5],
        [1.0, 3e-6],
        [2.0, 2.2e-6],
        [10.0, 1e-6],
        [20.0, 8e-7],
        [100.0, 3e-7],
        [200.0, 2.2e-7],
    ];
    let nplc = nplc.clamp(TABLE[0][0], TABLE[TABLE.len() - 1][0]);
    let upper = TABLE
        .iter()
        .position(|[at, _]| *at >= nplc)
        .unwrap_or(TABLE.len() - 1);
    let [right, high] = TABLE[upper];
    if right == nplc {
        return high;
    }
    let [left, low] = TABLE[upper - 1];
    let share = (nplc / left).ln() / (right / left).ln();
    low * (high / low).powf(share)
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn context(range: f64, nplc: f64) -> ReadingContext {
        ReadingContext {
            at: Duration::ZERO,
            integration: Duration::from_secs_f64(nplc / 50.0),
            range: Volts(range),
            nplc,
            relay: None,
            flowing: Amps(1e-3),
            source_range: Amps(2e-3),
            since_change: Duration::from_secs_f64(nplc / 50.0 + 1e-3),
            source_resistance: Ohms(1e3),
            load_resistance: Ohms(1e3),
        }
    }

    #[test]
    fn nothing_asked_changes_no_bit() {
        let mut none = Effects::new(&EffectSettings::default(), 1);
        for volts in [0.0, -0.0, 1.0 / 3.0, -5e-324, 9.9e37] {
            let got = none.reading(Volts(volts), &context(1.0, 1.0));
            assert_eq!(got.0.to_bits(), volts.to_bits());
        }
    }

    #[test]
    fn another_effect_does_not_shift_the_noise() {
        let noise = VoltmeterNoiseSettings { uv: Some(2.0) };
        let both = EffectSettings {
            voltmeter_noise: Some(noise.clone()),
            quantisation: Some(QuantisationSettings { step_uv: Some(0.0) }),
            ..EffectSettings::default()
        };
        let alone = EffectSettings {
            voltmeter_noise: Some(noise),
            ..EffectSettings::default()
        };
        let draw = |settings: &EffectSettings, seed| -> Vec<u64> {
            let mut effects = Effects::new(settings, seed);
            (0..20)
                .map(|_| effects.reading(Volts(0.1), &context(1.0, 1.0)).0.to_bits())
                .collect()
        };
        assert_eq!(draw(&both, 7), draw(&alone, 7));
        assert_ne!(draw(&both, 7), draw(&both, 8));
    }

    #[test]
    fn the_table_is_met_and_joined() {
        assert_eq!(resolution(1.0), 3e-6);
        assert_eq!(resolution(0.001), 1e-4);
        assert_eq!(resolution(1000.0), 2.2e-7);
        let between = resolution(5.0);
        assert!(between < 2.2e-6 && between > 1e-6);
    }
}
