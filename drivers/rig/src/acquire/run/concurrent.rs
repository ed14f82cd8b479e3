//! Waits for other events during an exchange.

use std::pin::Pin;

use tokio::sync::watch;

use crate::Stop;

/// Completes when a stop is requested, or when the caller has dropped its future.
pub(super) async fn interrupted(mut stop: Stop, mut caller: watch::Receiver<()>) {
    tokio::select! {
        () = stop.requested() => {}
        // nothing is ever sent: this completes only when the caller's end is dropped
        _ = caller.changed() => {}
    }
}

/// An exchange in progress, and its reply once received.
pub(super) struct PendingExchange<'a, F: Future> {
    exchange: Pin<&'a mut F>,
    answer: Option<F::Output>,
}

impl<'a, F: Future> PendingExchange<'a, F> {
    pub(super) fn new(exchange: Pin<&'a mut F>) -> Self {
        Self {
            exchange,
            answer: None,
        }
    }

    /// Waits for something else while the exchange continues.
    pub(super) async fn wait_for<T>(&mut self, other: impl Future<Output = T>) -> T {
        let mut other = std::pin::pin!(other);
        loop {
            tokio::select! {
                biased;
                done = &mut other => return done,
                came = self.exchange.as_mut(), if self.answer.is_none() => self.answer = Some(came),
            }
        }
    }

    /// Waits for the reply or something else; `None` if the latter came first.
    pub(super) async fn completes_before(&mut self, other: impl Future<Output = ()>) -> Option<()> {
        if self.answer.is_some() {
            return Some(());
        }
        tokio::select! {
            biased;
            came = self.exchange.as_mut() => self.answer = Some(came),
            () = other => return None,
        }
        Some(())
    }

    pub(super) async fn finish(self) -> F::Output {
        match self.answer {
            Some(answer) => answer,
            None => self.exchange.await,
        }
    }
}
