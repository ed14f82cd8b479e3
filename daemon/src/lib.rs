//! The daemon `tactusd`, as a library. [`run`] is its entry point; the other public functions describe the command
//! line, the events and the metrics for reference pages.
//!
//! The daemon owns the instruments (or plays a recording), runs sessions by a schedule, subtracts a baseline from each
//! frame, reconstructs, records, and publishes. It never substitutes a simulator for a missing instrument, and never
//! publishes a frame before it is durable. No client can delay acquisition.
//!
//! - **preparation**: resolves a configuration without connecting to an instrument
//! - **instruments**: addresses, locks, identities and assembly of a rig, relay wear, discovery
//! - **session**: the controller, and the states of the daemon as a pure state machine
//! - **acquisition**: the frames of one session
//! - **recording**: maps, sinks (the logbook first), the full-rate stream, the sessions on disk
//! - **service**: D-Bus objects, access control, limits
//! - **events**: kinds of events, the daemon's log, the journal; **monitoring**: status, metrics, notifications
//! - **alarms**: the daemon's problems and the rules of `[[alarm]]`, judged by one state machine
//! - **panics**: the consequences of a panic in each kind of task
//!
//! ```
//! // runs a command line; `--version` succeeds
//! let args = ["tactusd", "--version"].map(std::ffi::OsString::from);
//! assert_eq!(daemon::run(args.into_iter()), std::process::ExitCode::SUCCESS);
//! ```

pub(crate) mod acquisition;
pub(crate) mod alarms;
mod args;
mod commands;
pub(crate) mod events;
pub(crate) mod instruments;
mod locked;
mod man;
mod monitoring;
pub(crate) mod panics;
mod preparation;
pub(crate) mod recording;
mod service;
pub(crate) mod session;

use std::ffi::OsString;
use std::process::ExitCode;

use crate::events::kind::EventKind;
use rig::{Clock, SystemClock};
use rustix::fs::Mode;
use rustix::process::umask;
use sd_notify::NotifyState;
use tokio::signal::unix::{SignalKind, signal};

use crate::args::Args;
use crate::commands::{
    FAILED, Failure, USAGE, of_problems, print_config, print_found, print_line, print_plan,
    report_failure, safe_off,
};
pub use crate::events::kind::{EventRow, event_kinds};
use crate::instruments::assembly::{Assembled, AssemblyError, OnClosedRelays, assemble};
use crate::instruments::identities::ExpectedIdentities;
pub use crate::monitoring::metrics::{MetricRow, metrics};
use crate::monitoring::service_manager;
use crate::preparation::{FramesFrom, Prepared, prepare};
use crate::recording::records::Records;
use crate::service::Listener;
use crate::session::controller::Controller;
use survey::error_chain as chain;

/// Program and version, as records name them.
pub(crate) const BUILD: &str = concat!("tactusd ", env!("CARGO_PKG_VERSION"));

/// Permissions removed from all files that the daemon creates: write access for the group, all access for others.
const UMASK: Mode = Mode::WGRP.union(Mode::RWXO);

/// Maximum number of threads for blocking work: the session's disk, simulated instruments. Reading for clients has
/// separate threads. Without a limit, a session of a million frames on a machine that also ran compilers started 28
/// threads, with 2 MB of memory.
const BLOCKING: usize = 12;

/// The definition of the command line: every command and option, for reference pages and completions.
pub fn command() -> clap::Command {
    let command = <Args as clap::CommandFactory>::command();
    help_examples::with_examples(command, include_str!("examples.txt"))
}

/// The program `tactusd`. `args` begins with the program's name, as in [`std::env::args_os`].
///
/// Exit codes: 0 done or stopped cleanly, 1 failed, 2 usage, 5 an instrument fault at `--safe-off`, 78 configuration.
pub fn run(args: impl Iterator<Item = OsString>) -> ExitCode {
    let args: Vec<OsString> = args.collect();
    let json = survey::asks_for_json(&args);
    let report = |text| report_failure(&(USAGE, text), json);
    let args = match help_examples::parsed::<Args>(&command(), &args, json, report) {
        Ok((_, args)) => args,
        Err(code) => return code,
    };
    crate::events::journal::begin();
    match perform(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => report_failure(&failure, json),
    }
}

/// Runs the command that the command line requests, or serves.
fn perform(args: &Args) -> Result<(), Failure> {
    if let Some(folder) = &args.man {
        let written = man::write(folder);
        return written.map_err(|cause| {
            (
                FAILED,
                format!("the manual pages cannot be written: {cause}"),
            )
        });
    }
    if args.print_config {
        return print_config(args);
    }
    if let Some(addresses) = &args.discover {
        return print_found(addresses, args.json);
    }
    let prepared = prepare(&args.config).map_err(|problems| of_problems(&problems))?;
    let serves = !args.plan && !args.safe_off;
    if serves && let Some(problem) = prepared.unusable_record() {
        return Err(of_problems(&[problem]));
    }
    if args.check {
        let mut warnings = prepared.warnings();
        warnings.extend(prepared.machine_warnings());
        for warning in &warnings {
            print_line(&format!("{}: warning: {warning}", args.config.display()));
        }
        let found = match warnings.is_empty() {
            true => "no problem found",
            false => "no error found",
        };
        print_line(&format!("{}: {found}", args.config.display()));
        return Ok(());
    }
    if args.plan {
        return print_plan(&prepared, args.json);
    }
    if serves && let Some(problem) = prepared.closed_record() {
        // the disk of the record may be mounted later: the systemd unit starts the daemon again
        return Err((FAILED, problem.to_string()));
    }
    // records are readable by their group and not by others, also if a user starts the daemon
    let before = umask(UMASK);
    umask(before | UMASK);
    crate::panics::hook::install();
    let rig = match &prepared.frames {
        FramesFrom::Rig(plan) if plan.simulation.is_none() => Some(std::sync::Arc::clone(plan)),
        _ => None,
    };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .max_blocking_threads(BLOCKING)
        .enable_all()
        .build()
        .map_err(|cause| (FAILED, format!("threads cannot be started: {cause}")))?;
    let life = async {
        if args.safe_off {
            safe_off(&prepared).await
        } else {
            serve(prepared).await.map_err(|text| (FAILED, text))
        }
    };
    let outcome = crate::instruments::last_resort::run(runtime, rig.as_deref(), life);
    outcome.unwrap_or_else(|| {
        let text = "the daemon's own code failed; its log says where, please report it";
        Err((FAILED, text.to_owned()))
    })
}

/// Runs the daemon.
async fn serve(prepared: Prepared) -> Result<(), String> {
    let mut terminate = signal(SignalKind::terminate()).map_err(|cause| cause.to_string())?;
    let mut interrupt = signal(SignalKind::interrupt()).map_err(|cause| cause.to_string())?;
    let mut hangup = signal(SignalKind::hangup()).map_err(|cause| cause.to_string())?;
    // with a handler, exceeding a file size limit is an error of the write and does not end the process
    let _file_size =
        signal(SignalKind::from_raw(libc::SIGXFSZ)).map_err(|cause| cause.to_string())?;
    let panics = crate::panics::hook::listen();
    let transcript = rig::RingTranscript::new(prepared.setup.transcripts);
    let _lock = logbook::lock(&prepared.setup.record_directory).map_err(|error| chain(&error))?;
    let records = clean_index(prepared.setup.record_directory.clone()).await?;
    let clock = SystemClock::new();
    let simulated_rig = prepared.simulated_rig()?;
    let identities = ExpectedIdentities::recall(&prepared.setup.record_directory)
        .map_err(|error| chain(&error))?;
    let mut locks = crate::instruments::lock::InstrumentLocks::default();
    if let FramesFrom::Rig(plan) = &prepared.frames {
        // locked before anything is sent to an instrument
        locks = locks
            .of_rig(&plan.instruments)
            .map_err(|error| error.to_string())?;
    }
    let mut others = None;
    let mut opened = None;
    let assembled = match &prepared.frames {
        FramesFrom::Rig(plan) => {
            match assemble(
                plan,
                &simulated_rig,
                &transcript,
                OnClosedRelays::Refuse,
                identities.as_ref(),
            )
            .await
            {
                Ok(assembled)
                    if assembled.closed.is_some()
                        && is_left_by_killed_daemon(&prepared, &assembled, &records) =>
                {
                    // the connections are closed first: a source accepts only one
                    let was = assembled.closed.clone();
                    drop(assembled);
                    opened = was;
                    let again = assemble(
                        plan,
                        &simulated_rig,
                        &transcript,
                        OnClosedRelays::Open,
                        identities.as_ref(),
                    )
                    .await;
                    Some(again.map_err(|error| chain(&error))?)
                }
                Ok(assembled) => Some(assembled),
                Err(AssemblyError::Others {
                    text, source_off, ..
                }) => {
                    others = Some((text, source_off));
                    None
                }
                Err(error) => return Err(chain(&error)),
            }
        }
        FramesFrom::Recording { .. } => None,
    };
    let closed = assembled.as_ref().and_then(|rig| rig.closed.clone());
    let section = prepared.setup.config.bus.clone();
    let start = prepared.setup.config.schedule.start;
    let controller = Controller::new(
        prepared,
        simulated_rig,
        assembled,
        records,
        transcript,
        clock,
    );
    controller.hold(locks);
    tokio::spawn(crate::session::panics::follow_panics(
        std::sync::Arc::clone(&controller),
        panics,
    ));
    tokio::spawn(crate::monitoring::heartbeat::report_to_systemd(
        std::sync::Arc::clone(&controller.heartbeats),
        clock,
        section.clone(),
        controller.events.clone(),
    ));
    tokio::spawn(crate::session::observer::observe(std::sync::Arc::clone(
        &controller,
    )));
    let listener = Listener::open(&section, &controller)
        .await
        .map_err(|error| chain(&error))?;
    match (others, identities) {
        (Some((found, source_off)), Some(identities)) => {
            controller
                .wait_for_the_expected(identities, &found, source_off)
                .await;
        }
        _ => controller.keep_identities().await,
    }
    if let Some(was) = opened {
        let text = format!(
            "a session of this daemon was interrupted with these instruments; the source is off and the relays are open, \
             verified; before: {was}"
        );
        controller.report(None, EventKind::Opened, &text).await;
    }
    // a record that takes long to read is read in the background: it delays neither readiness nor a stop
    let reads = controller.has_much_to_read();
    let goes_on = !reads && controller.resume_interrupted().await;
    tracing::info!("ready on {}", listener.descriptions.join(", "));
    if let Some(closed) = closed {
        let text = format!("the source is off, verified; nothing is measured: {closed}");
        controller
            .report(None, EventKind::RelaysClosed, &text)
            .await;
    }
    service_manager::notify(&[NotifyState::Ready, NotifyState::Status("idle")]);
    let begins = begin(std::sync::Arc::clone(&controller), start && !goes_on, reads);
    let beginning = match reads {
        true => Some(tokio::spawn(begins)),
        false => {
            begins.await;
            None
        }
    };
    let (why, for_good) = loop {
        tokio::select! {
            _ = terminate.recv() => break ("the daemon was stopped (SIGTERM)", false),
            // an interrupt from the terminal
            _ = interrupt.recv() => break ("the daemon was stopped (SIGINT)", true),
            _ = hangup.recv() => reload(&controller).await,
        }
    };
    service_manager::notify(&[NotifyState::Stopping, NotifyState::Status("stopping")]);
    tracing::info!("{why}");
    if let Some(beginning) = beginning {
        // no session may start any more
        beginning.abort();
        let _ = beginning.await;
    }
    let safe = controller.shut_down(why, for_good).await;
    controller.report(None, EventKind::Stopped, why).await;
    controller.events.close().await;
    listener.close().await;
    service_manager::finish();
    safe
}

/// The index of the record's directory, after files that killed daemons left there have been removed, or merged into
/// their sessions.
async fn clean_index(directory: std::path::PathBuf) -> Result<Records, String> {
    let read = move || {
        let records = Records::of(&directory);
        let clean_index = records.tidy();
        (records, clean_index)
    };
    let (records, outcome) = tokio::task::spawn_blocking(read)
        .await
        .map_err(|failure| format!("the record's directory could not be read: {failure}"))?;
    let clean_index = match outcome {
        Ok(clean_index) => clean_index,
        Err(error) => {
            tracing::warn!("{}", chain(&error));
            return Ok(records);
        }
    };
    let names = |paths: &[std::path::PathBuf]| -> String {
        let each: Vec<String> = paths
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        each.join(", ")
    };
    if !clean_index.removed.is_empty() {
        tracing::warn!(
            "removed, because their writer was killed before it wrote anything: {}",
            names(&clean_index.removed)
        );
    }
    if !clean_index.merged.is_empty() {
        tracing::info!("journals merged into {}", names(&clean_index.merged));
    }
    for error in clean_index.refused {
        tracing::warn!("{}", chain(&error));
    }
    Ok(records)
}

/// Whether closed relays were left by a killed daemon: the record has an interrupted session with the same instruments,
/// whose last frame is at most `record.resume_within_h` old.
fn is_left_by_killed_daemon(prepared: &Prepared, assembled: &Assembled, records: &Records) -> bool {
    let within_h = prepared.setup.config.record.resume_within_h;
    let now = SystemClock::new().wall();
    // files are searched for one more day, in case the file system's clock differs
    let since = chrono::TimeDelta::try_milliseconds(((within_h + 24.0) * 3.6e6) as i64)
        .and_then(|span| now.checked_sub_signed(span))
        .unwrap_or(chrono::DateTime::<chrono::Utc>::MIN_UTC);
    let Ok(interrupted) = records.interrupted_since(since) else {
        return false;
    };
    interrupted.into_iter().any(|session| {
        let last = session.last.unwrap_or(session.started);
        let age_s = now.signed_duration_since(last).num_seconds() as f64;
        age_s <= within_h * 3600.0
            && logbook::SessionReader::open(&session.path).is_ok_and(|session| {
                let then = &session.header().instruments;
                !then.is_empty()
                    && then
                        .iter()
                        .all(|one| assembled.identities.has_recorded(one))
            })
    })
}

/// Starts the scheduled session if `start` is set. If `reads` is set, first reads the record and resumes an interrupted
/// session, which is then not followed by a start.
async fn begin(controller: std::sync::Arc<Controller>, start: bool, reads: bool) {
    let mut goes_on = false;
    if reads {
        controller.read_the_record().await;
        goes_on = controller.resume_interrupted().await;
        controller.begin_to_start();
    }
    if start
        && !goes_on
        && let Err(fault) = controller.start_session(&dbus::Options::new()).await
    {
        tracing::error!("the scheduled session could not be started: {fault}");
    }
}

/// Reloads the configuration on SIGHUP, and notifies systemd of the beginning and the end (`Type=notify-reload`).
async fn reload(controller: &std::sync::Arc<Controller>) {
    let mut begins = vec![NotifyState::Reloading];
    begins.extend(NotifyState::monotonic_usec_now().ok());
    service_manager::notify(&begins);
    // the outcome is reported by the controller
    let _ = controller.reload().await;
    service_manager::notify(&[NotifyState::Ready]);
}
