//! Writes events that belong to no session to the daemon log, on a separate thread; callers do not wait.

use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use crate::events::event::Event;
use crate::locked::locked;
use survey::error_chain as chain;

/// Maximum number of events that wait for the disk; further ones are only counted.
const QUEUE: usize = 256;
/// Longest wait for the last events on shutdown.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// Sends events to the daemon log.
#[derive(Debug)]
pub(crate) struct DaemonLogWriter {
    directory: PathBuf,
    /// `None` before the first event and after the last.
    writer: Mutex<Option<Writer>>,
    lost: AtomicU64,
}

#[derive(Debug)]
struct Writer {
    queue: SyncSender<logbook::Event>,
    done: tokio::sync::oneshot::Receiver<()>,
}

impl DaemonLogWriter {
    pub(crate) fn new(directory: PathBuf) -> Self {
        Self {
            directory,
            writer: Mutex::new(None),
            lost: AtomicU64::new(0),
        }
    }

    /// Queues an event.
    pub(crate) fn note(&self, event: &Event) {
        let mut writer = locked(&self.writer);
        if writer.is_none() {
            *writer = start(self.directory.clone());
        }
        let lost = self.lost.swap(0, Ordering::Relaxed);
        let text = match lost {
            0 => event.text.clone(),
            lost => format!(
                "{} ({lost} events before this one were lost: the disk was slow)",
                event.text
            ),
        };
        let event = logbook::Event {
            at: event.at,
            kind: event.kind.as_str().to_owned(),
            text,
        };
        let sent = writer
            .as_ref()
            .is_some_and(|writer| writer.queue.try_send(event).is_ok());
        if !sent {
            self.lost.fetch_add(lost + 1, Ordering::Relaxed);
        }
    }

    /// Waits until everything is on disk, for a limited time.
    pub(crate) async fn close(&self) {
        let writer = locked(&self.writer).take();
        if let Some(Writer { queue, done }) = writer {
            drop(queue);
            let _ = tokio::time::timeout(CLOSE_TIMEOUT, done).await;
        }
    }
}

fn start(directory: PathBuf) -> Option<Writer> {
    let (queue, events) = sync_channel(QUEUE);
    let (say, done) = tokio::sync::oneshot::channel();
    let thread = std::thread::Builder::new().name("daemon-log".to_owned());
    let started = thread.spawn(move || {
        write(&directory, &events);
        let _ = say.send(());
    });
    match started {
        Ok(_) => Some(Writer { queue, done }),
        Err(cause) => {
            tracing::warn!("no thread for the daemon log: {cause}");
            None
        }
    }
}

/// Writes until all senders are dropped. An event that cannot be written is still in the journal and on the bus.
fn write(directory: &std::path::Path, events: &Receiver<logbook::Event>) {
    let mut daemon_log = None;
    let mut refused = false;
    while let Ok(event) = events.recv() {
        let written = match &mut daemon_log {
            Some(daemon_log) => logbook::DaemonLog::append(daemon_log, &event),
            None => logbook::DaemonLog::open(directory).and_then(|mut opened| {
                opened.append(&event)?;
                daemon_log = Some(opened);
                Ok(())
            }),
        };
        match written {
            Ok(()) => refused = false,
            Err(error) => {
                // opened again for the next event
                daemon_log = None;
                if !std::mem::replace(&mut refused, true) {
                    tracing::warn!(
                        "an event cannot be written to the daemon log: {}",
                        chain(&error)
                    );
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use chrono::DateTime;

    use crate::events::daemon_log::*;
    use crate::events::kind::EventKind;

    #[tokio::test]
    async fn what_is_noted_is_on_disk_when_it_is_closed() {
        let folder = tempfile::tempdir().unwrap();
        let daemon_log = DaemonLogWriter::new(folder.path().to_owned());
        daemon_log.close().await;
        assert!(logbook::read_daemon_log(folder.path()).unwrap().is_empty());
        for number in 0..QUEUE as i64 {
            let at = DateTime::from_timestamp_nanos(number);
            daemon_log.note(&Event::new(at, EventKind::Daily, "a day", None));
        }
        daemon_log.close().await;
        assert_eq!(
            logbook::read_daemon_log(folder.path()).unwrap().len(),
            QUEUE
        );
        // and writing continues
        let at = DateTime::from_timestamp_nanos(QUEUE as i64);
        daemon_log.note(&Event::new(at, EventKind::Stopped, "SIGTERM", None));
        daemon_log.close().await;
        let last = logbook::read_daemon_log(folder.path())
            .unwrap()
            .pop()
            .unwrap();
        assert_eq!(last.kind, "stopped");
    }
}
