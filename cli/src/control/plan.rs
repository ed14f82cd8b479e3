//! `tactus plan`: the steps of a frame as the running daemon would take them; nothing is moved. Without a daemon,
//! `tactusd --config FILE --plan` prints the same.

use std::io::Write;
use std::time::Duration;

use dbus::{PlanDetails, PlanReport, SessionOptions, SettingCost};
use serde::Serialize;
use survey::{Amps, Volts};

use crate::connection::Daemon;
use crate::failure::Failure;
use crate::options::duration::display_span;
use crate::output::Printer;

/// The line of `plan --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct Plan {
    wiring: Option<String>,
    steps: u64,
    injections: u64,
    readings: u64,
    relay_moves: u64,
    reading_messages: u64,
    duration_s: f64,
    current_a: f64,
    compliance_v: f64,
    source_current_max_a: Option<f64>,
    relay_current_max_a: Option<f64>,
    relay_voltage_max_v: Option<f64>,
    #[serde(flatten)]
    measuring: Option<Measuring>,
    lines: Vec<String>,
}

/// How each reading is taken; not reported by an older daemon.
#[derive(Debug, Serialize)]
struct Measuring {
    nplc: f64,
    averages: u64,
    autozero: bool,
    settle_s: f64,
    channel_delay_s: f64,
    reversal: bool,
    zero_every: u64,
    range_v: f64,
    planned_ranges: bool,
    range_changes: u64,
    range_time_s: f64,
    noise_fixed_v: f64,
    noise_v: f64,
    noise_median_v: f64,
    skip: u64,
    half: bool,
    costs: Vec<SettingCost>,
}

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
    let plan = from_report(report);
    printer.record(&plan, |plan| for_a_person(plan, requested.steps))
}

fn from_report(report: PlanReport) -> Plan {
    let measuring = measuring(&report.more);
    Plan {
        wiring: report.more.wiring,
        steps: report.steps,
        injections: report.injections,
        readings: report.readings,
        relay_moves: report.relay_moves,
        reading_messages: report.reading_messages,
        duration_s: report.duration_s,
        current_a: report.current_a,
        compliance_v: report.compliance_v,
        source_current_max_a: report.more.source_current_max_a,
        relay_current_max_a: report.more.relay_current_max_a,
        relay_voltage_max_v: report.more.relay_voltage_max_v,
        measuring,
        lines: report.lines,
    }
}

fn measuring(more: &PlanDetails) -> Option<Measuring> {
    let number = |value: Option<f64>| value.unwrap_or(0.0);
    Some(Measuring {
        nplc: more.nplc?,
        averages: more.averages.unwrap_or(0),
        autozero: more.autozero.unwrap_or(false),
        settle_s: number(more.settle_s),
        channel_delay_s: number(more.channel_delay_s),
        reversal: more.reversal.unwrap_or(false),
        zero_every: more.zero_every.unwrap_or(0),
        range_v: number(more.range_v),
        planned_ranges: more.planned_ranges.unwrap_or(false),
        range_changes: more.range_changes.unwrap_or(0),
        range_time_s: number(more.range_time_s),
        noise_fixed_v: number(more.noise_fixed_v),
        noise_v: number(more.noise_v),
        noise_median_v: number(more.noise_median_v),
        skip: more.skip.unwrap_or(0),
        half: more.half.unwrap_or(false),
        costs: more.costs(),
    })
}

/// Cost per frame and gain in noise of each setting, the most expensive first.
fn costs_text(costs: &[SettingCost]) -> String {
    let mut costs: Vec<&SettingCost> = costs.iter().collect();
    costs.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
    let each = costs.into_iter().map(SettingCost::to_string);
    each.collect::<Vec<_>>().join(", ")
}

/// How each reading is taken, and the cost and gain of its range.
fn describe(measuring: &Measuring) -> String {
    let seconds =
        |seconds: f64| display_span(Duration::try_from_secs_f64(seconds).unwrap_or_default());
    let mut words = vec![format!("{} PLC", measuring.nplc)];
    if measuring.averages > 1 {
        words.push(format!("{} readings averaged", measuring.averages));
    }
    words.push(format!(
        "autozero {}",
        if measuring.autozero { "on" } else { "off" }
    ));
    if measuring.settle_s > 0.0 {
        words.push(format!("{} settling", seconds(measuring.settle_s)));
    }
    if measuring.channel_delay_s > 0.0 {
        words.push(format!(
            "{} before each channel",
            seconds(measuring.channel_delay_s)
        ));
    }
    if measuring.reversal {
        words.push("both polarities of the current".to_owned());
    }
    if measuring.zero_every > 0 {
        words.push(format!(
            "a zero-current frame every {} frames",
            measuring.zero_every
        ));
    }
    let ranges = if measuring.planned_ranges {
        format!(
            "one for each reading: {} changes in a frame take {}; noise {:.3} rms ({:.3} median) instead of {:.3}",
            measuring.range_changes,
            seconds(measuring.range_time_s),
            Volts(measuring.noise_v),
            Volts(measuring.noise_median_v),
            Volts(measuring.noise_fixed_v)
        )
    } else {
        format!(
            "{} for every reading, noise {:.3}",
            Volts(measuring.range_v),
            Volts(measuring.noise_fixed_v)
        )
    };
    let mut pattern = match measuring.skip {
        0 => "neighbouring pairs".to_owned(),
        skip => format!("pairs with {skip} electrodes between the two"),
    };
    if measuring.half {
        pattern.push_str(", one of each two reciprocal readings");
    }
    let costs = match measuring.costs.as_slice() {
        [] => String::new(),
        costs => format!("cost        {}\n", costs_text(costs)),
    };
    format!(
        "pattern     {pattern}\nmeasuring   {}\nranges      {ranges}\n{costs}",
        words.join(", ")
    )
}

fn for_a_person(plan: &Plan, steps: bool) -> String {
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
        plan.wiring.as_deref().unwrap_or("not named"),
        plan.injections,
        plan.readings,
        plan.reading_messages,
        plan.relay_moves,
        plan.steps,
        display_span(Duration::try_from_secs_f64(plan.duration_s).unwrap_or_default()),
        Amps(plan.current_a),
        most(
            plan.source_current_max_a
                .into_iter()
                .chain(plan.relay_current_max_a)
                .reduce(f64::min)
                .map(|amps| Amps(amps).to_string())
        ),
        Volts(plan.compliance_v),
        most(
            plan.relay_voltage_max_v
                .map(|volts| Volts(volts).to_string())
        ),
    );
    text.push_str(&plan.measuring.as_ref().map(describe).unwrap_or_default());
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
        let plan = from_report(PlanReport {
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
        });
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
            serde_json::to_string(&plan).unwrap(),
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
        let text = describe(&measuring(&more).unwrap());
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
