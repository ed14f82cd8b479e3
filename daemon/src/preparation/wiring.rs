//! Resolves the configured wiring: relays, modules, their limits and timing.

use std::collections::BTreeMap;
use std::path::Path;

use keysight_34980a::{MapError, Module};
use serde::Deserialize;
use survey::{Limits, Relay, RelayTable, Sensing, Timing, Transition, Wiring};

use crate::instruments::kinds;
use crate::preparation::Findings;
use config::{Config, WiringKind};
use survey::error_chain as chain;

/// A wiring with its modules.
#[derive(Debug, Clone)]
pub(super) struct WiringWithModules {
    pub wiring: Wiring,
    /// Modules by slot; empty for the multiplexer board.
    pub modules: BTreeMap<u32, Module>,
    pub limits: Limits,
}

/// A wiring file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WiringFile {
    name: String,
    sensing: Sensing,
    transition: Transition,
    /// Slot to module.
    modules: BTreeMap<String, String>,
    inject: Vec<Vec<u32>>,
    measure: Vec<Vec<u32>>,
    #[serde(default)]
    bus: Vec<u32>,
}

/// The wiring of a configuration.
pub(super) fn resolve_wiring(
    config: &Config,
    electrodes: usize,
    findings: &mut Findings<'_>,
) -> Option<WiringWithModules> {
    let section = &config.wiring;
    let slot = section.slot;
    let inject_slot = section.inject_slot.unwrap_or(slot + 1);
    for (key, given, kind) in [
        (
            "wiring.inject_slot",
            section.inject_slot.is_some(),
            WiringKind::Fast34925a,
        ),
        ("wiring.file", section.file.is_some(), WiringKind::File),
    ] {
        if given && section.kind != kind {
            let name = name(kind);
            findings.add(
                key,
                format!("only wiring.kind = \"{name}\" has one; delete this key"),
            );
        }
    }
    let outcome = match section.kind {
        WiringKind::File => {
            let Some(path) = &section.file else {
                findings.add("wiring", "kind = \"file\" needs file = \"PATH\"");
                return None;
            };
            return findings.value_or_problem("wiring.file", from_file(path));
        }
        WiringKind::Pairs34924a => keysight_34980a::pairs_34924a(slot, electrodes),
        WiringKind::Pairs34922a => keysight_34980a::pairs_34922a(slot, electrodes),
        WiringKind::Fast34925a => keysight_34980a::fast_34925a(slot, inject_slot, electrodes),
        WiringKind::Matrix34932a => keysight_34980a::matrix_34932a(slot, electrodes),
        WiringKind::Matrix34934a => keysight_34980a::matrix_34934a(slot, electrodes),
        WiringKind::GpioBoard => gpio_mux::wiring(electrodes).map_err(MapError::from),
    };
    let wiring = findings.value_or_problem("wiring", outcome.map_err(|cause| chain(&cause)))?;
    let modules = modules(section.kind, slot, inject_slot);
    Some(WiringWithModules {
        limits: kinds::limits(&modules),
        wiring,
        modules,
    })
}

/// The name of the wiring in a configuration, which is also the name of the matching shipped profile.
pub(super) fn name(kind: WiringKind) -> &'static str {
    match kind {
        WiringKind::Pairs34924a => "pairs-34924a",
        WiringKind::Pairs34922a => "pairs-34922a",
        WiringKind::Fast34925a => "fast-34925a",
        WiringKind::Matrix34932a => "matrix-34932a",
        WiringKind::Matrix34934a => "matrix-34934a",
        WiringKind::GpioBoard => "gpio-board",
        WiringKind::File => "file",
    }
}

fn modules(kind: WiringKind, slot: u32, inject_slot: u32) -> BTreeMap<u32, Module> {
    let reported: &[(u32, &str)] = match kind {
        WiringKind::Pairs34924a => &[(slot, "34924A")],
        WiringKind::Pairs34922a => &[(slot, "34922A")],
        WiringKind::Fast34925a => &[(slot, "34925A"), (inject_slot, "34924A")],
        WiringKind::Matrix34932a => &[(slot, "34932A")],
        WiringKind::Matrix34934a => &[(slot, "34934A,4x128")],
        WiringKind::GpioBoard | WiringKind::File => &[],
    };
    reported
        .iter()
        .filter_map(|(slot, module)| Some((*slot, module.parse().ok()?)))
        .collect()
}

fn from_file(path: &Path) -> Result<WiringWithModules, String> {
    let named = |text: String| format!("{}: {text}", path.display());
    let text =
        std::fs::read_to_string(path).map_err(|cause| named(format!("cannot be read: {cause}")))?;
    let document: WiringFile = toml::from_str(&text).map_err(|fault| {
        let (line, _) = survey::line_and_column(&text, fault.span().map_or(0, |span| span.start));
        format!("{}:{line}: {}", path.display(), fault.message())
    })?;
    let mut modules = BTreeMap::new();
    for (slot, module) in &document.modules {
        let number = slot.parse().ok().filter(|slot| (1..=8).contains(slot));
        let number = number
            .ok_or_else(|| named(format!("modules: '{slot}' is no slot, slots are 1 to 8")))?;
        let module: Module = module.parse().map_err(|cause| named(chain(&cause)))?;
        modules.insert(number, module);
    }
    if modules.is_empty() {
        return Err(named(
            "modules: name the module of each slot, such as 1 = \"34924A\"".to_owned(),
        ));
    }
    let relays = |pairs: Vec<Vec<u32>>| {
        let relays = |pair: Vec<u32>| pair.into_iter().map(Relay).collect();
        pairs.into_iter().map(relays).collect()
    };
    let wiring = Wiring::from_table(RelayTable {
        name: document.name,
        sensing: document.sensing,
        transition: document.transition,
        inject: relays(document.inject),
        measure: relays(document.measure),
        bus: document.bus.into_iter().map(Relay).collect(),
    })
    .map_err(|cause| named(chain(&cause)))?;
    let wired = WiringWithModules {
        limits: kinds::limits(&modules),
        wiring,
        modules,
    };
    match wired.unserved_relay(&wired.modules) {
        None => Ok(wired),
        Some(lacking) => Err(named(lacking)),
    }
}

impl WiringWithModules {
    /// Timing of the wiring on its instruments.
    pub(super) fn timing(&self, nplc: f64, line_hz: f64) -> Timing {
        kinds::timing(&self.wiring, &self.modules, nplc, line_hz)
    }

    /// The first relay that these modules cannot serve, with slot, module, channel and electrodes; `None` if all fit.
    /// The driver makes the same check with real modules.
    pub(super) fn unserved_relay(&self, modules: &BTreeMap<u32, Module>) -> Option<String> {
        let scanned = self.wiring.sensing == Sensing::Scan;
        let measuring = self.wiring.measuring_relays();
        let moved = self.wiring.injecting_relays().into_iter();
        let moved = moved.chain(self.wiring.bus.iter().copied());
        moved
            .map(|relay| (relay, false))
            .chain(measuring.into_iter().map(|relay| (relay, scanned)))
            .find_map(|(relay, scanned)| {
                let purpose = self.wiring.purpose(relay);
                let Some((slot, channel)) = keysight_34980a::split(relay) else {
                    return Some(format!("no slot has relay {relay}, which {purpose}"));
                };
                let Some(module) = modules.get(&slot) else {
                    return Some(format!("slot {slot} is empty, and relay {relay} {purpose}"));
                };
                if module.contact(channel).is_none() {
                    return Some(format!(
                        "the {module} in slot {slot} has no channel {channel}: relay {relay} {purpose}"
                    ));
                }
                (scanned && !module.scannable(channel)).then(|| {
                    format!(
                        "channel {channel} of the {module} in slot {slot} cannot be scanned: relay {relay} {purpose}"
                    )
                })
            })
    }
}
