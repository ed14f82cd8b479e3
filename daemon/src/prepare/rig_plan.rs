//! From configuration to the plan of a frame, its limits, and where the instruments are.

use std::time::Duration;

use rig::MeterSettings;
use survey::{Amps, Limits, Plan, PlanError, Protocol, Timing, Volts, Wiring, WiringError};

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
        RigKind::Simulated | RigKind::Mixed => Some(simulated(config, findings)),
        RigKind::Instruments | RigKind::Recording => {
            for (key, given) in [
                ("rig.profile", &config.rig.profile),
                ("rig.scene", &config.rig.scene),
            ] {
                if given.is_some() {
                    findings.add(
                        key,
                        "only a simulated rig has one; set rig.kind = \"simulated\"",
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
    let board = config.wiring.kind == WiringKind::GpioBoard;
    let profile = config
        .rig
        .profile
        .as_deref()
        .unwrap_or(match config.wiring.kind {
            WiringKind::Pairs34924a => "pairs-34924a",
            WiringKind::Matrix34932a => "matrix-34932a",
            WiringKind::GpioBoard => "gpio-board",
        });
    let profile = findings.taken(
        "rig.profile",
        bench::Profile::load(profile).map_err(|cause| chain(&cause)),
    );
    if board
        && let Some(profile) = &profile
        && profile.board.is_none()
    {
        findings.add(
            "rig.profile",
            "the wiring needs the multiplexer board, the profile has none; add [board] to it",
        );
    }
    let scene = findings.taken(
        "rig.scene",
        match config.rig.scene.as_deref() {
            Some(scene) => crate::simulation::load_scene(scene),
            None => Ok(bench::Scene::quiet()),
        },
    );
    Some((profile?, scene?))
}

/// Longest time an instrument may need for one answer where the configuration says nothing: a scan of 26 channels at
/// 200 PLC takes 104 s, at 1 PLC half a second.
fn deadline(config: &Config, given: Option<f64>) -> Duration {
    let frame_s = 26.0 * config.survey.nplc * 2.0 / config.survey.line_hz;
    seconds(given.map_or(5.0 + 2.0 * frame_s, |given_ms| given_ms * 1e-3))
}

fn places(config: &Config, findings: &mut Findings<'_>) -> Option<Places> {
    let sections = [
        ("source", &config.source),
        ("switch", &config.switch),
        ("voltmeter", &config.voltmeter),
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
