//! From configuration to the plan of a frame, its limits, and where the instruments are.

use std::time::Duration;

use rig::MeterSettings;
use survey::{
    Amps, Limits, Plan, PlanError, Protocol, Relay, Sensing, Timing, Volts, Wiring, WiringError,
};

use super::{Findings, Places, RigPlan, seconds};
use crate::config::{Config, RigKind, WiringKind};
use crate::model::chain;
use crate::place::Place;

/// What the rig is to do; checked against its limits.
pub(super) fn rig_plan(
    config: &Config,
    protocol: &Protocol,
    findings: &mut Findings<'_>,
) -> Option<RigPlan> {
    let survey = &config.survey;
    let electrodes = config.wiring.electrodes.unwrap_or(protocol.electrodes());
    let slot = config.wiring.slot;
    let wiring = match config.wiring.kind {
        WiringKind::Pairs34924a => Wiring::pairs_34924a(slot, electrodes),
        WiringKind::Matrix34932a => Wiring::matrix_34932a(slot, electrodes),
        WiringKind::GpioBoard => Wiring::gpio_board(electrodes),
    };
    let wiring = findings.taken("wiring", wiring.map_err(|cause| chain(&cause)));
    let places = places(config, findings);
    let bench = match config.rig.kind {
        RigKind::Simulated | RigKind::Mixed => {
            let simulated = simulated(config, findings);
            if let (Some((profile, _)), Some(wiring), Some(places)) = (&simulated, &wiring, &places)
            {
                fits(config, profile, wiring, places, findings);
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
    let plan = Plan::new(
        protocol,
        &wiring?,
        Amps(survey.current_ua * 1e-6),
        Volts(survey.compliance_v),
        seconds(survey.settle_ms * 1e-3),
    )
    .map_err(|cause| match cause {
        PlanError::Wiring(WiringError::Electrodes {
            wiring,
            wired,
            asked,
        }) => (
            "wiring.electrodes",
            format!("wiring '{wiring}' has {wired} electrodes, the survey asks {asked}"),
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
    let (limits, timing) = match config.wiring.kind {
        WiringKind::Pairs34924a => (Limits::REED, Timing::reed(survey.nplc, survey.line_hz)),
        WiringKind::Matrix34932a => (
            Limits::ARMATURE,
            Timing::armature(survey.nplc, survey.line_hz),
        ),
        WiringKind::GpioBoard => (
            Limits::GPIO_BOARD_5V,
            Timing::gpio_board(survey.nplc, survey.line_hz),
        ),
    };
    let timing = Timing {
        autozero: survey.autozero,
        ..timing
    };
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
    let bench = match bench {
        Some(bench) => Some(bench?),
        None => None,
    };
    Some(RigPlan {
        plan,
        limits,
        timing,
        meter: MeterSettings {
            range: Volts(survey.range_v),
            nplc: survey.nplc,
            autozero: survey.autozero,
        },
        wiring: config.wiring.kind,
        instruments: places?,
        bench,
    })
}

fn simulated(
    config: &Config,
    findings: &mut Findings<'_>,
) -> Option<(bench::Profile, bench::Scene)> {
    let profile = findings.taken(
        "rig.profile",
        bench::Profile::load(profile_name(config)).map_err(|cause| chain(&cause)),
    );
    let scene = findings.taken(
        "rig.scene",
        match config.rig.scene.as_deref() {
            Some(scene) => crate::simulation::load_scene(scene),
            None => Ok(bench::Scene::quiet()),
        },
    );
    Some((profile?, scene?))
}

fn profile_name(config: &Config) -> &str {
    let own = wiring_name(config.wiring.kind);
    config.rig.profile.as_deref().unwrap_or(own)
}

/// The word for it in a configuration, which is also the name of the shipped profile that goes with it.
fn wiring_name(kind: WiringKind) -> &'static str {
    match kind {
        WiringKind::Pairs34924a => "pairs-34924a",
        WiringKind::Matrix34932a => "matrix-34932a",
        WiringKind::GpioBoard => "gpio-board",
    }
}

/// Whether the simulated instruments have what the wiring switches; what a real one has is asked when it is connected.
fn fits(
    config: &Config,
    profile: &bench::Profile,
    wiring: &Wiring,
    places: &Places,
    findings: &mut Findings<'_>,
) {
    if places.switch.0 != Place::Simulated {
        return;
    }
    let key = if config.rig.profile.is_some() {
        "rig.profile"
    } else {
        "wiring"
    };
    let (name, own) = (profile_name(config), wiring_name(config.wiring.kind));
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
    let measuring = wiring.measuring_relays();
    let scanned = wiring.sensing == Sensing::Scan;
    let needed = wiring.injecting_relays().into_iter();
    let needed = needed.chain(wiring.bus.iter().copied());
    let lacking = needed
        .map(|relay| (relay, false))
        .chain(measuring.into_iter().map(|relay| (relay, scanned)))
        .find_map(|(relay, scanned)| lacking(profile, relay, scanned));
    if let Some(lacking) = lacking {
        let board = match profile.board {
            Some(_) => "; for its board set wiring.kind = \"gpio-board\"",
            None => "",
        };
        findings.add(
            key,
            format!(
                "profile {name} does not fit wiring {own} in slot {}: {lacking}; use profile = \"{own}\" (its module is \
                 in slot 1), or a wiring and slot that the profile has{board}",
                config.wiring.slot
            ),
        );
    }
}

/// Why a relay cannot do its part on these modules; `None` where it can. The driver asks the same of real ones.
fn lacking(profile: &bench::Profile, relay: Relay, scanned: bool) -> Option<String> {
    let Some((slot, channel)) = keysight_34980a::split(relay) else {
        return Some(format!("no slot has relay {relay}"));
    };
    // `split` yields slots 1 to 8
    let Some(module) = profile.slots[slot as usize - 1] else {
        return Some(format!("slot {slot} is empty"));
    };
    if module.contact(channel).is_none() {
        return Some(format!(
            "the {module} in slot {slot} has no channel {channel}"
        ));
    }
    (scanned && !module.scannable(channel))
        .then(|| format!("channel {channel} of the {module} in slot {slot} cannot be scanned"))
}

/// Longest time an instrument may need for one answer where the configuration says nothing: a scan of 26 channels at
/// 200 PLC takes 104 s, at 1 PLC half a second.
fn deadline(config: &Config, given: Option<f64>) -> Duration {
    let frame_s = 26.0 * config.survey.nplc * 2.0 / config.survey.line_hz;
    seconds(given.map_or(5.0 + 2.0 * frame_s, |given_ms| given_ms * 1e-3))
}

fn places(config: &Config, findings: &mut Findings<'_>) -> Option<Places> {
    // but for the board, the mainframe that switches is the one that measures
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
        let memory = (Place::Simulated, deadline(config, None));
        return Some(Places {
            source: memory.clone(),
            switch: memory.clone(),
            voltmeter: memory,
        });
    }
    let mut read = sections.into_iter().map(|(name, section)| {
        let Some(section) = section else {
            if name == "voltmeter" && mainframe {
                // the missing [switch] has been said
                return None;
            }
            findings.add(name, format!("the rig has no [{name}]; give its address"));
            return None;
        };
        match section.address.parse::<Place>() {
            Ok(Place::Simulated) if config.rig.kind == RigKind::Instruments => {
                findings.add(
                    &format!("{name}.address"),
                    "a simulated instrument in a rig of instruments; set rig.kind = \"mixed\" if that is meant",
                );
                None
            }
            Ok(place) => Some((place, deadline(config, section.deadline_ms))),
            Err(refusal) => {
                findings.add(&format!("{name}.address"), refusal.to_string());
                None
            }
        }
    });
    let (source, switch, voltmeter) = (read.next()?, read.next()?, read.next()?);
    let places = Places {
        source: source?,
        switch: switch?,
        voltmeter: voltmeter?,
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
