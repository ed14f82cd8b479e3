//! `tactus doctor`: checks the machine for the daemon, with advice for each problem.

mod machine;
mod running;

use std::io::Write;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::args::{Doctor, Global};
use crate::failure::Failure;
use crate::output::Printer;
use machine::Machine;

/// Result of one check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
enum CheckResult {
    Ok,
    /// It works, but problems are to be expected within months.
    Warn,
    /// It does not work.
    Bad,
}

/// A line of `doctor --json`; see `docs/reference/json.md`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Finding {
    check: &'static str,
    verdict: CheckResult,
    text: String,
    /// Advice how to solve the problem.
    advice: Option<String>,
}

impl Finding {
    fn ok(check: &'static str, text: impl Into<String>) -> Self {
        Self {
            check,
            verdict: CheckResult::Ok,
            text: text.into(),
            advice: None,
        }
    }

    fn warn(check: &'static str, text: impl Into<String>, advice: impl Into<String>) -> Self {
        Self {
            verdict: CheckResult::Warn,
            advice: Some(advice.into()),
            ..Self::ok(check, text)
        }
    }

    fn bad(check: &'static str, text: impl Into<String>, advice: impl Into<String>) -> Self {
        Self {
            verdict: CheckResult::Bad,
            ..Self::warn(check, text, advice)
        }
    }

    fn for_a_person(&self) -> String {
        let word = match self.verdict {
            CheckResult::Ok => "ok  ",
            CheckResult::Warn => "warn",
            CheckResult::Bad => "BAD ",
        };
        match &self.advice {
            None => format!("{word}  {:14}  {}", self.check, self.text),
            Some(advice) => format!(
                "{word}  {:14}  {}\n      {:14}  -> {advice}",
                self.check, self.text, ""
            ),
        }
    }
}

/// The part of the daemon's configuration that concerns the machine. `tactusd --check` checks the other parts.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
struct DoctorConfig {
    source: InstrumentSection,
    switch: InstrumentSection,
    voltmeter: InstrumentSection,
    record: Record,
    bus: Bus,
    notify: Notify,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
struct InstrumentSection {
    address: String,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
struct Record {
    directory: Option<PathBuf>,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
struct Bus {
    peer: Option<bool>,
    peer_path: Option<PathBuf>,
    system: bool,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
struct Notify {
    command: Vec<String>,
}

/// Runs all checks.
///
/// # Errors
/// A check has failed; the printed lines show which.
pub(crate) fn run(
    global: &Global,
    requested: &Doctor,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let machine = Machine::this_machine();
    let file = requested.config.clone().unwrap_or_else(|| {
        let installed = PathBuf::from("/etc/tactus/config.toml");
        let local = PathBuf::from("config.toml");
        if installed.exists() || !local.exists() {
            installed
        } else {
            local
        }
    });
    let mut findings = vec![running::configuration(&file)];
    let wanted = match machine::wanted(&file) {
        Ok(wanted) => wanted,
        Err(finding) => {
            findings.push(finding);
            DoctorConfig::default()
        }
    };
    findings.extend(machine.users(&wanted));
    findings.extend(machine.devices(&wanted));
    findings.extend(machine.installed(&wanted));
    findings.extend(machine.clock(chrono::Utc::now()));
    let running = crate::runtime::current_thread()?.block_on(running::check(global, &wanted));
    // a running daemon reports its directory
    let directory = running
        .record_directory
        .or_else(|| wanted.record.directory.clone());
    findings.extend(machine.record(directory.as_deref()));
    findings.extend(running.findings);
    let count = |verdict| findings.iter().filter(|one| one.verdict == verdict).count();
    let (bad, warned) = (count(CheckResult::Bad), count(CheckResult::Warn));
    for finding in &findings {
        printer.record(finding, Finding::for_a_person)?;
    }
    if bad > 0 {
        return Err(Failure::Failed(format!(
            "{bad} of {} checks failed, {warned} warnings",
            findings.len()
        )));
    }
    printer.text(&format!("no check failed; {warned} warnings"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_is_below_its_finding() {
        let finding = Finding::bad("user", "not in the group tactus", "add it");
        assert_eq!(
            finding.for_a_person(),
            "BAD   user            not in the group tactus\n                      -> add it"
        );
        let line = serde_json::to_string(&Finding::ok("clock", "synchronised")).unwrap();
        assert_eq!(
            line,
            "{\"check\":\"clock\",\"verdict\":\"ok\",\"text\":\"synchronised\",\"advice\":null}"
        );
    }
}
