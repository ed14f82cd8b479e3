//! Requests to stop. A stop is handled between two steps of a plan; no exchange is cancelled.

use tokio::sync::watch;

/// Requests a stop.
#[derive(Debug, Clone)]
pub struct StopButton(watch::Sender<bool>);

/// Receives the request to stop. Clones receive the same request.
#[derive(Debug, Clone)]
pub struct Stop(watch::Receiver<bool>);

impl Stop {
    /// A stop button and its receiver. Dropping the button without pressing it stops nothing.
    pub fn button() -> (StopButton, Self) {
        let (sender, receiver) = watch::channel(false);
        (StopButton(sender), Self(receiver))
    }

    /// A receiver that is never stopped.
    pub fn never() -> Self {
        Self::button().1
    }

    /// Whether the button has been pressed.
    pub fn is_requested(&self) -> bool {
        *self.0.borrow()
    }

    /// Waits until the button is pressed; never completes if it is not.
    pub async fn requested(&mut self) {
        if self.0.wait_for(|pressed| *pressed).await.is_err() {
            std::future::pending().await
        }
    }
}

impl StopButton {
    /// Requests a stop; cannot be undone.
    pub fn press(&self) {
        self.0.send_replace(true);
    }
}
