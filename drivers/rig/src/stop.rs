//! Stopping: a request that is handled between two steps of a plan, never a dropped future.

use tokio::sync::watch;

/// Asks for a stop.
#[derive(Debug, Clone)]
pub struct StopButton(watch::Sender<bool>);

/// Receives the request. Copies receive the same one.
#[derive(Debug, Clone)]
pub struct Stop(watch::Receiver<bool>);

impl Stop {
    /// A button and what it stops. A button dropped unpressed stops nothing.
    pub fn button() -> (StopButton, Self) {
        let (sender, receiver) = watch::channel(false);
        (StopButton(sender), Self(receiver))
    }

    /// One that nobody presses.
    pub fn never() -> Self {
        Self::button().1
    }

    /// Whether the button has been pressed.
    pub fn is_requested(&self) -> bool {
        *self.0.borrow()
    }

    /// Waits until the button is pressed; for ever if it never is.
    pub async fn requested(&mut self) {
        if self.0.wait_for(|pressed| *pressed).await.is_err() {
            std::future::pending().await
        }
    }
}

impl StopButton {
    /// Asks for a stop. Pressed once, pressed for good.
    pub fn press(&self) {
        self.0.send_replace(true);
    }
}
