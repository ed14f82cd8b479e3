//! `tactus plan`: the steps of a frame as the running daemon would take them, without moving anything.
//! Before there is a daemon, `tactusd --config FILE --plan` prints the same.

use std::io::Write;
use std::time::Duration;

use bus::PlanReport;
use serde::Serialize;
use survey::{Amps, Volts};

use crate::connection::{Daemon, fault};
use crate::duration::display_span;
use crate::failure::Failure;
use crate::output::Printer;

/// The line of `plan --json`; see `cli/JSON.md`.
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
    lines: Vec<String>,
}

pub(crate) async fn run(
    daemon: &Daemon,
    steps: bool,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let report = daemon.ask("the plan", daemon.manager.plan()).await?;
    let plan = from_report(report)?;
    printer.record(&plan, |plan| for_a_person(plan, steps))
}

fn from_report(report: PlanReport) -> Result<Plan, Failure> {
    let number = |key| {
        report
            .more
            .number(key)
            .map_err(|error| fault("the plan", &error))
    };
    Ok(Plan {
        wiring: report
            .more
            .text("wiring")
            .map_err(|error| fault("the plan", &error))?
            .map(str::to_owned),
        steps: report.steps,
        injections: report.injections,
        readings: report.readings,
        relay_moves: report.relay_moves,
        reading_messages: report.reading_messages,
        duration_s: report.duration_s,
        current_a: report.current_a,
        compliance_v: report.compliance_v,
        source_current_max_a: number("source_current_max_a")?,
        relay_current_max_a: number("relay_current_max_a")?,
        relay_voltage_max_v: number("relay_voltage_max_v")?,
        lines: report.lines,
    })
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
    use bus::Options;

    use super::*;

    #[test]
    fn a_plan_is_told_with_its_limits() {
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
            more: Options::new()
                .with("wiring", "34924A pairs in slot 1")
                .with("source_current_max_a", 0.1)
                .with("relay_current_max_a", 0.01),
        })
        .unwrap();
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
}
