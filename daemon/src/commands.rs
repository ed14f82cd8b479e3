//! What `tactusd` does instead of serving: `--safe-off`, `--print-config`, `--discover`, `--plan`; and its output.

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

/// `--safe-off`.
pub(crate) async fn safe_off(prepared: &Prepared) -> Result<(), (u8, String)> {
    let FramesFrom::Rig(plan) = &prepared.frames else {
        print_line("a recording has no source; there is nothing to switch off");
        return Ok(());
    };
    let simulated_rig = prepared.simulated_rig().map_err(|text| (FAILED, text))?;
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

pub(crate) fn print_config(args: &Args) -> ExitCode {
    match crate::preparation::load(&args.config) {
        Err(problems) => report_problems(&problems),
        Ok((_, config)) => match toml::to_string_pretty(&config) {
            Ok(text) => {
                print_line(text.trim_end());
                ExitCode::SUCCESS
            }
            Err(cause) => fail(&cause.to_string()),
        },
    }
}

/// `--discover`: before there is a configuration.
pub(crate) fn print_found(addresses: &[String], json: bool) -> ExitCode {
    let parsed: Result<Vec<InstrumentAddress>, BadAddress> =
        addresses.iter().map(|address| address.parse()).collect();
    let addresses = match parsed {
        Ok(addresses) => addresses,
        Err(error) => {
            let _ = fail(&error.to_string());
            return ExitCode::from(USAGE);
        }
    };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build();
    let runtime = match runtime {
        Ok(runtime) => runtime,
        Err(cause) => return fail(&format!("no threads to run on: {cause}")),
    };
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
    ExitCode::SUCCESS
}

pub(crate) fn print_plan(prepared: &Prepared, json: bool) -> ExitCode {
    let FramesFrom::Rig(rig) = &prepared.frames else {
        return fail("a recording has no plan: nothing is measured");
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
        return ExitCode::SUCCESS;
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
    ExitCode::SUCCESS
}

pub(crate) fn report_problems(problems: &[Problem]) -> ExitCode {
    for problem in problems {
        let problem = problem.to_string();
        let _ = writeln!(std::io::stderr(), "{}", survey::printable(&problem));
    }
    ExitCode::from(CONFIGURATION)
}

pub(crate) fn fail(text: &str) -> ExitCode {
    let _ = writeln!(
        std::io::stderr(),
        "tactusd: {}",
        survey::printable_lines(text)
    );
    ExitCode::FAILURE
}

/// Writes to standard output; a closed pipe is not an error.
pub(crate) fn print_line(text: &str) {
    let _ = writeln!(std::io::stdout(), "{}", survey::printable_lines(text));
}
