//! Checks settings that contradict each other. Single numbers were checked when the file was read
//! ([`config::numbers`]).

use config::numbers::too_long;

use crate::preparation::Findings;
use config::Config;
use imaging::Ignored;

/// Reports each contradiction.
pub(super) fn check(config: &Config, findings: &mut Findings<'_>) {
    let survey = &config.survey;
    let delay = survey.channel_delay_ms;
    if delay.fract() != 0.0 {
        findings.add(
            "survey.channel_delay_ms",
            format!("{delay:?} is not a whole number of milliseconds"),
        );
    }
    if survey.zero_every.is_some() && survey.reversal {
        findings.add(
            "survey.zero_every",
            "current reversal cancels offsets already; delete this key, or set reversal = false",
        );
    }
    of_notify(config, findings);
    of_the_method(config, findings);
    of_about(config, findings);
}

/// Limits the length of free texts, which are stored with every session.
fn of_about(config: &Config, findings: &mut Findings<'_>) {
    let about = &config.about;
    for (key, words) in [
        ("about.sheet", &about.sheet),
        ("about.foam", &about.foam),
        ("about.ink", &about.ink),
        ("about.operator", &about.operator),
        ("about.wiring", &about.wiring),
        ("about.calibration", &about.calibration),
    ] {
        if let Some(why) = too_long(words) {
            findings.add(key, why);
        }
    }
}

/// Reports method settings that would be ignored: any next to a model file, which has its own settings, and those of
/// another method or prior.
fn of_the_method(config: &Config, findings: &mut Findings<'_>) {
    let model = &config.model;
    if model.file.is_some() {
        // maps of a trained model may be restricted to losses
        let given = model.given();
        let given: Vec<&str> = given
            .into_iter()
            .filter(|key| *key != "loss_only")
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
        return;
    }
    for Ignored { key, by, used_by } in model.ignored() {
        findings.add(
            &format!("model.{key}"),
            format!(
                "{key} belongs to {by} = \"{}\"; delete it, or choose that {by}",
                used_by.join("\" or \"")
            ),
        );
    }
}

/// Checks the settings of notifications.
fn of_notify(config: &Config, findings: &mut Findings<'_>) {
    let notify = &config.notify;
    if let Some(program) = notify.command.first()
        && !program.starts_with('/')
    {
        findings.add(
            "notify.command",
            format!("'{program}' is not an absolute path; the daemon searches no folders for it"),
        );
    }
    of_metrics(config, findings);
}

/// Metrics are served to other machines only if that is enabled.
fn of_metrics(config: &Config, findings: &mut Findings<'_>) {
    let metrics = &config.metrics;
    let Some(listen) = &metrics.listen else {
        return;
    };
    match metrics.address() {
        None => findings.add(
            "metrics.listen",
            format!("'{listen}' is not an address and port; write for example 127.0.0.1:9617"),
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
