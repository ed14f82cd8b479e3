//! Scenes: sheet, loads on a time line, effects, faults, seed. They are written in TOML; errors name file:line:column.

mod load_text;
#[cfg(test)]
mod tests;
mod unknown;

use std::ops::Range;
use std::time::Duration;

use eit::{DiscTank, PaperSheet, Preset};
use serde::Deserialize;
use survey::Electrode;
use toml::Spanned;

use crate::effects::{EffectSettings, Effects};
use crate::law::Pressure;
use crate::press::TimedLoad;
use crate::repeat::Repeat;
use load_text::LoadText;

/// Default fineness of the phantom's mesh relative to its preset.
pub const FINER: f64 = 1.5;

/// A fault of the instruments, with its times. The simulated instruments interpret the text.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneFault {
    /// Start.
    pub at: Duration,
    /// Duration; `None` for a fault that does not end, or that has no duration.
    pub lasts: Option<Duration>,
    /// Repetition; `None` if there is only one.
    pub repeat: Option<Repeat>,
    /// The fault, as text.
    pub what: String,
    /// Position of the text: `file:line:column`.
    pub place: String,
}

impl SceneFault {
    /// The time of each repetition, in order.
    pub fn moments(&self) -> impl Iterator<Item = Duration> + use<> {
        let (first, repeat) = (self.at, self.repeat);
        let times = repeat.map_or(1, Repeat::times);
        let delay = move |number| repeat.map_or(Duration::ZERO, |repeat| repeat.delay(number));
        (0..times).map(move |number| first.saturating_add(delay(number)))
    }
}

/// A simulated sheet with its loads, effects and faults.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Displayed name.
    pub name: String,
    /// Seed of every effect's random stream.
    pub seed: u64,
    /// The sheet with its resistance and contacts, with the fineness of the phantom's mesh.
    pub sheet: Preset,
    /// Properties of the foam.
    pub pressure: Pressure,
    /// The time line.
    pub loads: Vec<TimedLoad>,
    /// The effects; none unless named.
    pub effects: EffectSettings,
    /// Faults of the instruments, on the same time line.
    pub faults: Vec<SceneFault>,
    /// Electrodes with a separate contact resistance, ohm; 1e9 is practically detached.
    pub contacts: Vec<(Electrode, f64)>,
}

/// Why a text is not a valid scene: `file:line:column: what is wrong`.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{file}:{line}:{column}: {fault}")]
pub struct SceneError {
    /// The file's name.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// Column, from 1.
    pub column: usize,
    /// What is wrong.
    pub fault: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    name: Option<String>,
    #[serde(default)]
    seed: u64,
    #[serde(rename = "paper-sheet")]
    paper_sheet: Option<PaperSheet>,
    #[serde(rename = "disc-tank")]
    disc_tank: Option<Spanned<DiscTank>>,
    mesh: Option<Spanned<MeshText>>,
    pressure: Option<Spanned<PressureText>>,
    #[serde(default)]
    load: Vec<Spanned<LoadText>>,
    effects: Option<Spanned<EffectSettings>>,
    #[serde(default)]
    fault: Vec<FaultText>,
    #[serde(default)]
    contact: Vec<Spanned<ContactText>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ContactText {
    /// Number of the electrode, from 1.
    electrode: usize,
    ohm: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FaultText {
    at_s: Spanned<f64>,
    for_s: Option<Spanned<f64>>,
    repeat: Option<Spanned<RepeatText>>,
    what: Spanned<String>,
}

/// Repetition of a load or fault.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RepeatText {
    every_s: Spanned<f64>,
    times: Spanned<i64>,
}

impl RepeatText {
    /// The repetition, if its period is longer than the duration `lasts`.
    fn repeat(self, lasts: Duration, what: &str) -> Result<Repeat, Fault> {
        let every = *self.every_s.get_ref();
        let repeat = Repeat::new(every, *self.times.get_ref()).map_err(|refusal| {
            let at = match refusal.key {
                "times" => self.times.span(),
                _ => self.every_s.span(),
            };
            Fault(at, format!("repeat.{refusal}"))
        })?;
        if repeat.every() <= lasts {
            let lasts = lasts.as_secs_f64();
            let why =
                format!("repeat.every_s is {every}, it must be longer than {what} ({lasts} s)");
            return Err(Fault(self.every_s.span(), why));
        }
        Ok(repeat)
    }
}

/// The phantom's mesh, relative to the sheet's.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct MeshText {
    fineness: f64,
    seeding: u32,
}

impl Default for MeshText {
    fn default() -> Self {
        Self {
            fineness: FINER,
            seeding: 1,
        }
    }
}

#[derive(Deserialize, Default)]
#[serde(default, deny_unknown_fields)]
struct PressureText {
    half_kpa: Option<Spanned<f64>>,
    modulus_kpa: Option<Spanned<f64>>,
}

/// An error with its position in the text.
struct Fault(Range<usize>, String);

impl Scene {
    /// Reads a scene; the file's name is only used in messages. Defaults: the paper's sheet, no load, no effect, seed
    /// 0, a mesh 1.5 times finer than the sheet's.
    ///
    /// # Errors
    /// An unknown or missing key, or an invalid value, with its position.
    pub fn parse(file_name: &str, text: &str) -> Result<Self, SceneError> {
        let scene: Result<Text, _> = toml::from_str(text);
        scene
            .map_err(|fault| {
                if let Some((span, why)) = unknown::unknown_effect(text) {
                    return Fault(span, why);
                }
                let message = fault.message().trim().replace('\n', ", ");
                let hint = unknown::with_unit(&message);
                Fault(fault.span().unwrap_or(0..0), message + &hint)
            })
            .and_then(|scene| {
                scene.scene(text, |span| {
                    let (line, column) = survey::line_and_column(text, span.start);
                    format!("{file_name}:{line}:{column}")
                })
            })
            .map_err(|Fault(span, fault)| {
                let (line, column) = survey::line_and_column(text, span.start);
                SceneError {
                    file: file_name.to_owned(),
                    line,
                    column,
                    fault,
                }
            })
    }

    /// The paper's sheet without loads or effects.
    pub fn quiet() -> Self {
        Self {
            name: "quiet".to_owned(),
            seed: 0,
            sheet: Preset::default().remeshed(FINER, 1),
            pressure: Pressure::default(),
            loads: Vec::new(),
            effects: EffectSettings::default(),
            faults: Vec::new(),
            contacts: Vec::new(),
        }
    }
}

impl Text {
    fn scene(self, text: &str, place: impl Fn(&Range<usize>) -> String) -> Result<Scene, Fault> {
        let sheet = match (self.paper_sheet, self.disc_tank) {
            (Some(_), Some(tank)) => {
                return Err(Fault(
                    tank.span(),
                    "a scene has one sheet: paper-sheet or disc-tank, not both".to_owned(),
                ));
            }
            (sheet, None) => Preset::PaperSheet(sheet.unwrap_or_default()),
            (None, Some(tank)) => Preset::DiscTank(tank.into_inner()),
        };
        let (mesh_span, MeshText { fineness, seeding }) = spanned(self.mesh);
        if !(fineness > 0.0 && fineness.is_finite()) {
            return Err(Fault(
                mesh_span,
                format!("mesh.fineness is {fineness}, it must be a positive number"),
            ));
        }
        let (effects_span, effects) = spanned(self.effects);
        let pressure = pressure(self.pressure, &effects)?;
        let checked = effects
            .check()
            .and_then(|()| effects.check_electrodes(sheet.electrodes()));
        if let Err((effect, fault)) = checked {
            let span = key_span(text, &["effects", effect, fault.key]).unwrap_or(effects_span);
            let why = format!("effects.{effect}.{} {}", fault.key, fault.why);
            return Err(Fault(span, why));
        }
        if let Some((effect, other, why)) = effects.contradiction() {
            let span = key_span(text, &["effects", effect]).unwrap_or(effects_span);
            let why = format!("effects.{effect} contradicts effects.{other}: {why}");
            return Err(Fault(span, why));
        }
        let law = Effects::new(&effects, self.seed).law(pressure);
        let loads = self
            .load
            .into_iter()
            .enumerate()
            .map(|(index, load)| {
                let span = load.span();
                load.into_inner().load(index, span, &law, &sheet)
            })
            .collect::<Result<_, _>>()?;
        let faults = self
            .fault
            .into_iter()
            .map(|fault| {
                let lasts = moment(fault.for_s.as_ref(), "for_s")?;
                let repeat = fault.repeat.map(|repeat| {
                    let lasts = lasts.unwrap_or_default();
                    repeat.into_inner().repeat(lasts, "the fault lasts")
                });
                Ok(SceneFault {
                    at: moment(Some(&fault.at_s), "at_s")?.unwrap_or_default(),
                    lasts,
                    repeat: repeat.transpose()?,
                    place: place(&fault.what.span()),
                    what: fault.what.into_inner(),
                })
            })
            .collect::<Result<_, _>>()?;
        let electrodes = sheet.contact_ohm_m().len();
        let contacts = self
            .contact
            .into_iter()
            .map(|contact| {
                let span = contact.span();
                let ContactText { electrode, ohm } = contact.into_inner();
                if !(ohm >= 0.0 && ohm.is_finite()) {
                    return Err(Fault(
                        span,
                        format!("a contact of {ohm} ohm is not possible"),
                    ));
                }
                Electrode::from_number(electrode)
                    .filter(|electrode| electrode.0 < electrodes)
                    .map(|electrode| (electrode, ohm))
                    .ok_or_else(|| {
                        let text = format!(
                            "there is no electrode {electrode}, the sheet has {electrodes}"
                        );
                        Fault(span, text)
                    })
            })
            .collect::<Result<_, _>>()?;
        Ok(Scene {
            name: self.name.unwrap_or_else(|| "unnamed".to_owned()),
            seed: self.seed,
            sheet: sheet.remeshed(fineness, seeding),
            pressure,
            loads,
            effects,
            faults,
            contacts,
        })
    }
}

/// The table `[pressure]`, or its default.
fn pressure(
    text: Option<Spanned<PressureText>>,
    effects: &EffectSettings,
) -> Result<Pressure, Fault> {
    let (_, text) = spanned(text);
    let default = Pressure::default();
    let positive = |given: &Option<Spanned<f64>>, key: &str, default: f64| match given {
        Some(value) if !(*value.get_ref() > 0.0 && value.get_ref().is_finite()) => Err(Fault(
            value.span(),
            format!(
                "pressure.{key} is {}, it must be a positive number",
                value.get_ref()
            ),
        )),
        Some(value) => Ok(*value.get_ref()),
        None => Ok(default),
    };
    if let (Some(half), Some(law)) = (&text.half_kpa, effects.own_law()) {
        let why = format!(
            "pressure.half_kpa contradicts effects.{law}: both define the effect of a load on the conductance"
        );
        return Err(Fault(half.span(), why));
    }
    Ok(Pressure {
        half_kpa: positive(&text.half_kpa, "half_kpa", default.half_kpa)?,
        modulus_kpa: positive(&text.modulus_kpa, "modulus_kpa", default.modulus_kpa)?,
    })
}

/// Position of a key's value in the text.
fn key_span(text: &str, path: &[&str]) -> Option<Range<usize>> {
    let (last, tables) = path.split_last()?;
    let whole = toml::de::DeTable::parse(text).ok()?;
    let mut table = whole.get_ref();
    for name in tables {
        table = table.get(*name)?.get_ref().as_table()?;
    }
    table.get(*last).map(Spanned::span)
}

/// A value and its position in the text, or its default.
fn spanned<T: Default>(value: Option<Spanned<T>>) -> (Range<usize>, T) {
    value.map_or_else(
        || (0..0, T::default()),
        |value| (value.span(), value.into_inner()),
    )
}

fn moment(seconds: Option<&Spanned<f64>>, key: &str) -> Result<Option<Duration>, Fault> {
    seconds
        .map(|seconds| {
            Duration::try_from_secs_f64(*seconds.get_ref()).map_err(|_| {
                Fault(
                    seconds.span(),
                    format!(
                        "{key} is {}, it must be zero or more seconds",
                        seconds.get_ref()
                    ),
                )
            })
        })
        .transpose()
}
