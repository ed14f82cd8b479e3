//! The program `tactus`.
//!
//! It converts a command line to calls of a running daemon (status, baseline, start, stop, watch, plan) or to work on
//! recorded files without one (sessions, export, replay), and prints text or, with `--json`, one object per line for
//! scripts. It does not depend on instruments or on the daemon's internals. All output is real: without a daemon it
//! reports how to start one, and a missing reading is a blank, never a number.
//!
//! The modules build on each other in this order: `options` and `output`; `connection` (to the daemon), `archived` (sessions in
//! the archive) and `session_files`; `maps`; and the commands in `control`, `instruments`, `records` and `doctor`.
//!
//! ```
//! use std::process::ExitCode;
//! let done = cli::run(["tactus", "completions", "bash"].map(Into::into).into_iter());
//! assert_eq!(format!("{done:?}"), format!("{:?}", ExitCode::SUCCESS));
//! ```

#[cfg(feature = "archive")]
mod archived;
mod args;
mod completions;
mod connection;
mod control;
mod doctor;
mod failure;
mod instruments;
mod maps;
mod options;
mod output;
mod records;
mod session_files;

use std::ffi::OsString;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use clap::CommandFactory;

use args::{Arguments, BaselineCommand, Command, InstrumentsCommand, NotifyCommand};
use failure::Failure;
use imaging::tracking::TrackingOrder;
use outfile::Existing;
use output::Printer;

pub use crate::options::duration::{SpanError, parse_span};

/// The definition of the command line: every command and option, for reference pages and completions.
pub fn command() -> clap::Command {
    let mut examples = include_str!("examples.txt").to_owned();
    if cfg!(feature = "archive") {
        examples.push_str(include_str!("examples-archive.txt"));
    }
    help_examples::with_examples(Arguments::command(), &examples)
}

/// Runs `tactus` with the arguments of the process, the program's name first, and returns its exit code.
pub fn run(args: impl Iterator<Item = OsString>) -> ExitCode {
    let args: Vec<OsString> = args.collect();
    let command = command();
    let report = |text: String| {
        output::report(&Failure::Usage(text.trim_end().to_owned()), true);
        ExitCode::from(2)
    };
    let asks_for_json = survey::asks_for_json(&args);
    let parsed = help_examples::parsed::<Arguments>(&command, &args, asks_for_json, report);
    let (matches, arguments) = match parsed {
        Ok(parsed) => parsed,
        Err(code) => return code,
    };
    let json = arguments.global.json;
    let mut printer = Printer::stdout(json, arguments.global.colour);
    let outputs = outfile::check_arguments(&command, &matches).map_err(Failure::from);
    match outputs.and_then(|()| dispatch(arguments, &mut printer)) {
        Ok(()) | Err(Failure::Closed) => ExitCode::SUCCESS,
        Err(failure @ Failure::Signal(_)) => failure.exit_code(),
        Err(failure) => {
            output::report(&failure, json);
            failure.exit_code()
        }
    }
}

/// Writes the manual pages; the generator's own function would overwrite existing files.
fn manual(folder: &Path) -> Result<(), Failure> {
    fn pages(command: &clap::Command, folder: &Path) -> Result<(), Failure> {
        for inner in command
            .get_subcommands()
            .filter(|inner| !inner.is_hide_set())
        {
            pages(inner, folder)?;
        }
        let name = command.get_display_name().unwrap_or(command.get_name());
        let text = help_examples::manual_page(command, "1")
            .map_err(|error| Failure::failed("a manual page cannot be rendered", &error))?;
        outfile::write(&folder.join(format!("{name}.1")), Existing::Refuse, &text)?;
        Ok(())
    }
    let mut command = command().disable_help_subcommand(true);
    command.build();
    pages(&command, folder)
}

fn dispatch(arguments: Arguments, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
    let Arguments { global, command } = arguments;
    match command {
        Command::Sessions(requested) => match &requested.what {
            None => crate::records::sessions::run(&global, &requested, printer),
            Some(what) => crate::records::maintenance::run(&global, what, printer),
        },
        #[cfg(feature = "archive")]
        Command::Archive { task } => crate::archived::run(&global, &task),
        Command::Baseline {
            what: BaselineCommand::List,
        } => crate::records::sessions::baselines(&global, printer),
        Command::Log(log) if !log.follow => crate::records::log::run(&global, &log, printer),
        Command::Doctor(requested) => doctor::run(&global, &requested, printer),
        Command::Events { session } => crate::records::events::run(&global, &session, printer),
        Command::Export(export) => crate::records::export::run(&global, &export, printer),
        Command::Report(requested) => crate::records::report::run(&global, &requested, printer),
        Command::Replay(replay) => crate::maps::replay::run(&global, &replay, printer),
        Command::Quantities(requested) => {
            crate::maps::quantities::run(&global, &requested, printer)
        }
        Command::Top(requested) => crate::control::top::run(&global, &requested, printer),
        Command::Web(requested) => crate::control::web::run(&global, &requested, printer),
        Command::Completions { shell } => printer.raw(&completions::script(shell)),
        Command::Man { folder } => manual(&folder),
        live => {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build()
                .map_err(|error| {
                    Failure::failed("the asynchronous runtime cannot be started", &error)
                })?;
            runtime.block_on(async {
                let daemon = crate::connection::open(&global).await?;
                match live {
                    Command::Alarms(requested) => {
                        crate::control::alarms::run(&daemon, &requested, printer).await
                    }
                    Command::Status => crate::control::status::run(&daemon, printer).await,
                    Command::Instruments { what: None } => instruments::run(&daemon, printer).await,
                    Command::Instruments {
                        what: Some(InstrumentsCommand::Test { all }),
                    } => crate::instruments::self_test::test(&daemon, all, printer).await,
                    Command::Instruments {
                        what: Some(InstrumentsCommand::Relays),
                    } => crate::instruments::self_test::relays(&daemon, printer).await,
                    Command::Instruments {
                        what: Some(InstrumentsCommand::Discover(discover)),
                    } => crate::instruments::discover::run(&daemon, &discover, printer).await,
                    Command::Instruments {
                        what: Some(InstrumentsCommand::OpenAll),
                    } => crate::instruments::recovery::open_all(&daemon, printer).await,
                    Command::Instruments {
                        what: Some(InstrumentsCommand::Accept),
                    } => crate::instruments::recovery::accept(&daemon, printer).await,
                    Command::Log(log) => crate::records::log::follow(&daemon, &log, printer).await,
                    Command::Notify {
                        what: NotifyCommand::Test,
                    } => crate::control::notify::test(&daemon, printer).await,
                    Command::Reload => crate::instruments::recovery::reload(&daemon, printer).await,
                    Command::Transcript(requested) => {
                        crate::instruments::recovery::transcript(&daemon, &requested, printer).await
                    }
                    Command::Baseline {
                        what: BaselineCommand::Record(record),
                    } => crate::control::baseline::record(&daemon, &record, printer).await,
                    Command::Baseline {
                        what: BaselineCommand::Show,
                    } => crate::control::baseline::show(&daemon, printer).await,
                    Command::Baseline {
                        what: BaselineCommand::Use { id },
                    } => crate::control::baseline::choose(&daemon, &id, printer).await,
                    Command::Baseline {
                        what: BaselineCommand::EmptyNow,
                    } => {
                        crate::control::baseline::order(&daemon, TrackingOrder::EmptyNow, printer)
                            .await
                    }
                    Command::Baseline {
                        what: BaselineCommand::LoadedNow,
                    } => {
                        crate::control::baseline::order(&daemon, TrackingOrder::LoadedNow, printer)
                            .await
                    }
                    Command::Baseline {
                        what: BaselineCommand::ForgetAnchor,
                    } => {
                        crate::control::baseline::order(
                            &daemon,
                            TrackingOrder::ForgetAnchor,
                            printer,
                        )
                        .await
                    }
                    Command::Start(start) => {
                        crate::control::session::start(&daemon, &start, printer).await
                    }
                    Command::Stop(stop) => {
                        crate::control::session::stop(&daemon, &stop, printer).await
                    }
                    Command::Step(step) => {
                        crate::control::session::step(&daemon, &step, printer).await
                    }
                    Command::Watch(watch) => {
                        crate::control::watch::run(&daemon, &watch, printer).await
                    }
                    Command::Plan(requested) => {
                        crate::control::plan::run(&daemon, &requested, printer).await
                    }
                    Command::Baseline {
                        what: BaselineCommand::List,
                    }
                    | Command::Sessions(_)
                    | Command::Events { .. }
                    | Command::Doctor(_)
                    | Command::Export(_)
                    | Command::Report(_)
                    | Command::Replay(_)
                    | Command::Quantities(_)
                    | Command::Top(_)
                    | Command::Web(_)
                    | Command::Completions { .. }
                    | Command::Man { .. } => {
                        unreachable!("the offline commands were taken above")
                    }
                    #[cfg(feature = "archive")]
                    Command::Archive { .. } => {
                        unreachable!("the offline commands were taken above")
                    }
                }
            })
        }
    }
}

#[cfg(test)]
mod outputs {
    use clap::CommandFactory;
    use outfile::trial::{Paths, attack_every_output};

    use crate::args::Arguments;

    #[test]
    fn no_output_replaces_what_is_not_its_own() {
        let paths = Paths {
            outputs: &[
                ("export --out", "export s --format csv --out {}"),
                ("report --out", "report s --out {}"),
                ("replay --out", "replay s --out {}"),
                ("replay --png", "replay s --png {}"),
                ("transcript --out", "transcript --out {}"),
                ("man folder", "man {}"),
            ],
            inputs: &[
                "--state",
                "doctor --config",
                #[cfg(feature = "archive")]
                "--archive-config",
                #[cfg(feature = "archive")]
                "archive pull --into",
                "export --calibration",
                "export --case",
                "export --model",
                "report --calibration",
                "report --case",
                "report --model",
                "replay --calibration",
                "replay --case",
                "replay --frames",
                "replay --model",
                "quantities --calibration",
                "quantities --case",
                "quantities --frames",
                "quantities --model",
                // a new session file, created by the logbook, which never overwrites
                "sessions repair --out",
                "start --model",
                "web --token-file",
            ],
        };
        attack_every_output(&Arguments::command(), &paths, |words| {
            crate::run(words.into_iter())
        });
    }
}
