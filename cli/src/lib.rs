//! The program `tactus`.
//!
//! It converts a command line to calls of a running daemon (status, baseline, start, stop, watch, plan) or to work on
//! recorded files without one (sessions, export, replay), and prints text or, with `--json`, one object per line for
//! scripts. It does not depend on instruments or on the daemon's internals. All output is real: without a daemon it
//! reports how to start one, and a missing reading is a blank, never a number.
//!
//! The modules build on each other in this order: `options`, `output` and `runtime`; `connection` (to the daemon),
//! `archived` (sessions in the archive) and `session_files`; `maps`; and the commands in `control`, `instruments`,
//! `records` and `doctor`.
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
mod runtime;
mod session_files;

use std::ffi::OsString;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use clap::CommandFactory;

use args::{Arguments, BaselineCommand, Command, Global, InstrumentsCommand, NotifyCommand};
use connection::Daemon;
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
    let global = &global;
    match command {
        Command::Status => live(global, async |daemon| {
            control::status::run(daemon, printer).await
        }),
        Command::Instruments { what } => live(global, async |daemon| {
            of_instruments(daemon, what, printer).await
        }),
        Command::Baseline { what } => of_baseline(global, what, printer),
        Command::Start(start) => live(global, async |daemon| {
            control::session::start(daemon, &start, printer).await
        }),
        Command::Stop(stop) => live(global, async |daemon| {
            control::session::stop(daemon, &stop, printer).await
        }),
        Command::Step(step) => live(global, async |daemon| {
            control::session::step(daemon, &step, printer).await
        }),
        Command::Watch(watch) => live(global, async |daemon| {
            control::watch::run(daemon, &watch, printer).await
        }),
        Command::Top(requested) => control::top::run(global, &requested, printer),
        Command::Web(requested) => control::web::run(global, &requested, printer),
        Command::Sessions(requested) => match &requested.what {
            None => records::sessions::run(global, &requested, printer),
            Some(what) => records::maintenance::run(global, what, printer),
        },
        #[cfg(feature = "archive")]
        Command::Archive { task } => archived::run(global, &task),
        Command::Events { session } => records::events::run(global, &session, printer),
        Command::Log(log) if log.follow => live(global, async |daemon| {
            records::log::follow(daemon, &log, printer).await
        }),
        Command::Log(log) => records::log::run(global, &log, printer),
        Command::Alarms(requested) => live(global, async |daemon| {
            control::alarms::run(daemon, &requested, printer).await
        }),
        Command::Notify {
            what: NotifyCommand::Test,
        } => live(global, async |daemon| {
            control::notify::test(daemon, printer).await
        }),
        Command::Doctor(requested) => doctor::run(global, &requested, printer),
        Command::Export(export) => records::export::run(global, &export, printer),
        Command::Report(requested) => records::report::run(global, &requested, printer),
        Command::Replay(replay) => maps::replay::run(global, &replay, printer),
        Command::Quantities(requested) => maps::quantities::run(global, &requested, printer),
        Command::Plan(requested) => live(global, async |daemon| {
            control::plan::run(daemon, &requested, printer).await
        }),
        Command::Reload => live(global, async |daemon| {
            instruments::recovery::reload(daemon, printer).await
        }),
        Command::Transcript(requested) => live(global, async |daemon| {
            instruments::recovery::transcript(daemon, &requested, printer).await
        }),
        Command::Completions { shell } => printer.raw(&completions::script(shell)),
        Command::Man { folder } => manual(&folder),
    }
}

/// Runs a command that needs a running daemon.
fn live(
    global: &Global,
    command: impl AsyncFnOnce(&Daemon) -> Result<(), Failure>,
) -> Result<(), Failure> {
    runtime::current_thread()?.block_on(async {
        let daemon = connection::open(global).await?;
        command(&daemon).await
    })
}

async fn of_instruments(
    daemon: &Daemon,
    what: Option<InstrumentsCommand>,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    match what {
        None => instruments::run(daemon, printer).await,
        Some(InstrumentsCommand::Test { all }) => {
            instruments::self_test::test(daemon, all, printer).await
        }
        Some(InstrumentsCommand::Relays) => instruments::self_test::relays(daemon, printer).await,
        Some(InstrumentsCommand::Discover(discover)) => {
            instruments::discover::run(daemon, &discover, printer).await
        }
        Some(InstrumentsCommand::OpenAll) => instruments::recovery::open_all(daemon, printer).await,
        Some(InstrumentsCommand::Accept) => instruments::recovery::accept(daemon, printer).await,
    }
}

fn of_baseline(
    global: &Global,
    what: BaselineCommand,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let order = match what {
        BaselineCommand::List => return records::sessions::baselines(global, printer),
        BaselineCommand::Record(record) => {
            return live(global, async |daemon| {
                control::baseline::record(daemon, &record, printer).await
            });
        }
        BaselineCommand::Show => {
            return live(global, async |daemon| {
                control::baseline::show(daemon, printer).await
            });
        }
        BaselineCommand::Use { id } => {
            return live(global, async |daemon| {
                control::baseline::choose(daemon, &id, printer).await
            });
        }
        BaselineCommand::EmptyNow => TrackingOrder::EmptyNow,
        BaselineCommand::LoadedNow => TrackingOrder::LoadedNow,
        BaselineCommand::ForgetAnchor => TrackingOrder::ForgetAnchor,
    };
    live(global, async |daemon| {
        control::baseline::order(daemon, order, printer).await
    })
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
                // creates a new session file by the logbook, which never overwrites one
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
