//! Bounds of every numeric key and of texts, checked before anything is calculated; units are in the keys' names.
//! Combinations of keys are checked by the daemon's preparation.

use survey::Bounds::{self, Above, Between, Within};
use toml::de::{DeTable, DeValue};

pub use crate::bounds::COUNT;
use crate::bounds::FOR_S;
use crate::{
    ArchiveSection, BusSection, MqttSection, NotifySection, RecordSection, RecordingSection,
    RelayWearSection, ScheduleSection, SurveySection, WiringSection,
};

const ANSWER_MS: Bounds = Within(1.0, 600e3);
const LENGTH_MM: Bounds = Within(0.01, 10e3);
const OHM: Bounds = Within(1e-6, 1e12);
const EDGES: Bounds = Within(1.0, 64.0);
const SEEDING: Bounds = Within(0.0, u32::MAX as f64);
const FINENESS: Bounds = Within(0.25, 8.0);
const GROWTH: Bounds = Within(0.001, 10.0);
const LIMIT: Bounds = Within(-1e9, 1e9);

/// Numeric keys that are not those of a section of this crate: of instruments, of sheets and reconstructions, of alarms.
const OTHERS: &[(&str, Bounds)] = &[
    ("source.deadline_ms", ANSWER_MS),
    ("switch.deadline_ms", ANSWER_MS),
    ("voltmeter.deadline_ms", ANSWER_MS),
    ("geometry.paper-sheet.width_mm", LENGTH_MM),
    ("geometry.paper-sheet.height_mm", LENGTH_MM),
    (
        "geometry.paper-sheet.electrodes_per_width",
        Within(1.0, 64.0),
    ),
    (
        "geometry.paper-sheet.electrodes_per_height",
        Within(1.0, 64.0),
    ),
    ("geometry.paper-sheet.void_mm", LENGTH_MM),
    ("geometry.paper-sheet.inset_mm", LENGTH_MM),
    ("geometry.paper-sheet.region_half_width_mm", LENGTH_MM),
    ("geometry.paper-sheet.region_half_height_mm", LENGTH_MM),
    ("geometry.paper-sheet.fineness", FINENESS),
    ("geometry.paper-sheet.edge_mm", LENGTH_MM),
    ("geometry.paper-sheet.largest_mm", LENGTH_MM),
    ("geometry.paper-sheet.growth", GROWTH),
    ("geometry.paper-sheet.seeding", SEEDING),
    ("geometry.paper-sheet.sheet_ohm", OHM),
    ("geometry.paper-sheet.contact_ohm", OHM),
    ("geometry.disc-tank.radius_mm", LENGTH_MM),
    ("geometry.disc-tank.electrodes", Within(2.0, 256.0)),
    ("geometry.disc-tank.arc_deg", Between(0.0, 360.0)),
    ("geometry.disc-tank.first_deg", Within(-360.0, 360.0)),
    ("geometry.disc-tank.fineness", FINENESS),
    ("geometry.disc-tank.electrode_edges", EDGES),
    ("geometry.disc-tank.largest_share", Within(0.005, 0.5)),
    ("geometry.disc-tank.growth", GROWTH),
    ("geometry.disc-tank.seeding", SEEDING),
    ("geometry.disc-tank.sheet_ohm", OHM),
    ("geometry.disc-tank.contact_ohm", OHM),
    ("geometry.depth.depth_mm", LENGTH_MM),
    ("geometry.depth.electrode_height_mm", LENGTH_MM),
    ("geometry.depth.electrode_centre_mm", LENGTH_MM),
    ("geometry.depth.target_height_mm", LENGTH_MM),
    ("geometry.depth.modes", Within(1.0, 400.0)),
    ("model.exponent", Within(0.0, 10.0)),
    ("model.length_mm", LENGTH_MM),
    ("model.noise_uv", Within(1e-6, 1e9)),
    ("model.lambda", Above(0.0, 1e30)),
    ("model.noise_figure", Above(0.0, 1e6)),
    ("model.map_error", Between(0.0, 1.0)),
    ("model.gap", Between(0.0, 1.0)),
    ("model.map_every", Within(1.0, 1e6)),
    ("quantities.threshold_kpa", Above(0.0, 1e4)),
    ("quantities.threshold_percent", Above(0.0, 100.0)),
    ("quantities.window_cm2", Above(0.0, 1e4)),
    ("quantities.relief_s", FOR_S),
    ("quantities.unrelieved_h", Above(0.0, 8766.0)),
    ("quantities.hold_s", FOR_S),
    ("alarm.above", LIMIT),
    ("alarm.below", LIMIT),
    ("alarm.deadband", Within(0.0, 1e9)),
    ("alarm.for_s", Within(0.0, 604_800.0)),
];

/// Every numeric key of the configuration, with its bounds.
pub fn keys() -> impl Iterator<Item = (&'static str, Bounds)> {
    let sections = [
        RecordingSection::BOUNDS,
        WiringSection::BOUNDS,
        SurveySection::BOUNDS,
        OTHERS,
        RecordSection::BOUNDS,
        BusSection::BOUNDS,
        ScheduleSection::BOUNDS,
        RelayWearSection::BOUNDS,
        NotifySection::BOUNDS,
        ArchiveSection::BOUNDS,
        MqttSection::BOUNDS,
    ];
    sections.into_iter().flatten().copied()
}

/// Longest free text, bytes: a note, or a description of sheet, foam, ink and operator.
pub const LONGEST_TEXT: usize = 4096;

/// Removes every number that is out of its bounds, so that its default is used while the rest is read; returns the
/// position and the problem of each.
pub fn take_out(table: &mut DeTable<'_>) -> Vec<(std::ops::Range<usize>, String)> {
    let mut found = Vec::new();
    take_out_below(table, "", &mut found);
    found
}

fn take_out_below(
    table: &mut DeTable<'_>,
    above: &str,
    found: &mut Vec<(std::ops::Range<usize>, String)>,
) {
    let mut bad = Vec::new();
    for (name, value) in table.iter_mut() {
        let key = format!("{above}{}", name.get_ref());
        let span = value.span();
        let number = match value.get_mut() {
            DeValue::Table(inner) => {
                take_out_below(inner, &format!("{key}."), found);
                continue;
            }
            DeValue::Array(entries) => {
                for entry in entries.iter_mut() {
                    if let DeValue::Table(inner) = entry.get_mut() {
                        take_out_below(inner, &format!("{key}."), found);
                    }
                }
                continue;
            }
            // an integer of more than 128 bits is out of all bounds
            DeValue::Integer(whole) => i128::from_str_radix(whole.as_str(), whole.radix())
                .map_or(f64::INFINITY, |whole| whole as f64),
            DeValue::Float(number) => number.as_str().parse().unwrap_or(f64::NAN),
            _ => continue,
        };
        if let Some(Err(error)) = allowed(&key).map(|bounds| bounds.check(number)) {
            found.push((span, format!("{key}: {error}")));
            bad.push(name.clone());
        }
    }
    for name in bad {
        table.remove(&name);
    }
}

/// The bounds of a numeric key.
pub fn allowed(key: &str) -> Option<Bounds> {
    let (_, bounds) = keys().find(|(known, _)| *known == key)?;
    Some(bounds)
}

/// The problem of a free text that is too long.
pub fn too_long(text: &str) -> Option<String> {
    let length = text.len();
    (length > LONGEST_TEXT)
        .then(|| format!("has {length} bytes; it must have {LONGEST_TEXT} at most"))
}

#[cfg(test)]
mod tests;
