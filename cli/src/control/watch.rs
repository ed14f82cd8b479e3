//! `tactus watch`: displays every frame of a session with its map in the terminal.

use std::cell::Cell;
use std::io::Write;
use std::os::unix::net::UnixStream;
use std::time::Duration;

use dbus::json::Recovery;
use dbus::{Fault, Session1Proxy, StreamOptions};
use survey::printable;
use tokio::signal::unix::{SignalKind, signal};
use tokio::task::JoinSet;
use tokio::time::Instant;

use crate::args::Watch;
use crate::connection::Daemon;
use crate::control::health::remark_on_baseline;
use crate::control::session;
use crate::control::status::attempts;
use crate::control::viewer::{self, Viewer};
use crate::failure::Failure;
use crate::maps::drawing::Field;
use crate::options::duration::{display_long, display_span};
use crate::output::screen::Screen;
use crate::output::{Printer, complain};

/// Interval of the queries for a started session.
const POLL_INTERVAL: Duration = Duration::from_millis(200);
/// Time without a frame after which the reason for that is displayed.
const SILENCE: Duration = Duration::from_secs(2);

/// Follows a session until it ends, or until `--count` or `--for` is reached.
pub(crate) async fn run(
    daemon: &Daemon,
    watch: &Watch,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let deadline = watch.duration.map(|duration| Instant::now() + duration);
    let session = match &watch.session {
        Some(id) => daemon.named(id).await?,
        None => match first(daemon, deadline, printer).await? {
            Some(session) => session,
            None => {
                return Err(Failure::Timeout(format!(
                    "no session has started within {}; `tactus start` starts one",
                    display_span(watch.duration.unwrap_or_default())
                )));
            }
        },
    };
    let id = daemon.ask("the session", session.id()).await?;
    let maps = !daemon
        .ask("the session", session.method())
        .await?
        .is_empty();
    let field = if maps {
        let geometry = daemon.manager.geometry();
        Some(Field::from_bus(
            &daemon.ask("the geometry", geometry).await?,
        )?)
    } else {
        None
    };
    let of_frames = maps && !watch.fast;
    let options = StreamOptions {
        frames: Some(!watch.fast),
        maps: Some(of_frames),
        pressure: Some(of_frames),
        quality: Some(of_frames),
        injections: watch.fast.then_some(true),
        deviations: watch.sd.then_some(true),
        ring: None,
    };
    let descriptor = daemon
        .ask("the stream", session.open_stream(&options))
        .await?;
    let stream = UnixStream::from(std::os::fd::OwnedFd::from(descriptor));
    let unreadable = |error: std::io::Error| Failure::failed("the stream cannot be read", &error);
    stream.set_nonblocking(true).map_err(unreadable)?;
    let stream = tokio::net::UnixStream::from_std(stream).map_err(unreadable)?;
    let listening = async { Ok(daemon.manager.receive_happened().await?) };
    let mut news = daemon.ask("the events", listening).await?;
    let listening = async { session.receive_frame_done().await.map_err(Into::into) };
    let mut frames = daemon.ask("the frames", listening).await?;
    let on_screen = maps && printer.is_terminal() && !watch.no_map;
    // before the alternate screen, so that a signal right after entering it leaves the screen too
    let mut signals = end_signals(on_screen);
    let screen = match on_screen {
        true => Some(Screen::enter()?),
        false => None,
    };
    let message = |text: &str| match &screen {
        Some(screen) => screen.message(text),
        None => {
            complain(text);
            Ok(())
        }
    };
    let warned = async {
        let remarks = match daemon.ask("the session", session.baseline_id()).await {
            Ok(baseline) => session::remarks_on(daemon, &baseline).await,
            Err(_) => Vec::new(),
        };
        if let Some(remark) = remark_on_baseline(&remarks) {
            message(&printable(&format!("baseline, warning: {remark}")))?;
        }
        std::future::pending().await
    };
    let judged = async {
        let mut before = String::new();
        while let Some(signal) = dbus::next(&mut frames).await {
            let Ok(done) = signal.args() else { continue };
            let flags = done.summary.quality.flags.clone().unwrap_or_default();
            if flags != before {
                message(&quality(done.sequence, &printable(&flags)))?;
                before = flags;
            }
        }
        std::future::pending().await
    };
    // a suspended session sends no frames; the reason and the number of the attempt are printed next to the maps
    let events = async {
        while let Some(signal) = dbus::next(&mut news).await {
            if let Ok(event) = signal.args() {
                message(&format!("{}: {}", event.kind, printable(event.text)))?;
            }
        }
        std::future::pending().await
    };
    let noise = {
        let id = id.clone();
        async move || {
            let session = daemon.manager.status().await.ok()?.session?;
            session
                .map_noise
                .filter(|_| session.id.as_deref() == Some(&id))
        }
    };
    let shown_at = Cell::new(Instant::now());
    let waiting = async {
        let mut before = None;
        loop {
            tokio::time::sleep(POLL_INTERVAL.max(SILENCE.saturating_sub(shown_at.get().elapsed())))
                .await;
            if shown_at.get().elapsed() < SILENCE {
                continue;
            }
            let status = daemon.ask("the status", daemon.manager.status()).await?;
            let (why, next) = reason(&id, status);
            match &screen {
                Some(screen) => screen.waiting(&format!("{why}{}", next.unwrap_or_default()))?,
                None if before.as_ref() != Some(&why) => complain(&why),
                None => {}
            }
            before = Some(why);
        }
    };
    let mut viewer = Viewer::new(
        id.clone(),
        watch,
        field,
        screen.as_ref(),
        &shown_at,
        printer,
    );
    if screen.is_some() && !watch.fast {
        let map = async { Fault::available(session.latest_map().await) };
        if let Some(latest) = daemon.ask("the last map", map).await? {
            let pressure = async { Fault::available(session.latest_pressure().await) };
            let pressure = daemon.ask("the last pressure", pressure).await?;
            viewer.show_latest(latest, pressure, noise().await)?;
        }
    }
    let ended = tokio::select! {
        ended = viewer.follow(stream, deadline, noise) => ended,
        ended = events => ended,
        ended = warned => ended,
        ended = judged => ended,
        ended = waiting => ended,
        number = first_of(&mut signals) => Err(Failure::Signal(number)),
    };
    let last = viewer.last_sentence();
    if let Some(screen) = screen {
        screen.close();
        if let Some(last) = last {
            printer.text(&last)?;
        }
    }
    match ended? {
        Some(reason) => viewer::end(daemon, &session, id, reason, printer).await,
        None => Ok(()),
    }
}

/// Waits for each signal that requests the program's end; a task returns the number of its signal. Without the
/// alternate screen there is nothing to restore, and the signals keep their default action.
pub(crate) fn end_signals(on_screen: bool) -> JoinSet<u8> {
    let signals = [
        (SignalKind::interrupt(), 2),
        (SignalKind::terminate(), 15),
        (SignalKind::hangup(), 1),
    ];
    let mut waits = JoinSet::new();
    for (kind, number) in signals.into_iter().filter(|_| on_screen) {
        if let Ok(mut received) = signal(kind) {
            waits.spawn(async move {
                received.recv().await;
                number
            });
        }
    }
    waits
}

/// The number of the first signal that arrives.
pub(crate) async fn first_of(signals: &mut JoinSet<u8>) -> u8 {
    match signals.join_next().await {
        Some(Ok(number)) => number,
        Some(Err(_)) | None => std::future::pending().await,
    }
}

/// The reason why no frame arrives, and when the next one is expected.
fn reason(id: &str, status: dbus::Status) -> (String, Option<String>) {
    let session = status.session.unwrap_or_default();
    if session.id.as_deref() != Some(id) {
        return (format!("waiting: {id} is no longer running"), None);
    }
    if let Some(recovery) = status.recovery.and_then(Recovery::from) {
        return (format!("waiting: {}", attempts(&recovery)), None);
    }
    if session.state.as_deref() == Some("suspended") {
        return (format!("waiting: {id} is suspended"), None);
    }
    let frame = match session.frames_acquired {
        None | Some(0) => "the first frame".to_owned(),
        Some(frames) => format!("frame {}", frames + 1),
    };
    let why = |more: &str| format!("waiting for {frame} of {id}{more}");
    let health = status.health.unwrap_or_default();
    match (health.period_s, health.quiet_s) {
        (Some(period), Some(quiet)) if period > 0.0 => {
            let left = (period - quiet).max(0.0);
            (
                why(&format!(": a frame every {}", display_long(period))),
                Some(format!(", the next in {}", display_long(left))),
            )
        }
        // a running session that takes frames on command
        (_, None) => (why(": `tactus step` takes it"), None),
        _ => (why(""), None),
    }
}

/// Result of a frame's checks as text, printed when it changes.
fn quality(frame: u64, flags: &str) -> String {
    match flags {
        "" => format!("quality: no flags from frame {frame} on"),
        flags => format!(
            "quality: frame {frame} raises {}",
            flags.replace(',', ", ").replace('_', " ")
        ),
    }
}

/// The running session, or the next one to start; `None` at the timeout.
async fn first(
    daemon: &Daemon,
    deadline: Option<Instant>,
    printer: &mut Printer<impl Write>,
) -> Result<Option<Session1Proxy<'static>>, Failure> {
    let mut announced = false;
    loop {
        if let Some(session) = daemon.active().await? {
            return Ok(Some(session));
        }
        if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            return Ok(None);
        }
        if !announced {
            printer.text("no session is running; waiting for one (`tactus start`)")?;
            announced = true;
        }
        tokio::time::sleep(POLL_INTERVAL).await;
    }
}

#[cfg(test)]
mod tests {
    use crate::control::watch::*;

    #[test]
    fn flags_are_printed_as_words() {
        assert_eq!(
            quality(7, "reciprocity,loop_sum"),
            "quality: frame 7 raises reciprocity, loop sum"
        );
        assert_eq!(quality(8, ""), "quality: no flags from frame 8 on");
    }
}
