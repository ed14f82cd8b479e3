//! Contains a panic in a task that only replies to a client: the panic ends that reply, and nothing else.
//!
//! A thread-local marker tells whether a panic is contained. It is set on the threads that serve the bus
//! ([`mark_thread`]), so that code run by zbus itself is covered too, and while a future or closure passed to
//! [`answer`] or [`run`] runs. The panic hook reads the marker ([`is_contained`]): it logs a contained panic at a
//! limited rate, and reports any other, after which the source is switched off ([`crate::panics::hook`]).

use std::cell::{Cell, RefCell};
use std::future::poll_fn;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};
use std::pin::pin;
use std::task::Poll;

use crate::events::kind::EventKind;
use dbus::Fault;
use tokio::task::JoinHandle;

use crate::events::rate_limit::RateLimit;

thread_local! {
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
    /// Location of the last contained panic of this thread, for the code that catches it.
    static LOCATION: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Rate limit of the log.
static LOG: RateLimit = RateLimit::new();

/// Whether a panic on this thread is contained. A panic on a thread of rayon is propagated to the thread that waits for
/// the computation.
pub(crate) fn is_contained() -> bool {
    CONTAINED.get() || rayon::current_thread_index().is_some()
}

/// Logs a contained panic, at a limited rate; called by the panic hook.
pub(crate) fn log(panic: &PanicHookInfo<'_>) {
    let place = panic
        .location()
        .map_or_else(|| "an unknown place".to_owned(), ToString::to_string);
    let text = format!(
        "the daemon's own code panicked at {place} ({}); one reply failed, and nothing else; please report it",
        message(panic.payload())
    );
    LOG.log(EventKind::ContainedPanic, None, &text);
    LOCATION.set(place);
}

/// Logs how many panics were suppressed since the last logged one; called periodically.
pub(crate) fn catch_up() {
    LOG.catch_up();
}

/// A panic that was caught.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the daemon's own code failed while it answered ({place}: {message}); please report it")]
pub(crate) struct Panicked {
    /// File, line and column.
    pub place: String,
    pub message: String,
}

impl Panicked {
    fn caught(payload: &(dyn std::any::Any + Send)) -> Self {
        Self {
            place: LOCATION.take(),
            message: message(payload),
        }
    }
}

impl From<Panicked> for Fault {
    fn from(panicked: Panicked) -> Self {
        Self::Failed(panicked.to_string())
    }
}

fn message(payload: &dyn std::any::Any) -> String {
    let text = payload
        .downcast_ref::<&str>()
        .map(ToString::to_string)
        .or_else(|| payload.downcast_ref::<String>().cloned());
    text.unwrap_or_else(|| "no message".to_owned())
}

/// Sets the marker of this thread until dropped.
struct Marked {
    before: bool,
}

impl Marked {
    fn set(contained: bool) -> Self {
        Self {
            before: CONTAINED.replace(contained),
        }
    }
}

impl Drop for Marked {
    fn drop(&mut self) {
        CONTAINED.set(self.before);
    }
}

/// Runs a closure whose panic is contained.
pub(crate) fn run<T>(work: impl FnOnce() -> T) -> Result<T, Panicked> {
    let _marked = Marked::set(true);
    catch_unwind(AssertUnwindSafe(work)).map_err(|payload| Panicked::caught(payload.as_ref()))
}

/// What is ended by a panic in a reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PanicScope {
    /// Only the reply.
    Reply,
    /// The reply and the session: the code was using instruments or a session, and only switching the source off makes
    /// them safe with certainty.
    Session,
}

/// Awaits a reply to a client; catches its panic.
pub(crate) async fn answer<T>(
    scope: PanicScope,
    future: impl Future<Output = T>,
) -> Result<T, Panicked> {
    let mut future = pin!(future);
    poll_fn(|context| {
        let _marked = Marked::set(scope == PanicScope::Reply);
        let polled = catch_unwind(AssertUnwindSafe(|| future.as_mut().poll(context)));
        match polled {
            Ok(Poll::Pending) => Poll::Pending,
            Ok(Poll::Ready(done)) => Poll::Ready(Ok(done)),
            Err(payload) => Poll::Ready(Err(Panicked::caught(payload.as_ref()))),
        }
    })
    .await
}

/// Runs blocking work on a blocking thread. Its panic is contained if a panic of the caller would be.
pub(crate) fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> JoinHandle<T> {
    let contained = CONTAINED.get();
    tokio::task::spawn_blocking(move || {
        let _marked = Marked::set(contained);
        work()
    })
}

/// Sets the marker for the life of this thread; called at the start of a thread that serves clients.
pub(crate) fn mark_thread() {
    CONTAINED.set(true);
}

#[cfg(test)]
mod tests {
    use crate::panics::containment::*;

    #[tokio::test]
    async fn a_panic_of_an_answer_is_caught_and_the_marker_is_restored() {
        let _hook = crate::session::panics::tests::alone().await;
        crate::panics::hook::install();
        let panics = crate::panics::hook::listen();
        let caught = answer(PanicScope::Reply, async {
            tokio::task::yield_now().await;
            assert!(is_contained());
            let inner = blocking(|| panic!("on a thread that blocks")).await;
            assert!(inner.unwrap_err().is_panic());
            panic!("while answering {}", 1)
        });
        let caught: Result<(), Panicked> = caught.await;
        let caught = caught.unwrap_err();
        assert_eq!(caught.message, "while answering 1");
        assert!(caught.place.contains("containment.rs:"), "{caught}");
        let caught = run(|| panic!("at once")).map(|(): ()| ()).unwrap_err();
        assert_eq!(caught.message, "at once");
        assert!(!is_contained());
        assert!(!panics.has_changed().unwrap(), "none was the daemon's");

        // a panic in a task spawned from a reply is not contained
        let spawned = answer(PanicScope::Reply, async {
            tokio::spawn(async { is_contained() }).await.unwrap()
        });
        assert!(!spawned.await.unwrap());
        let acting = answer(PanicScope::Session, async {
            panic!("with a session in hand")
        });
        let caught: Result<(), Panicked> = acting.await;
        assert!(caught.is_err());
        assert!(panics.has_changed().unwrap());
    }

    #[test]
    fn a_thread_for_clients_is_marked() {
        let marked = std::thread::spawn(|| {
            mark_thread();
            is_contained()
        });
        assert!(marked.join().unwrap());
        assert!(!is_contained());
    }
}
