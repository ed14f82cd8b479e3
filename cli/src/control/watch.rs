//! `tactus watch`: every frame of a session as it comes, with its map in the terminal.

use std::io::Write;
use std::os::unix::net::UnixStream;
use std::time::Duration;

use dbus::{Session1Proxy, StreamOptions};
use survey::printable;
use tokio::time::Instant;

use crate::args::Watch;
use crate::connection::Daemon;
use crate::control::viewer::Viewer;
use crate::failure::Failure;
use crate::maps::drawing::Field;
use crate::options::duration::display_span;
use crate::output::{Printer, complain};

/// How often the daemon is asked whether a session has begun.
const LOOK_AGAIN: Duration = Duration::from_millis(200);
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
        Some(Field::from_bus(
            daemon
                .ask("the geometry", daemon.manager.geometry())
                .await?,
        )?)
    } else {
        None
    };
    let options = StreamOptions {
        frames: Some(true),
        maps: Some(maps),
        pressure: Some(maps),
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
    let mut news = daemon.ask("the news", listening).await?;
    let listening = async { session.receive_frame_done().await.map_err(Into::into) };
    let mut frames = daemon.ask("the frames", listening).await?;
    let judged = async {
        let mut before = String::new();
        while let Some(signal) = dbus::next(&mut frames).await {
            let Ok(done) = signal.args() else { continue };
            let flags = done.summary.quality.flags.clone().unwrap_or_default();
            if flags != before {
                complain(&quality(done.sequence, &printable(&flags)));
                before = flags;
            }
        }
        std::future::pending().await
    };
    // a suspended session sends no frames: why, and which try this is, is printed beside the maps
    let events = async {
        while let Some(signal) = dbus::next(&mut news).await {
            if let Ok(event) = signal.args() {
                complain(&format!("{}: {}", event.kind, printable(event.text)));
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
    let mut viewer = Viewer::new(id, watch, field, printer);
    let ended = tokio::select! {
        ended = viewer.follow(stream, deadline, noise) => ended?,
        ended = events => ended,
        ended = judged => ended,
    };
    match ended {
        Some(reason) => viewer.end(daemon, &session, reason).await,
        None => Ok(()),
    }
}

/// What a frame's checks report, printed when it changes.
fn quality(frame: u64, flags: &str) -> String {
    match flags {
        "" => format!("quality: from frame {frame} on nothing is the matter"),
        flags => format!(
            "quality: frame {frame} raises {}",
            flags.replace(',', ", ").replace('_', " ")
        ),
    }
}

/// The running session, or the next to start; `None` at the deadline.
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
        tokio::time::sleep(LOOK_AGAIN).await;
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
        assert!(quality(8, "").contains("nothing"));
    }
}
