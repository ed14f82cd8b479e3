//! Settings that contradict each other, whatever the rest of the configuration says. Each number by itself has been checked
//! when the file was read ([`config::numbers`]).

use config::numbers::too_long;
use imaging::Method;

use crate::preparation::Findings;
use config::Config;

/// Adds a problem for each.
pub(super) fn check(config: &Config, findings: &mut Findings<'_>) {
    let survey = &config.survey;
    let delay = survey.channel_delay_ms;
    if delay.fract() != 0.0 {
        findings.add(
            "survey.channel_delay_ms",
            format!("{delay:?} is none of the whole numbers of milliseconds"),
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

/// Free words are kept with every session.
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
    let tv = model.method == Some(Method::Tv);
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

/// Who is told of troubles.
fn of_notify(config: &Config, findings: &mut Findings<'_>) {
    let notify = &config.notify;
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
