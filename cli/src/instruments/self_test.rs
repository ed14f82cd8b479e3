//! `tactus instruments test` and `relays`: faults of the rig, and wear of its relays.

use std::io::{IsTerminal, Write};
use std::time::Duration;

use dbus::{Options, RelayWear, TestReport};
use serde::Serialize;
use serde_json::json;
use survey::{Ohms, Volts};

use crate::connection::{Daemon, fault};
use crate::failure::Failure;
use crate::options::duration::display_span;
use crate::output::Printer;
use crate::output::table::columns;

/// A line of `instruments relays --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct WearLine {
    relay: u32,
    purpose: String,
    cycles: u64,
    rated: Option<u64>,
    used: Option<f64>,
    left_s: Option<f64>,
}

/// Tests the rig. With findings, the exit code is that of an instrument fault.
pub(crate) async fn test(
    daemon: &Daemon,
    all: bool,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let mut progress = daemon
        .ask("the self-test", async {
            Ok(daemon.manager.receive_test_progress().await?)
        })
        .await?;
    let options = Options::new();
    let mut report = std::pin::pin!(daemon.manager.test_instruments(&options));
    let bar = std::io::stderr().is_terminal();
    let report = loop {
        // the timeout applies to each step, for any number of steps
        let next = tokio::time::timeout(daemon.patience, async {
            tokio::select! {
                report = &mut report => Some(report),
                step = dbus::next(&mut progress) => {
                    if let Some(step) = step.as_ref().filter(|_| bar)
                        && let Ok(step) = step.args()
                    {
                        eprint!("\r\x1b[K{:>4}/{} {}", step.done, step.total, survey::printable(step.what));
                    }
                    // the stream of steps has ended with the connection: wait for the error of the call
                    if step.is_none() { std::future::pending::<()>().await; }
                    None
                }
            }
        });
        match next.await {
            Ok(None) => {}
            Ok(Some(report)) => break report.map_err(|error| fault("the self-test", &error))?,
            Err(_) => {
                return Err(Failure::Timeout(format!(
                    "the self-test: no result for {}; it continues in the daemon, `tactus status` shows when it is done",
                    display_span(daemon.patience)
                )));
            }
        }
    };
    if bar {
        eprint!("\r\x1b[K");
    }
    show(report, all, printer)
}

fn show(report: TestReport, all: bool, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
    let finite = |value: f64| Some(value).filter(|value| value.is_finite());
    if printer.is_json() {
        // the lines of `instruments test --json`; see `docs/reference/json.md`
        for line in &report.lines {
            let line = json!({
                "event": "line",
                "subject": line.subject,
                "check": line.check,
                "verdict": line.verdict,
                "measured": finite(line.measured),
                "expected": finite(line.expected),
                "unit": line.unit,
                "text": line.text,
            });
            printer.record(&line, |_| String::new())?;
        }
        let more = &report.more;
        let whole = json!({
            "event": "report",
            "passed": report.passed,
            "findings": report.findings,
            "at": more.at,
            "wiring": more.wiring,
            "simulated": more.simulated,
            "current_a": more.current_a,
            "sheet_ohm": more.sheet_ohm,
            "misfit": more.misfit,
            "pauw_ohm": more.pauw_ohm,
            "pauw_raw_ohm": more.pauw_raw_ohm,
            "reciprocity": more.reciprocity,
            "noise_v": more.noise_v,
            "offset_v": more.offset_v,
        });
        printer.record(&whole, |_| String::new())?;
    } else {
        let rows: Vec<[String; 6]> = report
            .lines
            .iter()
            .filter(|line| all || line.verdict == "failed" || !line.subject.starts_with(['r', 'e']))
            .map(|line| {
                [
                    line.subject.clone(),
                    line.check.clone(),
                    line.verdict.clone(),
                    quantity(line.measured, &line.unit),
                    quantity(line.expected, &line.unit),
                    line.text.clone(),
                ]
            })
            .collect();
        printer.text(&columns(
            ["what", "check", "verdict", "measured", "expected", "remark"],
            &rows,
        ))?;
        let sound = |subject: char| {
            let of = report
                .lines
                .iter()
                .filter(|line| line.subject.starts_with(subject));
            let ok = of.clone().filter(|line| line.verdict == "ok").count();
            format!("{ok} of {}", of.count())
        };
        printer.text(&format!(
            "relay tests ok: {}; electrodes ok: {}",
            sound('r'),
            sound('e')
        ))?;
        if report.more.simulated == Some(true) {
            printer.text("SIMULATED")?;
        }
        for finding in &report.findings {
            printer.text(&format!("FOUND  {finding}"))?;
        }
    }
    if report.passed {
        return printer.text("nothing needs repair; the source is off");
    }
    Err(Failure::Instrument(format!(
        "the self-test found {} fault(s); the source is off: {}",
        report.findings.len(),
        report.findings.join("; ")
    )))
}

fn quantity(value: f64, unit: &str) -> String {
    match unit {
        _ if !value.is_finite() => String::new(),
        "ohm" => Ohms(value).to_string(),
        "V" => Volts(value).to_string(),
        _ => format!("{value:.3}"),
    }
}

/// Shows the wear of every relay, the most worn first.
pub(crate) async fn relays(
    daemon: &Daemon,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let options = Options::new();
    let mut relays = daemon
        .ask("the relays", daemon.manager.relays(&options))
        .await?;
    relays.sort_by(|a, b| b.used.total_cmp(&a.used).then(a.relay.cmp(&b.relay)));
    let heading = [
        "relay",
        "closed",
        "rated",
        "used",
        "left at this rate",
        "purpose",
    ];
    let lines: Vec<WearLine> = relays.into_iter().map(wear_line).collect();
    printer.table(heading, &lines, |wear| {
        [
            wear.relay.to_string(),
            wear.cycles.to_string(),
            wear.rated
                .map_or_else(|| "does not wear".to_owned(), |rated| rated.to_string()),
            wear.used
                .map_or_else(String::new, |used| format!("{:.3} %", 100.0 * used)),
            wear.left_s.map_or_else(String::new, span),
            wear.purpose.clone(),
        ]
    })
}

fn wear_line(wear: RelayWear) -> WearLine {
    let finite = |value: f64| Some(value).filter(|value| value.is_finite());
    WearLine {
        relay: wear.relay,
        purpose: wear.purpose,
        cycles: wear.cycles,
        rated: Some(wear.rated).filter(|rated| *rated > 0),
        used: finite(wear.used),
        left_s: finite(wear.left_s),
    }
}

/// Days or years, whichever suits the duration.
fn span(seconds: f64) -> String {
    let days = seconds / 86_400.0;
    match days {
        days if days >= 730.0 => format!("{:.1} years", days / 365.25),
        days if days >= 2.0 => format!("{days:.0} days"),
        _ => display_span(Duration::try_from_secs_f64(seconds).unwrap_or_default()),
    }
}

#[cfg(test)]
mod tests {
    use dbus::TestLine;

    use crate::instruments::self_test::*;

    fn report() -> TestReport {
        let line = |subject: &str, verdict: &str, unit: &str| TestLine {
            subject: subject.into(),
            check: "contact".into(),
            verdict: verdict.into(),
            measured: 120.0,
            expected: f64::NAN,
            unit: unit.into(),
            text: String::new(),
        };
        TestReport {
            passed: false,
            findings: vec!["electrode 17: open".into()],
            lines: vec![
                line("electrode 16", "ok", "ohm"),
                line("electrode 17", "failed", "ohm"),
            ],
            more: dbus::TestDetails {
                sheet_ohm: Some(1000.0),
                simulated: Some(true),
                ..dbus::TestDetails::default()
            },
        }
    }

    #[test]
    fn what_is_to_be_mended_is_shown_and_ends_with_a_fault() {
        let mut text = Printer::into(false, Vec::new());
        let failure = show(report(), false, &mut text).unwrap_err();
        assert_eq!(failure.code(), 5);
        let text = String::from_utf8(text.sink()).unwrap();
        assert!(text.contains("FOUND  electrode 17: open"), "{text}");
        assert!(
            text.contains("electrodes ok: 1 of 2") && text.contains("SIMULATED"),
            "{text}"
        );
        assert!(!text.contains("electrode 16 "), "{text}");
        let mut all = Printer::into(false, Vec::new());
        show(report(), true, &mut all).unwrap_err();
        let all = String::from_utf8(all.sink()).unwrap();
        assert!(all.contains("electrode 16 "), "{all}");
        let mut json = Printer::into(true, Vec::new());
        show(report(), false, &mut json).unwrap_err();
        let json = String::from_utf8(json.sink()).unwrap();
        let last: serde_json::Value = serde_json::from_str(json.lines().last().unwrap()).unwrap();
        assert_eq!(
            (last["event"].as_str(), last["sheet_ohm"].as_f64()),
            (Some("report"), Some(1000.0))
        );
    }

    #[test]
    fn relay_life_is_printed_in_days_and_years() {
        assert_eq!(span(3.2e9), "101.4 years");
        assert_eq!(span(864_000.0), "10 days");
    }
}
