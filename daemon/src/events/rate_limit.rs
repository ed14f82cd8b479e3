//! What is said in the journal: each kind of news once, and then at a limited rate with what was left out. Record and bus
//! have all of it.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

/// So long one kind is not said again.
pub(crate) const AGAIN: Duration = Duration::from_secs(600);

/// Whether something is said.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Decision {
    Say,
    /// And that there were so many more since it was said last.
    SayWith(u64),
    Silent,
}

/// How news is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Severity {
    /// All is as it should be.
    Info,
    Warn,
    Error,
}

impl Severity {
    fn of(kind: &str) -> Self {
        match kind {
            "alarm" | "source-unknown" | "frame-failed" | "others-found" | "relays-closed"
            | "method-suspended" | "contained-panic" => Self::Error,
            "started" | "stopped" | "daily" | "trouble-over" => Self::Info,
            _ => Self::Warn,
        }
    }
}

/// What has been said, by kind. Kinds are words of this program, so there are only so many.
#[derive(Debug, Default)]
pub(crate) struct RateLimit(Mutex<BTreeMap<&'static str, Said>>);

#[derive(Debug, Clone, Copy)]
struct Said {
    at: Instant,
    more: u64,
}

impl RateLimit {
    pub(crate) const fn new() -> Self {
        Self(Mutex::new(BTreeMap::new()))
    }

    /// Says something in the journal, or counts it.
    pub(crate) fn say(&self, kind: &'static str, session: Option<&str>, text: &str) {
        match self.decide(kind) {
            Decision::Say => journal(kind, session, text),
            Decision::SayWith(more) => {
                let text = format!("{text} (and {})", left_out(more));
                journal(kind, session, &text);
            }
            Decision::Silent => {}
        }
    }

    /// Says what was counted and is due; called now and then.
    pub(crate) fn catch_up(&self) {
        let now = Instant::now();
        let mut due = Vec::new();
        self.kinds().retain(|kind, said| {
            if now.duration_since(said.at) < AGAIN {
                return true;
            }
            if said.more > 0 {
                due.push((*kind, said.more));
            }
            let again = said.more > 0;
            *said = Said { at: now, more: 0 };
            again
        });
        for (kind, more) in due {
            journal(kind, None, &format!("{kind}: {}", left_out(more)));
        }
    }

    fn decide(&self, kind: &'static str) -> Decision {
        let now = Instant::now();
        let mut kinds = self.kinds();
        let Some(said) = kinds.get_mut(kind) else {
            kinds.insert(kind, Said { at: now, more: 0 });
            return Decision::Say;
        };
        if now.duration_since(said.at) < AGAIN {
            said.more += 1;
            return Decision::Silent;
        }
        let more = std::mem::take(&mut said.more);
        said.at = now;
        if more > 0 {
            Decision::SayWith(more)
        } else {
            Decision::Say
        }
    }

    fn kinds(&self) -> MutexGuard<'_, BTreeMap<&'static str, Said>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn left_out(more: u64) -> String {
    format!("{more} more in the last {} minutes", AGAIN.as_secs() / 60)
}

fn journal(kind: &str, session: Option<&str>, text: &str) {
    match Severity::of(kind) {
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

    /// What goes to the journal, as text.
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
    async fn a_thing_is_said_once_and_then_at_a_limited_rate() {
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
            rate_limit.say("frame-failed", Some("m1"), &format!("frame {frame} failed"));
        }
        rate_limit.say("suspended", Some("m1"), "the session is suspended");
        let said = journal.lines();
        assert_eq!(said.len(), 2, "{said:#?}");
        assert!(said[0].contains("frame 0 failed") && said[0].contains("ERROR"));
        // before its time nothing is caught up with
        tokio::time::advance(AGAIN - Duration::from_secs(1)).await;
        rate_limit.catch_up();
        assert!(journal.lines().is_empty());
        tokio::time::advance(Duration::from_secs(1)).await;
        rate_limit.say("frame-failed", Some("m1"), "frame 300 failed");
        let said = journal.lines();
        assert!(
            said[0].contains("frame 300 failed (and 214 more in the last 10 minutes)"),
            "{said:?}"
        );
        // the last of a burst is counted, though nothing comes after it
        rate_limit.say("frame-failed", Some("m1"), "frame 301 failed");
        assert!(journal.lines().is_empty());
        tokio::time::advance(AGAIN).await;
        rate_limit.catch_up();
        let said = journal.lines();
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(
            said[0].contains("frame-failed: 1 more in the last 10 minutes"),
            "{said:?}"
        );
        tokio::time::advance(AGAIN).await;
        rate_limit.catch_up();
        assert!(journal.lines().is_empty(), "silence is not told again");
        // and after silence it is news again
        rate_limit.say("frame-failed", Some("m1"), "frame 900 failed");
        assert_eq!(journal.lines().len(), 1);
    }
}
