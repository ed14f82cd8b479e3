//! Imperfections of the simulated sheet and its wiring. None is active unless a scene names it. Each effect has one
//! file, with its physics, formula and source.
//!
//! An effect acts on the electrodes' positions, on the law from pressure to conductance, on the loss under loads, on
//! the sheet's conductance, on the contacts, on the network between the electrodes, on the wires to the instruments, or
//! on a reading. A scene has one list for each of these kinds, so an effect that is not named takes no computing time.
//! Each effect has its own random stream. Effects on sheet, contacts or network have an **epoch** that changes with
//! their state; while it is the same, the solution is reused.
//!
//! Compliance is not an effect: the simulated 6221 clamps at its own voltage limit.

mod acts;
mod autozero_off;
mod bias_current;
mod body_contact;
mod bounds;
mod channel_noise;
mod channel_resistance;
mod charge_injection;
mod common_mode;
mod contact_drift;
mod contact_spread;
mod crack;
mod creep;
mod crosstalk;
mod current_error;
mod current_noise;
mod detachment;
mod electrode_placement;
mod exponential_law;
mod foam;
mod gauge_law;
mod humidity;
mod hysteresis;
mod input_resistance;
mod isolation;
mod lead_resistance;
mod leakage;
mod log_law;
mod long_drift;
mod mains_pickup;
mod output_resistance;
mod power_law_creep;
mod quantisation;
mod relay_bounce;
mod response;
mod self_heating;
mod set;
mod short;
mod source_settling;
mod spray;
mod stretch;
mod temperature;
mod thermal_emf;
mod voltmeter_gain;
mod voltmeter_noise;
mod wander;
mod wear;

use std::fmt;
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use survey::Volts;

pub use acts::RelayContact;
pub(crate) use acts::{
    Added, OnContacts, OnLoss, OnMesh, OnNetwork, OnReading, OnSheet, OnWires, Places,
};
pub use bounds::Fault as ParameterFault;
use bounds::Parameters;
pub use creep::PronyStep;

pub(crate) use response::{SheetChange, SheetResponse, UnloadedReading};

use crate::law::{Conduction, Foam, Law, Pressure};
use crate::scan::ReadingContext;

/// Values of the reading's context that must be computed because an effect of the scene uses them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Needs {
    /// [`ReadingContext::source_resistance`].
    pub source_resistance: bool,
    /// [`ReadingContext::load_resistance`].
    pub load_resistance: bool,
}

impl Needs {
    const NONE: Self = Self {
        source_resistance: false,
        load_resistance: false,
    };
    const SOURCE_RESISTANCE: Self = Self {
        source_resistance: true,
        ..Self::NONE
    };
    const LOAD_RESISTANCE: Self = Self {
        load_resistance: true,
        ..Self::NONE
    };
}

/// An effect as named by a scene: its parameters, their ranges, its prediction and its action.
pub(crate) trait Effect: Parameters + fmt::Debug {
    /// The error for the first parameter that does not fit a sheet with this number of electrodes.
    fn check_on(&self, _electrodes: usize) -> Result<(), ParameterFault> {
        Ok(())
    }

    /// Predicted size: rms over the readings and frames of a scan, V, from formulas, without a simulation. For effects
    /// with random draws, the average over seeds.
    fn predict(&self, response: &dyn SheetResponse) -> f64;

    /// For an effect that is a fault: the event that the prediction assumes. A scene is complete without faults.
    fn assumes(&self) -> Option<String> {
        None
    }

    /// Adds the effect to the active ones, with its own random stream if it draws.
    fn add(&self, seed: u64, effects: &mut Effects);
}

/// Name, description, whether the scene names it, and the effect.
pub(crate) type EffectEntry = (&'static str, &'static str, bool, Box<dyn Effect>);

/// Generates everything that depends on the list of effects, in the order in which they act.
macro_rules! effects {
    ($(#[doc = $what:literal] $field:ident: $settings:ident = $name:literal;)+) => {
        /// The parameters of each effect.
        pub mod settings {
            $(pub use super::$field::$settings;)+
        }

        /// The effects that a scene names; the order of the fields is the order in which they act.
        #[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct EffectSettings {
            $(
                #[doc = $what]
                #[serde(rename = $name, skip_serializing_if = "Option::is_none")]
                pub $field: Option<settings::$settings>,
            )+
        }

        impl EffectSettings {
            /// Name in scenes and description of every effect.
            pub const ALL: &[(&str, &str)] = &[$(($name, $what)),+];

            /// Every effect with name, description, and whether the scene names it; effects that are not named have
            /// their default parameters.
            pub(crate) fn with_usual(&self) -> Vec<EffectEntry> {
                vec![$((
                    $name,
                    $what.trim_ascii(),
                    self.$field.is_some(),
                    Box::new(self.$field.clone().unwrap_or_default()),
                )),+]
            }

            /// The named effects, in order.
            fn named(&self) -> impl Iterator<Item = (&'static str, &dyn Effect)> {
                let all = [$(
                    ($name, self.$field.as_ref().map(|named| named as &dyn Effect)),
                )+];
                all.into_iter().filter_map(|(name, named)| Some((name, named?)))
            }
        }
    };
}

effects! {
    /// Errors of position and width of the electrodes.
    electrode_placement: ElectrodePlacementSettings = "electrode-placement";
    /// Stress-strain curve of the foam.
    foam: FoamSettings = "foam";
    /// Conductance under small strains.
    gauge_law: GaugeLawSettings = "gauge-law";
    /// Conductance under large strains.
    exponential_law: ExponentialLawSettings = "exponential-law";
    /// Conductance of a force-sensing film.
    log_law: LogLawSettings = "log-law";
    /// Hysteresis: more loss during unloading than during loading.
    hysteresis: HysteresisSettings = "hysteresis";
    /// Creep: a loss that grows under a constant load.
    creep: CreepSettings = "creep";
    /// Creep by a power law: a loss that grows by a power of time.
    power_law_creep: PowerLawCreepSettings = "power-law-creep";
    /// Permanent loss after many loads.
    set: SetSettings = "set";
    /// Lateral spread of the foam under a load.
    stretch: StretchSettings = "stretch";
    /// Heat of a body on the sheet.
    body_contact: BodyContactSettings = "body-contact";
    /// Uneven spraying of the sheet.
    spray: SpraySettings = "spray";
    /// Temperature of the sheet.
    temperature: TemperatureSettings = "temperature";
    /// Humidity of the foam.
    humidity: HumiditySettings = "humidity";
    /// Drift over hours to months.
    long_drift: LongDriftSettings = "long-drift";
    /// A crack in the sheet.
    crack: CrackSettings = "crack";
    /// Spread of the contact resistances.
    contact_spread: ContactSpreadSettings = "contact-spread";
    /// Drift of the contact resistances.
    contact_drift: ContactDriftSettings = "contact-drift";
    /// An electrode that detaches.
    detachment: DetachmentSettings = "detachment";
    /// A short between two electrodes.
    short: ShortSettings = "short";
    /// Leakage between wires.
    isolation: IsolationSettings = "isolation";
    /// Resistance of the relays and their paths.
    channel_resistance: ChannelResistanceSettings = "channel-resistance";
    /// Resistance of the source's wires.
    lead_resistance: LeadResistanceSettings = "lead-resistance";
    /// Relays that stick at the end of their life.
    wear: WearSettings = "wear";
    /// Heating of the sheet by the current.
    self_heating: SelfHeatingSettings = "self-heating";
    /// Gain and offset of the source.
    current_error: CurrentErrorSettings = "current-error";
    /// Noise of the source.
    current_noise: CurrentNoiseSettings = "current-noise";
    /// Output resistance of the source.
    output_resistance: OutputResistanceSettings = "output-resistance";
    /// Settling time of the current.
    source_settling: SourceSettlingSettings = "source-settling";
    /// Charge injected by switching relays.
    charge_injection: ChargeInjectionSettings = "charge-injection";
    /// Coupling from the driven wires into the measuring wires.
    crosstalk: CrosstalkSettings = "crosstalk";
    /// Thermal voltages of the relays.
    thermal_emf: ThermalEmfSettings = "thermal-emf";
    /// Channels noisier than the others.
    channel_noise: ChannelNoiseSettings = "channel-noise";
    /// Leakage current of a FET multiplexer.
    leakage: LeakageSettings = "leakage";
    /// Operate time and bounce of the relays.
    relay_bounce: RelayBounceSettings = "relay-bounce";
    /// Mains pickup in the leads.
    mains_pickup: MainsPickupSettings = "mains-pickup";
    /// Common-mode voltage of both leads.
    common_mode: CommonModeSettings = "common-mode";
    /// Input resistance of the voltmeter.
    input_resistance: InputResistanceSettings = "input-resistance";
    /// Bias current of the voltmeter's input.
    bias_current: BiasCurrentSettings = "bias-current";
    /// Gain and offset of the voltmeter.
    voltmeter_gain: VoltmeterGainSettings = "voltmeter-gain";
    /// Zero drift of a voltmeter without autozero.
    autozero_off: AutozeroOffSettings = "autozero-off";
    /// Noise of the voltmeter.
    voltmeter_noise: VoltmeterNoiseSettings = "voltmeter-noise";
    /// Steps of the voltmeter's converter.
    quantisation: QuantisationSettings = "quantisation";
}

impl EffectSettings {
    /// The names of the effects in the scene, in order.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.named().map(|(name, _)| name)
    }

    /// Checks the parameters of all named effects.
    ///
    /// # Errors
    /// The first parameter out of range: the effect's name in scenes, the key, and what is allowed.
    pub fn check(&self) -> Result<(), (&'static str, ParameterFault)> {
        self.named()
            .try_for_each(|(name, effect)| effect.check().map_err(|fault| (name, fault)))
    }

    /// Checks that every electrode named by an effect exists.
    ///
    /// # Errors
    /// As [`EffectSettings::check`].
    pub fn check_electrodes(
        &self,
        electrodes: usize,
    ) -> Result<(), (&'static str, ParameterFault)> {
        self.named().try_for_each(|(name, effect)| {
            effect.check_on(electrodes).map_err(|fault| (name, fault))
        })
    }
}

/// Pairs of effects that a scene cannot combine, and the reason.
const CONTRADICTING: [(&str, &str, &str); 5] = [
    (
        "gauge-law",
        "exponential-law",
        "both define the effect of a strain on the conductance",
    ),
    (
        "gauge-law",
        "log-law",
        "both define the effect of a load on the conductance",
    ),
    (
        "exponential-law",
        "log-law",
        "both define the effect of a load on the conductance",
    ),
    (
        "foam",
        "log-law",
        "the film uses the pressure itself, not a strain",
    ),
    (
        "creep",
        "power-law-creep",
        "both define how a loss grows under a constant load",
    ),
];

impl EffectSettings {
    /// The named effect that replaces the loss p / (p + p_half), if any.
    pub(crate) fn own_law(&self) -> Option<&'static str> {
        let laws = ["gauge-law", "exponential-law", "log-law"];
        self.named()
            .map(|(name, _)| name)
            .find(|name| laws.contains(name))
    }

    /// Two effects that exclude each other: the later one in the list, the other one, and the reason.
    pub(crate) fn contradiction(&self) -> Option<(&'static str, &'static str, &'static str)> {
        let named: Vec<&str> = self.named().map(|(name, _)| name).collect();
        CONTRADICTING
            .into_iter()
            .find(|(one, other, _)| named.contains(one) && named.contains(other))
            .map(|(one, other, why)| (other, one, why))
    }
}

/// The effects of a scene in one list for each quantity on which they act, in order.
#[derive(Debug, Default)]
pub(crate) struct Effects {
    pub(crate) mesh: Vec<Box<dyn OnMesh>>,
    foam: Option<Foam>,
    conduction: Option<Box<dyn Conduction>>,
    pub(crate) losses: Vec<Box<dyn OnLoss>>,
    pub(crate) sheet: Vec<Box<dyn OnSheet>>,
    pub(crate) contacts: Vec<Box<dyn OnContacts>>,
    pub(crate) network: Vec<Box<dyn OnNetwork>>,
    pub(crate) wires: Vec<Box<dyn OnWires>>,
    readings: Vec<Box<dyn OnReading>>,
}

impl Effects {
    pub(crate) fn new(settings: &EffectSettings, seed: u64) -> Self {
        let mut effects = Self::default();
        for (_, named) in settings.named() {
            named.add(seed, &mut effects);
        }
        effects
    }

    /// The conductance law for a pressure.
    pub(crate) fn law(&mut self, pressure: Pressure) -> Law {
        Law {
            pressure,
            foam: self.foam.take(),
            conduction: self.conduction.take(),
        }
    }

    pub(crate) fn needs(&self) -> Needs {
        let any = |asks: fn(Needs) -> bool| self.readings.iter().any(|effect| asks(effect.needs()));
        Needs {
            source_resistance: any(|needs| needs.source_resistance),
            load_resistance: any(|needs| needs.load_resistance),
        }
    }

    /// The epochs of all effects on sheet, contacts and network, in order.
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

/// The random stream of an effect. It depends on the seed and the effect's name only, so adding an effect does not
/// change the numbers of others.
fn stream(seed: u64, effect: &str) -> ChaCha8Rng {
    let mut hasher = Sha256::new();
    hasher.update(seed.to_le_bytes());
    hasher.update(effect.as_bytes());
    ChaCha8Rng::from_seed(hasher.finalize().into())
}

#[cfg(test)]
mod tests {
    use survey::{Amps, Ohms};

    use super::settings::{QuantisationSettings, VoltmeterNoiseSettings};
    use super::*;

    pub(super) fn context(range: f64, nplc: f64) -> ReadingContext {
        ReadingContext {
            at: Duration::ZERO,
            integration: survey::duration(nplc / 50.0),
            range: Volts(range),
            nplc,
            resolution: 3e-6,
            relay: None,
            flowing: Amps(1e-3),
            source_range: Amps(2e-3),
            since_change: survey::duration(nplc / 50.0 + 1e-3),
            source_resistance: Ohms(1e3),
            load_resistance: Ohms(1e3),
        }
    }

    #[test]
    fn absent_effects_change_no_bit() {
        let mut none = Effects::new(&EffectSettings::default(), 1);
        for volts in [0.0, -0.0, 1.0 / 3.0, -5e-324, 9.9e37] {
            let got = none.reading(Volts(volts), &context(1.0, 1.0));
            assert_eq!(got.0.to_bits(), volts.to_bits());
        }
    }

    /// Readings and solutions iterate over these lists only, so an absent effect needs not even a check.
    #[test]
    fn a_scene_calls_the_effects_that_it_names_and_nothing_else() {
        let calls = |settings: &EffectSettings| {
            let Effects {
                mesh,
                foam,
                conduction,
                losses,
                sheet,
                contacts,
                network,
                wires,
                readings,
            } = Effects::new(settings, 1);
            let lists = [
                (mesh.len(), mesh.capacity()),
                (losses.len(), losses.capacity()),
                (wires.len(), wires.capacity()),
                (sheet.len(), sheet.capacity()),
                (contacts.len(), contacts.capacity()),
                (network.len(), network.capacity()),
                (readings.len(), readings.capacity()),
            ];
            assert!(
                lists
                    .iter()
                    .all(|(len, capacity)| *len > 0 || *capacity == 0)
            );
            let laws = usize::from(foam.is_some()) + usize::from(conduction.is_some());
            lists.map(|(len, _)| len).iter().sum::<usize>() + laws
        };
        let none = EffectSettings::default();
        assert_eq!(calls(&none), 0);
        for (name, _) in EffectSettings::ALL {
            let scene = crate::Scene::open(&format!("effect-{name}")).unwrap();
            assert_eq!(calls(&scene.effects), 1, "{name}");
        }
        let torture = crate::Scene::open("torture").unwrap().effects;
        assert_eq!(calls(&torture), torture.names().count());
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
}
