//! `tactus start`, `stop` and `step`: a measuring session from its beginning to its end.

#[cfg(test)]
mod tests;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use dbus::json::nonempty;
use dbus::{Session1Proxy, SessionOptions};
use serde::Serialize;

use crate::args::{Start, Step, Stop};
use crate::connection::{Daemon, fault};
use crate::failure::Failure;
use crate::options::duration::display_span;
use crate::output::Printer;
use crate::output::progress::progress;

/// Interval of the lines that report progress where no progress bar can be drawn.
const PROGRESS_INTERVAL: Duration = Duration::from_secs(10);

/// A line of `start`, `stop`, `step` and `baseline record` with `--json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub(crate) enum SessionLine {
    /// The daemon has started a session.
    Started {
        session: String,
        kind: String,
        path: String,
        simulated: bool,
    },
    /// The frame with this number is on disk.
    Stepped { session: String, sequence: u64 },
    /// A warning about the session's data.
    Warning { session: String, text: String },
    /// The session has ended: its record is closed, the source is off.
    Ended {
        session: String,
        reason: String,
        frames: u64,
        path: String,
    },
}

impl SessionLine {
    fn for_a_person(&self) -> String {
        match self {
            Self::Started {
                session,
                kind,
                simulated,
                ..
            } => {
                let simulated = if *simulated { " (SIMULATED)" } else { "" };
                format!("{kind} {session} started{simulated}")
            }
            Self::Stepped { sequence, .. } => format!("frame {sequence} is recorded"),
            Self::Warning { text, .. } => format!("warning: {text}"),
            Self::Ended {
                session,
                reason,
                frames,
                path,
            } => format!("{session} ended: {reason}; {frames} frames in {path}"),
        }
    }
}

/// Starts a measurement; with `--wait` follows it to its end.
pub(crate) async fn start(
    daemon: &Daemon,
    start: &Start,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let mut options = start_options(start)?;
    if let Some(baseline) = &start.baseline {
        options.baseline = Some(daemon.baseline_id(baseline).await?);
    }
    let path = daemon
        .ask("start", daemon.manager.start_session(&options))
        .await?;
    let session = daemon.session(path.into()).await?;
    announce(daemon, &session, printer).await?;
    warn_of_baseline(daemon, &session, printer).await?;
    if !start.wait {
        return printer.text(if start.step {
            "`tactus step` takes a frame, `tactus stop` ends it"
        } else {
            "`tactus watch` follows it, `tactus stop` ends it"
        });
    }
    let whole = match (start.count, start.every, start.duration) {
        (Some(count), _, _) => Some(count),
        (None, Some(every), Some(duration)) => {
            Some((duration.as_secs_f64() / every.as_secs_f64()).ceil() as u64)
        }
        (None, _, _) => None,
    };
    follow(daemon, &session, whole, start.within, printer).await
}

/// Remarks on a baseline, which the daemon may have to compute first. Empty if the daemon does not return them.
pub(crate) async fn remarks_on(daemon: &Daemon, baseline: &str) -> Vec<String> {
    let requested = daemon.manager.baseline_remarks(baseline);
    let remarks = daemon.ask("remarks on the baseline", requested).await;
    remarks.unwrap_or_default()
}

/// Prints the warnings about the session's baseline. If they cannot be obtained, the session continues without them.
async fn warn_of_baseline(
    daemon: &Daemon,
    session: &Session1Proxy<'_>,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let requested = async { Ok((session.id().await?, session.baseline_id().await?)) };
    let Ok((id, baseline)) = daemon.ask("the session", requested).await else {
        return Ok(());
    };
    warn_of(daemon, &baseline, &id, printer).await
}

/// Prints the warnings about a baseline as warnings of a session.
pub(crate) async fn warn_of(
    daemon: &Daemon,
    baseline: &str,
    session: &str,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let mut texts = remarks_on(daemon, baseline).await.into_iter();
    texts.try_for_each(|text| warn(session, format!("baseline {baseline}: {text}"), printer))
}

fn start_options(start: &Start) -> Result<SessionOptions, Failure> {
    let model = start
        .model
        .as_deref()
        .map(|model| absolute_model_path(model).map(|path| path.to_string_lossy().into_owned()))
        .transpose()?;
    let options = SessionOptions {
        every_s: start.every.map(|every| every.as_secs_f64()),
        count: start.count,
        for_s: start.duration.map(|duration| duration.as_secs_f64()),
        baseline: start.baseline.clone(),
        model,
        speed: start.speed,
        step: start.step.then_some(true),
        note: start.note.clone(),
        ..SessionOptions::default()
    };
    Ok(start.about.with(start.measuring.with(options)))
}

/// The absolute path of a model file, because the daemon has another working directory. `one-step` is not a file.
fn absolute_model_path(model: &Path) -> Result<PathBuf, Failure> {
    if model == Path::new("one-step") {
        return Ok(model.to_owned());
    }
    std::fs::canonicalize(model).map_err(|error| {
        Failure::configuration(&format!("model {} cannot be read", model.display()), &error)
    })
}

/// Ends the running session, or the named one.
pub(crate) async fn stop(
    daemon: &Daemon,
    stop: &Stop,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let session = chosen(daemon, stop.session.as_deref()).await?;
    // stopping waits for the current frame and for the source, and so may exceed the timeout of one reply
    session
        .stop()
        .await
        .map_err(|error| fault("stop", &error))?;
    ended(daemon, &session, None, printer).await
}

/// Takes frames in a session started with `--step`.
pub(crate) async fn step(
    daemon: &Daemon,
    step: &Step,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let session = chosen(daemon, step.session.as_deref()).await?;
    let id = daemon.ask("the session", session.id()).await?;
    let sequence = match session.step(step.frames).await {
        Ok(sequence) => sequence,
        Err(error) => {
            // a session that ended in a fault during the steps is an instrument fault
            check_end(daemon, &session).await?;
            return Err(fault("step", &error));
        }
    };
    let line = SessionLine::Stepped {
        session: id,
        sequence,
    };
    printer.record(&line, SessionLine::for_a_person)
}

async fn chosen(daemon: &Daemon, id: Option<&str>) -> Result<Session1Proxy<'static>, Failure> {
    match id {
        Some(id) => daemon.named(id).await,
        None => daemon.active().await?.ok_or_else(|| {
            Failure::Missing("no session is running; `tactus start` starts one".to_owned())
        }),
    }
}

/// Reports which session has started.
pub(crate) async fn announce(
    daemon: &Daemon,
    session: &Session1Proxy<'_>,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let line = SessionLine::Started {
        session: daemon.ask("the session", session.id()).await?,
        kind: daemon.ask("the session", session.kind()).await?,
        path: daemon.ask("the session", session.path()).await?,
        simulated: daemon.ask("the session", session.simulated()).await?,
    };
    printer.record(&line, SessionLine::for_a_person)
}

/// Prints a warning about the session's data.
pub(crate) fn warn(
    session: &str,
    text: String,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let line = SessionLine::Warning {
        session: session.to_owned(),
        text,
    };
    printer.record(&line, SessionLine::for_a_person)
}

/// Waits until a session has ended, with a progress bar on a terminal; `whole` is its number of frames, if known.
///
/// # Errors
/// [`Failure::Timeout`] after `within` (the session continues), [`Failure::Instrument`] if it ended in a fault.
pub(crate) async fn follow(
    daemon: &Daemon,
    session: &Session1Proxy<'static>,
    whole: Option<u64>,
    within: Option<Duration>,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let mut frames = daemon
        .ask("the session", async {
            session.receive_frame_done().await.map_err(Into::into)
        })
        .await?;
    let bar = progress(whole, printer.is_terminal());
    let done = async {
        let wait = session.wait();
        tokio::pin!(wait);
        let mut now_and_then = tokio::time::interval(PROGRESS_INTERVAL);
        now_and_then.reset();
        let mut taken = 0;
        loop {
            tokio::select! {
                reason = &mut wait => break reason.map_err(|error| fault("the session", &error)),
                Some(frame) = dbus::next(&mut frames) => {
                    if let Ok(frame) = frame.args() {
                        bar.set_position(frame.sequence);
                        taken = frame.sequence;
                    }
                }
                _ = now_and_then.tick(), if bar.is_hidden() => {
                    printer.text(&match whole {
                        Some(whole) => format!("{taken} of {whole} frames"),
                        None => format!("{taken} frames"),
                    })?;
                }
            }
        }
    };
    let reason = match within {
        None => done.await,
        Some(within) => tokio::time::timeout(within, done)
            .await
            .unwrap_or_else(|_| {
                Err(Failure::Timeout(format!(
                    "the session has not ended within {} and continues; `tactus status` shows it, `tactus stop` ends it",
                    display_span(within)
                )))
            }),
    };
    bar.finish_and_clear();
    let reason = match reason {
        Err(failure @ Failure::Failed(_)) => {
            check_end(daemon, session).await?;
            return Err(failure);
        }
        other => other?,
    };
    ended(daemon, session, Some(reason), printer).await
}

/// Reports how a session ended; a fault is a failure.
async fn ended(
    daemon: &Daemon,
    session: &Session1Proxy<'_>,
    reason: Option<String>,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let reason = match reason {
        Some(reason) => reason,
        None => daemon.ask("the session", session.end_reason()).await?,
    };
    let line = SessionLine::Ended {
        session: daemon.ask("the session", session.id()).await?,
        frames: daemon.ask("the session", session.frames_durable()).await?,
        path: daemon.ask("the session", session.path()).await?,
        reason,
    };
    printer.record(&line, SessionLine::for_a_person)?;
    check_end(daemon, session).await
}

/// Returns a failure if the session ended in a fault.
pub(crate) async fn check_end(daemon: &Daemon, session: &Session1Proxy<'_>) -> Result<(), Failure> {
    if daemon.ask("the session", session.state()).await? != "faulted" {
        return Ok(());
    }
    let error = nonempty(daemon.ask("the session", session.last_error()).await?);
    Err(Failure::Instrument(format!(
        "the session ended in a fault: {}; `tactus instruments` shows which ones answer",
        error.as_deref().unwrap_or("the daemon's journal names it")
    )))
}
