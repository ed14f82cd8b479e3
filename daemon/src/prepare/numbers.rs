//! Numbers that cannot be, whatever the rest of the configuration says.

use super::Findings;
use crate::config::{Config, MethodName};

/// Adds a problem for each.
pub(super) fn check(config: &Config, findings: &mut Findings<'_>) {
    let survey = &config.survey;
    let positive = [
        ("survey.current_ua", survey.current_ua),
        ("survey.compliance_v", survey.compliance_v),
        ("survey.range_v", survey.range_v),
    ];
    for (key, value) in positive {
        if !(value > 0.0 && value.is_finite()) {
            findings.add(key, format!("{value} is not a positive number"));
        }
    }
    let not_negative = [
        ("survey.settle_ms", Some(survey.settle_ms)),
        ("survey.channel_delay_ms", Some(survey.channel_delay_ms)),
        ("schedule.every_s", config.schedule.every_s),
        ("schedule.for_s", config.schedule.for_s),
        (
            "recording.speed",
            config.recording.as_ref().and_then(|r| r.speed),
        ),
    ];
    for (key, value) in not_negative {
        if let Some(value) = value
            && !(value >= 0.0 && value.is_finite())
        {
            findings.add(key, format!("{value} is not a number from 0 on"));
        }
    }
    let longest = [
        ("survey.settle_ms", Some(survey.settle_ms), 60e3),
        (
            "survey.channel_delay_ms",
            Some(survey.channel_delay_ms),
            60e3,
        ),
        (
            "schedule.every_s",
            config.schedule.every_s,
            super::LONGEST_S,
        ),
        ("schedule.for_s", config.schedule.for_s, super::LONGEST_S),
    ];
    for (key, value, most) in longest {
        if let Some(value) = value.filter(|value| *value > most) {
            findings.add(key, format!("{value} is too long, {most} is the most"));
        }
    }
    if !(1..=1000).contains(&survey.averages) {
        findings.add(
            "survey.averages",
            format!("{} is not from 1 to 1000", survey.averages),
        );
    }
    if survey.channel_delay_ms.fract() != 0.0 {
        findings.add("survey.channel_delay_ms", "whole milliseconds only");
    }
    if !(1.0..=100.0).contains(&survey.range_margin) {
        findings.add(
            "survey.range_margin",
            format!("{} is not from 1 to 100", survey.range_margin),
        );
    }
    if survey.zero_every == Some(0) {
        findings.add(
            "survey.zero_every",
            "0 frames; 1 or more, or delete this key",
        );
    }
    if survey.zero_every.is_some() && survey.reversal {
        findings.add(
            "survey.zero_every",
            "current reversal cancels offsets already; delete this key, or set reversal = false",
        );
    }
    if config.schedule.count == Some(0) {
        findings.add("schedule.count", "0 frames are no session; 1 or more");
    }
    if config.schedule.for_s == Some(0.0) {
        findings.add("schedule.for_s", "0 s are no session");
    }
    if let Some(rate) = config.recording.as_ref().and_then(|r| r.frames_per_s)
        && !(rate > 0.0 && rate.is_finite())
    {
        findings.add(
            "recording.frames_per_s",
            format!("{rate} is not a positive number"),
        );
    }
    of_notify(config, findings);
    of_the_method(config, findings);
    let allowed = [0.02, 0.2, 1.0, 2.0, 10.0, 20.0, 100.0, 200.0];
    if !allowed.contains(&survey.nplc) {
        findings.add(
            "survey.nplc",
            format!(
                "{} is none of 0.02, 0.2, 1, 2, 10, 20, 100, 200",
                survey.nplc
            ),
        );
    }
    let ranges = [0.1, 1.0, 10.0, 100.0, 300.0];
    if survey.range_v > 0.0 && !ranges.contains(&survey.range_v) {
        findings.add(
            "survey.range_v",
            format!("{} is none of 0.1, 1, 10, 100, 300", survey.range_v),
        );
    }
    if ![50.0, 60.0].contains(&survey.line_hz) {
        findings.add(
            "survey.line_hz",
            format!("{} is neither 50 nor 60", survey.line_hz),
        );
    }
}

/// A trained model brings its own settings: what is said of the other method would be ignored.
fn of_the_method(config: &Config, findings: &mut Findings<'_>) {
    let model = &config.model;
    if model.file.is_none() {
        of_total_variation(config, findings);
        return;
    }
    let given: Vec<&str> = [
        ("method", model.method.is_some()),
        ("prior", model.prior.is_some()),
        ("exponent", model.exponent.is_some()),
        ("length_mm", model.length_mm.is_some()),
        ("noise_figure", model.noise_figure.is_some()),
        ("map_error", model.map_error.is_some()),
        ("noise_uv", model.noise_uv.is_some()),
        ("lambda", model.lambda.is_some()),
        ("gap", model.gap.is_some()),
    ]
    .into_iter()
    .filter_map(|(key, given)| given.then_some(key))
    .collect();
    if let Some(first) = given.first() {
        findings.add(
            &format!("model.{first}"),
            format!(
                "a model file has its own settings; delete {}, or delete file to use the one-step method",
                given.join(", ")
            ),
        );
    }
}

/// Settings of one method that the other would ignore.
fn of_total_variation(config: &Config, findings: &mut Findings<'_>) {
    let model = &config.model;
    let tv = model.method == Some(MethodName::Tv);
    for (key, given, other) in [
        ("prior", tv && model.prior.is_some(), "one-step"),
        ("exponent", tv && model.exponent.is_some(), "one-step"),
        ("lambda", tv && model.lambda.is_some(), "one-step"),
        ("length_mm", tv && model.length_mm.is_some(), "one-step"),
        (
            "noise_figure",
            tv && model.noise_figure.is_some(),
            "one-step",
        ),
        ("map_error", tv && model.map_error.is_some(), "one-step"),
        ("gap", !tv && model.gap.is_some(), "tv"),
    ] {
        if given {
            findings.add(
                &format!("model.{key}"),
                format!("{key} belongs to method = \"{other}\"; delete it, or choose that method"),
            );
        }
    }
}

/// From when on something is trouble.
fn of_notify(config: &Config, findings: &mut Findings<'_>) {
    let notify = &config.notify;
    for (key, value, most) in [
        ("notify.disk_days", notify.disk_days, 36_525.0),
        ("notify.relay_life", notify.relay_life, 1.0),
        ("notify.baseline_days", notify.baseline_days, 36_525.0),
        ("notify.no_frame_periods", notify.no_frame_periods, 1e6),
        ("notify.no_frame_s", notify.no_frame_s, super::LONGEST_S),
        ("notify.deadline_s", notify.deadline_s, 600.0),
        ("notify.again_s", notify.again_s, super::LONGEST_S),
    ] {
        if !(value > 0.0 && value <= most) {
            findings.add(key, format!("{value} is not above 0 and at most {most}"));
        }
    }
    if notify.no_frame_periods < 1.0 {
        findings.add(
            "notify.no_frame_periods",
            "a frame may take a whole period; 1 or more",
        );
    }
    if let Some(program) = notify.command.first()
        && !program.starts_with('/')
    {
        findings.add(
            "notify.command",
            format!("'{program}' is no absolute path; the daemon searches no folders for it"),
        );
    }
    of_metrics(config, findings);
}

/// Nothing listens beyond this machine unless that is said.
fn of_metrics(config: &Config, findings: &mut Findings<'_>) {
    let metrics = &config.metrics;
    let Some(listen) = &metrics.listen else {
        return;
    };
    match metrics.address() {
        None => findings.add(
            "metrics.listen",
            format!("'{listen}' is no address and port such as 127.0.0.1:9617"),
        ),
        Some(address) if !address.ip().is_loopback() && !metrics.beyond_localhost => findings.add(
            "metrics.listen",
            format!(
                "{address} can be reached from other machines, and anybody may read there; choose 127.0.0.1, or set \
                 beyond_localhost = true"
            ),
        ),
        Some(_) => {}
    }
}
