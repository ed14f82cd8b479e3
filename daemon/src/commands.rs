//! The commands of `tactusd` other than serving (`--safe-off`, `--print-config`, `--discover`, `--plan`), and its
//! output.

use std::io::Write;
use std::process::ExitCode;

use config::problems::Problem;
use survey::error_chain as chain;

use crate::args::Args;
use crate::instruments::address::{BadAddress, InstrumentAddress};
use crate::instruments::assembly::make_safe_each;
use crate::instruments::discovery::{Search, discover};
use crate::preparation::{FramesFrom, Prepared};
use crate::service::objects::report;

/// `EX_CONFIG`: systemd does not start a broken configuration again.
pub(crate) const CONFIGURATION: u8 = 78;
pub(crate) const FAILED: u8 = 1;
pub(crate) const USAGE: u8 = 2;
/// An instrument does not reply, or could not be made safe.
const INSTRUMENT: u8 = 5;

/// Why the program fails: its exit code and a text.
pub(crate) type Failure = (u8, String);

/// `--safe-off`.
pub(crate) async fn safe_off(prepared: &Prepared) -> Result<(), Failure> {
    let FramesFrom::Rig(plan) = &prepared.frames else {
        print_line("a recording has no source; there is nothing to switch off");
        return Ok(());
    };
    let simulated_rig = prepared.simulated_rig().map_err(|text| (FAILED, text))?;
    if simulated_rig.is_some() {
        print_line("SIMULATED: the configuration names no real instrument, and none was touched");
    }
    let mut failures = Vec::new();
    for outcome in make_safe_each(plan, &simulated_rig).await {
        match outcome {
            Ok(line) => print_line(&line),
            Err(error) => failures.push(chain(&error)),
        }
    }
    if failures.is_empty() {
        Ok(())
    } else {
        Err((INSTRUMENT, failures.join("\n")))
    }
}

pub(crate) fn print_config(args: &Args) -> Result<(), Failure> {
    let (_, config) = crate::preparation::load(&args.config).map_err(|all| of_problems(&all))?;
    let text = toml::to_string_pretty(&config).map_err(|cause| (FAILED, cause.to_string()))?;
    print_line(text.trim_end());
    Ok(())
}

/// `--discover`: needs no configuration.
pub(crate) fn print_found(addresses: &[String], json: bool) -> Result<(), Failure> {
    let addresses: Result<Vec<InstrumentAddress>, BadAddress> =
        addresses.iter().map(|address| address.parse()).collect();
    let addresses = addresses.map_err(|error| (USAGE, error.to_string()))?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|cause| (FAILED, format!("threads cannot be started: {cause}")))?;
    let search = Search {
        addresses,
        ..Search::default()
    };
    let found = runtime.block_on(discover(&search));
    // a thread still waiting for replies must not keep the process alive
    runtime.shutdown_background();
    for line in report::found_lines(&found, json) {
        print_line(&line);
    }
    Ok(())
}

pub(crate) fn print_plan(prepared: &Prepared, json: bool) -> Result<(), Failure> {
    let FramesFrom::Rig(rig) = &prepared.frames else {
        let text = "a recording has no plan: nothing is measured";
        return Err((FAILED, text.to_owned()));
    };
    let plan = report::plan(rig);
    if json {
        let object = serde_json::json!({
            "wiring": rig.plan.wiring.name,
            "electrodes": rig.plan.protocol.electrodes(),
            "steps": plan.steps,
            "injections": plan.injections,
            "readings": plan.readings,
            "relay_moves": plan.relay_moves,
            "reading_messages": plan.reading_messages,
            "duration_s": plan.duration_s,
            "current_a": plan.current_a,
            "compliance_v": plan.compliance_v,
            "limits": {
                "source_current_a": rig.limits.source_current.0,
                "relay_current_a": rig.limits.relay_current.0,
                "relay_voltage_v": rig.limits.relay_voltage.0,
            },
            "simulated": prepared.is_simulated(),
            "measuring": report::measuring(&plan.more),
            "lines": plan.lines,
        });
        print_line(&object.to_string());
        return Ok(());
    }
    print_line(rig.plan.to_string().trim_end());
    print_line(&format!(
        "{} steps, {} injections, {} relay moves, {} readings in {} messages, {:.2} s a frame",
        plan.steps,
        plan.injections,
        plan.relay_moves,
        plan.readings,
        plan.reading_messages,
        plan.duration_s
    ));
    for (name, words) in report::measuring_words(&plan.more) {
        print_line(&format!("{name}: {}", words.join(", ")));
    }
    print_line(&format!(
        "{} through {}, at most {}; limits: source {}, relays {} and {}; checked, nothing moved",
        rig.plan.current,
        rig.plan.wiring.name,
        rig.plan.compliance,
        rig.limits.source_current,
        rig.limits.relay_current,
        rig.limits.relay_voltage
    ));
    Ok(())
}

/// The problems of a configuration as a failure, one per line.
pub(crate) fn of_problems(problems: &[Problem]) -> Failure {
    let lines = problems.iter().map(ToString::to_string);
    let lines: Vec<String> = lines
        .map(|line| survey::printable(&line).into_owned())
        .collect();
    (CONFIGURATION, lines.join("\n"))
}

/// Prints on standard error why the program fails, as text or as one JSON object in the form of `tactus --json`.
pub(crate) fn report_failure((code, text): &Failure, json: bool) -> ExitCode {
    let kind = match *code {
        USAGE => "usage",
        INSTRUMENT => "instrument",
        CONFIGURATION => "configuration",
        _ => "failed",
    };
    let line = match json {
        true => survey::error_line(kind, *code, text),
        // each problem begins with the name of its file
        false if *code == CONFIGURATION => text.clone(),
        false => format!("tactusd: {}", survey::printable_lines(text)),
    };
    let _ = writeln!(std::io::stderr(), "{line}");
    ExitCode::from(*code)
}

/// Writes to standard output; a closed pipe is not an error.
pub(crate) fn print_line(text: &str) {
    let _ = writeln!(std::io::stdout(), "{}", survey::printable_lines(text));
}
