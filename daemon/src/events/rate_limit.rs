//! Rate limit for journal messages: the first event of each kind is logged; repeats within ten minutes are counted and
//! summarised. Record and bus receive all events.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::Duration;

use tokio::time::Instant;

use crate::events::kind::{EventKind, Severity};
use crate::locked::locked;

/// Period in which one kind is not logged again.
pub(crate) const REPEAT_INTERVAL: Duration = Duration::from_secs(600);

/// State of the rate limit, by kind.
#[derive(Debug, Default)]
pub(crate) struct RateLimit(Mutex<BTreeMap<EventKind, Written>>);

#[derive(Debug, Clone, Copy)]
struct Written {
    at: Instant,
    more: u64,
}

impl RateLimit {
    pub(crate) const fn new() -> Self {
        Self(Mutex::new(BTreeMap::new()))
    }

    /// Writes an event to the journal, or counts it.
    pub(crate) fn log(&self, kind: EventKind, session: Option<&str>, text: &str) {
        match self.suppressed(kind) {
            Some(0) => journal(kind, session, text),
            Some(more) => {
                let text = format!("{text} (and {})", left_out(more));
                journal(kind, session, &text);
            }
            None => {}
        }
    }

    /// Writes due summaries; called periodically.
    pub(crate) fn catch_up(&self) {
        let now = Instant::now();
        let mut due = Vec::new();
        locked(&self.0).retain(|kind, written| {
            if now.duration_since(written.at) < REPEAT_INTERVAL {
                return true;
            }
            if written.more > 0 {
                due.push((*kind, written.more));
            }
            let again = written.more > 0;
            *written = Written { at: now, more: 0 };
            again
        });
        for (kind, more) in due {
            journal(
                kind,
                None,
                &format!("{}: {}", kind.as_str(), left_out(more)),
            );
        }
    }

    /// The number of events of the kind that were suppressed since the last written one; `None` if this one is
    /// suppressed too.
    fn suppressed(&self, kind: EventKind) -> Option<u64> {
        let now = Instant::now();
        let mut kinds = locked(&self.0);
        let Some(written) = kinds.get_mut(&kind) else {
            kinds.insert(kind, Written { at: now, more: 0 });
            return Some(0);
        };
        if now.duration_since(written.at) < REPEAT_INTERVAL {
            written.more += 1;
            return None;
        }
        written.at = now;
        Some(std::mem::take(&mut written.more))
    }
}

fn left_out(more: u64) -> String {
    format!(
        "{more} more in the last {} minutes",
        REPEAT_INTERVAL.as_secs() / 60
    )
}

fn journal(kind: EventKind, session: Option<&str>, text: &str) {
    let (kind, severity) = (kind.as_str(), kind.severity());
    match severity {
        Severity::Error => tracing::error!(kind, session, "{text}"),
        Severity::Warn => tracing::warn!(kind, session, "{text}"),
        Severity::Info => tracing::info!(kind, session, "{text}"),
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;
    use std::io;
    use std::sync::Arc;

    use crate::events::rate_limit::*;

    /// Collects the text written to the journal.
    #[derive(Debug, Clone, Default)]
    struct Journal(Arc<Mutex<String>>);

    impl io::Write for Journal {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let text = String::from_utf8_lossy(bytes);
            let _ = self.0.lock().unwrap().write_str(&text);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Journal {
        fn lines(&self) -> Vec<String> {
            let text = std::mem::take(&mut *self.0.lock().unwrap());
            text.lines().map(str::to_owned).collect()
        }
    }

    #[tokio::test(start_paused = true)]
    async fn messages_are_logged_once_then_rate_limited() {
        let journal = Journal::default();
        let sink = journal.clone();
        let subscriber = tracing_subscriber::fmt()
            .with_writer(move || sink.clone())
            .without_time()
            .with_ansi(false)
            .finish();
        let _guard = tracing::subscriber::set_default(subscriber);
        let rate_limit = RateLimit::default();
        for frame in 0..215 {
            rate_limit.log(
                EventKind::FrameFailed,
                Some("m1"),
                &format!("frame {frame} failed"),
            );
        }
        rate_limit.log(EventKind::Suspended, Some("m1"), "the session is suspended");
        let lines = journal.lines();
        assert_eq!(lines.len(), 2, "{lines:#?}");
        assert!(lines[0].contains("frame 0 failed") && lines[0].contains("ERROR"));
        // no summary before it is due
        tokio::time::advance(REPEAT_INTERVAL - Duration::from_secs(1)).await;
        rate_limit.catch_up();
        assert!(journal.lines().is_empty());
        tokio::time::advance(Duration::from_secs(1)).await;
        rate_limit.log(EventKind::FrameFailed, Some("m1"), "frame 300 failed");
        let lines = journal.lines();
        assert!(
            lines[0].contains("frame 300 failed (and 214 more in the last 10 minutes)"),
            "{lines:?}"
        );
        // the last event of a burst is reported, although no event follows it
        rate_limit.log(EventKind::FrameFailed, Some("m1"), "frame 301 failed");
        assert!(journal.lines().is_empty());
        tokio::time::advance(REPEAT_INTERVAL).await;
        rate_limit.catch_up();
        let lines = journal.lines();
        assert_eq!(lines.len(), 1, "{lines:?}");
        assert!(
            lines[0].contains("frame-failed: 1 more in the last 10 minutes"),
            "{lines:?}"
        );
        tokio::time::advance(REPEAT_INTERVAL).await;
        rate_limit.catch_up();
        assert!(journal.lines().is_empty(), "silence is not reported again");
        // after a pause an event is logged immediately again
        rate_limit.log(EventKind::FrameFailed, Some("m1"), "frame 900 failed");
        assert_eq!(journal.lines().len(), 1);
    }
}
