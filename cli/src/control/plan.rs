//! `tactus plan`: the steps of a frame as the running daemon would take them; nothing is moved. Without a daemon,
//! `tactusd --config FILE --plan` prints the same.

use std::io::Write;
use std::time::Duration;

use dbus::{PlanDetails, PlanReport, SessionOptions, SettingCost};
use serde_json::{Value, json};
use survey::{Amps, Volts};

use crate::connection::Daemon;
use crate::failure::Failure;
use crate::options::duration::display_span;
use crate::output::Printer;

pub(crate) async fn run(
    daemon: &Daemon,
    requested: &crate::args::Plan,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let options = requested.measuring.with(SessionOptions::default());
    let report = if options == SessionOptions::default() {
        daemon.ask("the plan", daemon.manager.plan()).await?
    } else {
        let plan = daemon.manager.plan_with(&options);
        daemon.ask("the plan", plan).await?
    };
    printer.record(&json_line(&report), |_| {
        for_a_person(&report, requested.steps)
    })
}

/// The line of `plan --json`; see `docs/reference/json.md`.
fn json_line(report: &PlanReport) -> Value {
    let more = &report.more;
    let mut line = json!({
        "wiring": more.wiring,
        "steps": report.steps,
        "injections": report.injections,
        "readings": report.readings,
        "relay_moves": report.relay_moves,
        "reading_messages": report.reading_messages,
        "duration_s": report.duration_s,
        "current_a": report.current_a,
        "compliance_v": report.compliance_v,
        "source_current_max_a": more.source_current_max_a,
        "relay_current_max_a": more.relay_current_max_a,
        "relay_voltage_max_v": more.relay_voltage_max_v,
    });
    // how each reading is taken; not reported by an older daemon
    let measuring = more.nplc.map(|nplc| {
        json!({
            "nplc": nplc,
            "averages": more.averages.unwrap_or_default(),
            "autozero": more.autozero.unwrap_or_default(),
            "settle_s": more.settle_s.unwrap_or_default(),
            "channel_delay_s": more.channel_delay_s.unwrap_or_default(),
            "reversal": more.reversal.unwrap_or_default(),
            "zero_every": more.zero_every.unwrap_or_default(),
            "range_v": more.range_v.unwrap_or_default(),
            "planned_ranges": more.planned_ranges.unwrap_or_default(),
            "range_changes": more.range_changes.unwrap_or_default(),
            "range_time_s": more.range_time_s.unwrap_or_default(),
            "noise_fixed_v": more.noise_fixed_v.unwrap_or_default(),
            "noise_v": more.noise_v.unwrap_or_default(),
            "noise_median_v": more.noise_median_v.unwrap_or_default(),
            "skip": more.skip.unwrap_or_default(),
            "half": more.half.unwrap_or_default(),
            "costs": more.costs(),
        })
    });
    for (key, value) in measuring.iter().filter_map(Value::as_object).flatten() {
        line[key] = value.clone();
    }
    line["lines"] = json!(report.lines);
    line
}

/// Cost per frame and gain in noise of each setting, the most expensive first.
fn costs_text(costs: &[SettingCost]) -> String {
    let mut costs: Vec<&SettingCost> = costs.iter().collect();
    costs.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
    let each = costs.into_iter().map(SettingCost::to_string);
    each.collect::<Vec<_>>().join(", ")
}

/// How each reading is taken, and the cost and gain of its range; `None` from an older daemon.
fn describe(more: &PlanDetails) -> Option<String> {
    let seconds = |seconds: Option<f64>| {
        display_span(Duration::try_from_secs_f64(seconds.unwrap_or(0.0)).unwrap_or_default())
    };
    let volts = |volts: Option<f64>| Volts(volts.unwrap_or(0.0));
    let mut words = vec![format!("{} PLC", more.nplc?)];
    if let Some(averages) = more.averages.filter(|averages| *averages > 1) {
        words.push(format!("{averages} readings averaged"));
    }
    words.push(format!(
        "autozero {}",
        if more.autozero == Some(true) {
            "on"
        } else {
            "off"
        }
    ));
    if more.settle_s > Some(0.0) {
        words.push(format!("{} settling", seconds(more.settle_s)));
    }
    if more.channel_delay_s > Some(0.0) {
        words.push(format!(
            "{} before each channel",
            seconds(more.channel_delay_s)
        ));
    }
    if more.reversal == Some(true) {
        words.push("both polarities of the current".to_owned());
    }
    if let Some(every) = more.zero_every.filter(|every| *every > 0) {
        words.push(format!("a zero-current frame every {every} frames"));
    }
    let ranges = if more.planned_ranges == Some(true) {
        format!(
            "one for each reading: {} changes in a frame take {}; noise {:.3} rms ({:.3} median) instead of {:.3}",
            more.range_changes.unwrap_or(0),
            seconds(more.range_time_s),
            volts(more.noise_v),
            volts(more.noise_median_v),
            volts(more.noise_fixed_v)
        )
    } else {
        format!(
            "{} for every reading, noise {:.3}",
            volts(more.range_v),
            volts(more.noise_fixed_v)
        )
    };
    let mut pattern = match more.skip.unwrap_or(0) {
        0 => "neighbouring pairs".to_owned(),
        skip => format!("pairs with {skip} electrodes between the two"),
    };
    if more.half == Some(true) {
        pattern.push_str(", one of each two reciprocal readings");
    }
    let costs = match more.costs().as_slice() {
        [] => String::new(),
        costs => format!("cost        {}\n", costs_text(costs)),
    };
    Some(format!(
        "pattern     {pattern}\nmeasuring   {}\nranges      {ranges}\n{costs}",
        words.join(", ")
    ))
}

fn for_a_person(plan: &PlanReport, steps: bool) -> String {
    let more = &plan.more;
    let most = |limit: Option<String>| {
        limit
            .map(|limit| format!(" (at most {limit})"))
            .unwrap_or_default()
    };
    let mut text = format!(
        "wiring      {}\n\
         frame       {} injections, {} readings in {} messages, {} relay moves, {} steps\n\
         duration    {}\n\
         current     {}{}\n\
         compliance  {}{}\n",
        more.wiring.as_deref().unwrap_or("not named"),
        plan.injections,
        plan.readings,
        plan.reading_messages,
        plan.relay_moves,
        plan.steps,
        display_span(Duration::try_from_secs_f64(plan.duration_s).unwrap_or_default()),
        Amps(plan.current_a),
        most(
            more.source_current_max_a
                .into_iter()
                .chain(more.relay_current_max_a)
                .reduce(f64::min)
                .map(|amps| Amps(amps).to_string())
        ),
        Volts(plan.compliance_v),
        most(
            more.relay_voltage_max_v
                .map(|volts| Volts(volts).to_string())
        ),
    );
    text.push_str(&describe(more).unwrap_or_default());
    if steps {
        for line in &plan.lines {
            text.push_str(line);
            text.push('\n');
        }
    } else {
        text.push_str("`tactus plan --steps` lists every step");
    }
    text
}

#[cfg(test)]
mod tests {
    use crate::control::plan::*;

    #[test]
    fn plan_text_names_its_limits() {
        let plan = PlanReport {
            steps: 3,
            injections: 26,
            readings: 598,
            relay_moves: 52,
            reading_messages: 26,
            duration_s: 12.5,
            current_a: 1e-3,
            compliance_v: 10.0,
            lines: vec!["1: source to 0 A".into()],
            more: PlanDetails {
                wiring: Some("34924A pairs in slot 1".into()),
                source_current_max_a: Some(0.1),
                relay_current_max_a: Some(0.01),
                ..PlanDetails::default()
            },
        };
        let short = for_a_person(&plan, false);
        assert!(
            short.contains("26 injections, 598 readings in 26 messages"),
            "{short}"
        );
        assert!(
            short.contains("1 mA (at most 10 mA)") && short.contains("12.5 s"),
            "{short}"
        );
        assert!(!short.contains("source to 0 A"));
        assert!(for_a_person(&plan, true).contains("source to 0 A"));
        assert_eq!(
            json_line(&plan).to_string(),
            "{\"wiring\":\"34924A pairs in slot 1\",\"steps\":3,\"injections\":26,\"readings\":598,\"relay_moves\":52,\
             \"reading_messages\":26,\"duration_s\":12.5,\"current_a\":0.001,\"compliance_v\":10.0,\
             \"source_current_max_a\":0.1,\"relay_current_max_a\":0.01,\"relay_voltage_max_v\":null,\
             \"lines\":[\"1: source to 0 A\"]}"
        );
    }

    #[test]
    fn setting_costs_are_listed_highest_first() {
        let mut more = PlanDetails {
            nplc: Some(1.0),
            averages: Some(4),
            half: Some(true),
            ..PlanDetails::default()
        };
        for (setting, seconds, gain) in [
            ("half", -2.5, 0.5_f64.sqrt()),
            ("averages", 9.0, 2.0),
            ("settle", 0.05, 1.0),
        ] {
            more.set_cost(SettingCost {
                setting,
                seconds,
                gain,
            });
        }
        let text = describe(&more).unwrap();
        assert!(
            text.contains("cost        averages 9.0 s (noise / 2.00), settle 50 ms, half saves 2.5 s (noise x 1.41)"),
            "{text}"
        );
        assert!(
            text.contains("neighbouring pairs, one of each two"),
            "{text}"
        );
    }
}
