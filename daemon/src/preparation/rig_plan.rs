//! Derives the plan of a frame, its limits, and the addresses of the instruments from the configuration.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use keysight_34980a::Module;
use rig::MeterSettings;
use survey::{Measurement, Plan, PlanError, Protocol, RangeRule, Volts, WiringError, duration};

use crate::instruments::address::InstrumentAddress;
use crate::instruments::kinds;
use crate::instruments::rig_plan::{InstrumentAddresses, RigPlan};
use crate::instruments::simulation::{self, Profile, Scene};
use crate::preparation::Findings;
use crate::preparation::wiring;
use crate::preparation::wiring::WiringWithModules;
use config::{Config, EnableName, InstrumentSection, RangesName, RigKind, WiringKind};
use imaging::Geometry;
use survey::error_chain as chain;

/// The plan of the rig, checked against its limits.
pub(super) fn rig_plan(
    config: &Config,
    protocol: &Protocol,
    geometry: Option<&Geometry>,
    findings: &mut Findings<'_>,
) -> Option<RigPlan> {
    let survey = &config.survey;
    let electrodes = config.wiring.electrodes.unwrap_or(protocol.electrodes());
    let wired = wiring::resolve_wiring(config, electrodes, findings);
    let places = places(config, findings);
    let simulation = match config.rig.kind {
        RigKind::Simulated | RigKind::Mixed => {
            let simulated = simulated(config, findings);
            if let (Some((profile, _)), Some(wired), Some(places)) = (&simulated, &wired, &places) {
                fits(config, profile, wired, places, findings);
            }
            Some(simulated)
        }
        RigKind::Instruments | RigKind::Recording => {
            for (key, given) in [
                ("rig.profile", &config.rig.profile),
                ("rig.scene", &config.rig.scene),
            ] {
                if given.is_some() {
                    findings.add(
                        key,
                        "only a simulated rig has one; delete this key, or set rig.kind = \"simulated\"",
                    );
                }
            }
            None
        }
    };
    let mut wired = wired?;
    wired.wiring = wired.wiring.joining(protocol);
    if survey.chained {
        if config.wiring.kind == WiringKind::GpioBoard {
            findings.add(
                "survey.chained",
                "the board and the voltmeter are two instruments; no message can reach both",
            );
        }
        wired.wiring = wired.wiring.chained();
    }
    let plan =
        Plan::injecting(protocol, &wired.wiring, survey.injection()).map_err(|cause| match cause {
            PlanError::Wiring(WiringError::Electrodes {
                wiring,
                wired,
                requested,
            }) => (
                "wiring.electrodes",
                format!("wiring '{wiring}' has {wired} electrodes, the survey has {requested}"),
            ),
            other => ("survey", chain(&other)),
        });
    let plan = match plan {
        Ok(plan) => plan,
        Err((key, text)) => {
            findings.add(key, text);
            return None;
        }
    };
    let limits = wired.limits;
    let timing = survey.timing(wired.timing(survey.nplc, survey.line_hz));
    if let Err(faults) = plan.check(&limits) {
        for fault in faults {
            let key = match fault {
                PlanError::NotACurrent(_)
                | PlanError::SourceCurrent { .. }
                | PlanError::RelayCurrent { .. } => "survey.current_ua",
                PlanError::Compliance { .. } | PlanError::RelayVoltage { .. } => {
                    "survey.compliance_v"
                }
                _ => "survey",
            };
            findings.add(key, chain(&fault));
        }
        return None;
    }
    let ranges = (survey.ranges == RangesName::Planned).then(|| RangeRule {
        available: kinds::RANGES.map(Volts).to_vec(),
        margin: survey.range_margin,
    });
    let plan = match (&ranges, geometry) {
        (Some(rule), Some(geometry)) => {
            let expected = expected(&plan, geometry);
            let expected = findings.value_or_problem("survey.ranges", expected)?;
            plan.with_ranges(rule, |measurement| expected.get(&measurement).copied())
        }
        _ => plan,
    };
    let deadline_of_scan = plan.longest_answer(&timing);
    let simulation = match simulation {
        Some(simulation) => Some(simulation?),
        None => None,
    };
    Some(RigPlan {
        plan,
        limits,
        timing,
        meter: MeterSettings {
            resolution: kinds::resolution(survey.nplc),
            deadline: Some(deadline_of_scan),
            ..MeterSettings::timed(Volts(survey.range_v), &timing)
        },
        ranges,
        zero_every: survey.zero_every,
        skip: survey.skip,
        half: survey.half,
        modules: wired.modules,
        instruments: places?,
        simulation,
    })
}

/// The expected reading of every pair on the configured sheet at the plan's current.
fn expected(plan: &Plan, geometry: &Geometry) -> Result<BTreeMap<Measurement, Volts>, String> {
    let drives = plan.protocol.drives();
    let senses = plan.wiring.measure.iter().map(|(sense, _)| *sense);
    let measurements: Vec<Measurement> = drives
        .into_iter()
        .flat_map(|drive| {
            senses
                .clone()
                .map(move |sense| Measurement { drive, sense })
        })
        .collect();
    let all =
        Protocol::new(plan.protocol.electrodes(), measurements).map_err(|cause| chain(&cause))?;
    let forward = eit::Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m)
        .map_err(|cause| chain(&cause))?;
    let at_one_amp = forward
        .readings(&geometry.sigma0, &all)
        .map_err(|cause| chain(&cause))?;
    let measurements = all.measurements().iter().copied();
    Ok(measurements
        .zip(at_one_amp.iter().map(|volts| Volts(volts * plan.current.0)))
        .collect())
}

fn simulated(config: &Config, findings: &mut Findings<'_>) -> Option<(Profile, Scene)> {
    findings.value_or_problem("rig.kind", simulation::check_built())?;
    let profile = findings.value_or_problem(
        "rig.profile",
        Profile::load(profile_name(config)).map_err(|cause| chain(&cause)),
    );
    let scene = findings.value_or_problem(
        "rig.scene",
        simulation::load_scene(config.rig.scene.as_deref()),
    );
    Some((profile?, scene?))
}

fn profile_name(config: &Config) -> &str {
    let own = match config.wiring.kind {
        WiringKind::File => "pairs-34924a",
        kind => wiring::name(kind),
    };
    config.rig.profile.as_deref().unwrap_or(own)
}

/// Whether the simulated instruments have the modules of the wiring; real ones are checked when they are connected.
fn fits(
    config: &Config,
    profile: &Profile,
    wired: &WiringWithModules,
    places: &InstrumentAddresses,
    findings: &mut Findings<'_>,
) {
    if places.switch.0 != InstrumentAddress::Simulated {
        return;
    }
    let key = if config.rig.profile.is_some() {
        "rig.profile"
    } else {
        "wiring"
    };
    let (name, own) = (profile_name(config), wiring::name(config.wiring.kind));
    if config.wiring.kind == WiringKind::GpioBoard {
        if profile.board.is_none() {
            findings.add(
                key,
                format!(
                    "wiring {own} needs the multiplexer board, profile {name} has none; use profile = \"{own}\" or add \
                     [board] to it"
                ),
            );
        }
        return;
    }
    let modules: BTreeMap<u32, Module> = (1..)
        .zip(profile.slots)
        .filter_map(|(slot, module)| Some((slot, module?)))
        .collect();
    let other = || {
        let (slot, planned) = wired
            .modules
            .iter()
            .find(|(slot, planned)| modules.get(slot) != Some(planned))?;
        let found = modules.get(slot)?;
        Some(format!(
            "slot {slot} holds a {found}, the wiring is made for a {planned}"
        ))
    };
    if let Some(lacking) = wired.unserved_relay(&modules).or_else(other) {
        let board = match profile.board {
            Some(_) => "; for its board set wiring.kind = \"gpio-board\"",
            None => "",
        };
        let advice = match config.wiring.kind {
            WiringKind::File => "name a profile with the modules of the wiring file".to_owned(),
            _ => format!(
                "use profile = \"{own}\" (its module is in slot 1), or a wiring and slot that the profile has{board}"
            ),
        };
        findings.add(
            key,
            format!(
                "profile {name} does not fit wiring {own} in slot {}: {lacking}; {advice}",
                config.wiring.slot
            ),
        );
    }
}

/// Default timeout of a reply; the time for readings is added.
const ANSWER: Duration = Duration::from_secs(5);

fn deadline(given_ms: Option<f64>) -> Duration {
    given_ms.map_or(ANSWER, |given_ms| duration(given_ms * 1e-3))
}

fn places(config: &Config, findings: &mut Findings<'_>) -> Option<InstrumentAddresses> {
    // without a board, the same mainframe switches and measures
    let mainframe =
        config.rig.kind != RigKind::Simulated && config.wiring.kind != WiringKind::GpioBoard;
    let voltmeter = match &config.voltmeter {
        None if mainframe => &config.switch,
        given => given,
    };
    let sections = [
        ("source", &config.source),
        ("switch", &config.switch),
        ("voltmeter", voltmeter),
    ];
    if config.rig.kind == RigKind::Simulated {
        for (name, section) in sections {
            if section.is_some() {
                findings.add(
                    name,
                    "a simulated rig has no addresses; set rig.kind to \"instruments\" or \"mixed\"",
                );
            }
        }
        let memory = (InstrumentAddress::Simulated, deadline(None));
        return Some(InstrumentAddresses {
            source: memory.clone(),
            switch: memory.clone(),
            voltmeter: memory,
            enable: EnableName::Low,
        });
    }
    let shared = mainframe.then(|| one_deadline(config, findings)).flatten();
    let mut read = sections.into_iter().map(|(name, section)| {
        let Some(section) = section else {
            if name == "voltmeter" && mainframe {
                // the missing [switch] has been reported
                return None;
            }
            findings.add(name, format!("the rig has no [{name}]; give its address"));
            return None;
        };
        match section.address.parse::<InstrumentAddress>() {
            Ok(InstrumentAddress::Simulated) if config.rig.kind == RigKind::Instruments => {
                findings.add(
                    &format!("{name}.address"),
                    "a simulated instrument in a rig of instruments; set rig.kind = \"mixed\" if this is intended",
                );
                None
            }
            Ok(InstrumentAddress::Gpiochip { .. })
                if name != "switch" || config.wiring.kind != WiringKind::GpioBoard =>
            {
                findings.add(
                    &format!("{name}.address"),
                    "only the [switch] of wiring.kind = \"gpio-board\" can be on a gpiochip",
                );
                None
            }
            Ok(InstrumentAddress::Gpiochip { .. }) if section.deadline_ms.is_some() => {
                findings.add(
                    &format!("{name}.deadline_ms"),
                    "the lines of a gpiochip are set at once, without a reply; delete this key",
                );
                None
            }
            Ok(place) => {
                let own = section.deadline_ms;
                let given = if name == "source" { own } else { shared.or(own) };
                Some((place, deadline(given)))
            }
            Err(error) => {
                findings.add(&format!("{name}.address"), error.to_string());
                None
            }
        }
    });
    let (source, switch, voltmeter) = (read.next()?, read.next()?, read.next()?);
    let places = InstrumentAddresses {
        source: source?,
        switch: switch?,
        voltmeter: voltmeter?,
        enable: enable(config, findings),
    };
    if config.wiring.kind != WiringKind::GpioBoard && places.switch.0 != places.voltmeter.0 {
        findings.add(
            "voltmeter.address",
            "this wiring switches with the mainframe whose voltmeter measures: give both the same address",
        );
        return None;
    }
    Some(places)
}

/// The timeout of a mainframe that both switches and measures, in ms, from either section.
fn one_deadline(config: &Config, findings: &mut Findings<'_>) -> Option<f64> {
    let of = |section: &Option<InstrumentSection>| section.as_ref()?.deadline_ms;
    let (switch, voltmeter) = (of(&config.switch), of(&config.voltmeter));
    if let (Some(switch), Some(voltmeter)) = (switch, voltmeter)
        && switch != voltmeter
    {
        findings.add(
            "switch.deadline_ms",
            format!(
                "{switch} here and {voltmeter} in [voltmeter], which is the same instrument; set it once"
            ),
        );
    }
    voltmeter.or(switch)
}

/// The level that enables a multiplexer chip, for a board on a gpiochip: low by default.
fn enable(config: &Config, findings: &mut Findings<'_>) -> EnableName {
    let sections = [
        ("source", &config.source),
        ("switch", &config.switch),
        ("voltmeter", &config.voltmeter),
    ];
    let mut enable = EnableName::Low;
    for (name, section) in sections {
        let Some(section) = section else { continue };
        let Some(given) = section.enable else {
            continue;
        };
        if section.address.starts_with("gpiochip:") {
            enable = given;
        } else {
            findings.add(
                &format!("{name}.enable"),
                "only a board on a gpiochip has one; delete this key",
            );
        }
    }
    enable
}

#[cfg(test)]
mod tests {
    use crate::preparation::rig_plan::*;
    use crate::preparation::{FramesFrom, prepare};

    /// Timeouts of source, switch and voltmeter for these keys in their sections, or the problems.
    fn deadlines(source: &str, switch: &str, voltmeter: &str) -> Result<[Duration; 3], String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        let config = format!(
            "[rig]\nkind = \"instruments\"\n[record]\ndirectory = \"state\"\n[survey]\nelectrodes = 8\n\
             [geometry]\npreset = \"disc-tank\"\n[geometry.disc-tank]\nelectrodes = 8\n\
             [source]\naddress = \"tcp:a:1\"\n{source}\n[switch]\naddress = \"tcp:b:2\"\n{switch}\n{voltmeter}"
        );
        std::fs::write(&path, config).unwrap();
        let prepared = prepare(&path).map_err(|problems| {
            let texts: Vec<String> = problems.iter().map(ToString::to_string).collect();
            texts.join("\n")
        })?;
        let FramesFrom::Rig(plan) = prepared.frames else {
            panic!("it is a rig");
        };
        let places = &plan.instruments;
        Ok([&places.source, &places.switch, &places.voltmeter].map(|place| place.1))
    }

    #[test]
    fn a_deadline_of_the_switch_is_used_or_refused() {
        let seconds = |each: [u64; 3]| Ok(each.map(Duration::from_secs));
        let voltmeter = "[voltmeter]\naddress = \"tcp:b:2\"\n";
        let (one, two) = ("deadline_ms = 1000", "deadline_ms = 2000");
        assert_eq!(deadlines(two, one, ""), seconds([2, 1, 1]));
        // switch and voltmeter are one mainframe, whichever section sets the timeout
        assert_eq!(deadlines("", one, voltmeter), seconds([5, 1, 1]));
        let measures = format!("{voltmeter}{one}");
        assert_eq!(deadlines("", "", &measures), seconds([5, 1, 1]));
        assert_eq!(deadlines("", one, &measures), seconds([5, 1, 1]));
        let refused = deadlines("", two, &measures).unwrap_err();
        assert!(
            refused.contains("switch.deadline_ms: 2000 here and 1000 in [voltmeter]"),
            "{refused}"
        );
    }
}
