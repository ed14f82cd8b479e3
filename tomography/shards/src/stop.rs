//! SIGTERM as a request to stop between two items.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::SIGTERM;

/// Exit status of a process terminated by SIGTERM, as shells report it.
const TERMINATED: i32 = 128 + SIGTERM;

/// A flag that is set when the process is to stop.
#[derive(Debug, Clone, Default)]
pub struct StopRequest(Arc<AtomicBool>);

impl StopRequest {
    /// Registers a handler: the first SIGTERM sets the flag instead of ending the process, a second one ends the
    /// process immediately with exit code 143.
    ///
    /// # Errors
    /// The system refuses the handler.
    pub fn on_sigterm() -> std::io::Result<Self> {
        let request = Self::default();
        // handlers run in the order of registration, so the flag is still unset when this one handles the first signal
        signal_hook::flag::register_conditional_shutdown(
            SIGTERM,
            TERMINATED,
            Arc::clone(&request.0),
        )?;
        signal_hook::flag::register(SIGTERM, Arc::clone(&request.0))?;
        Ok(request)
    }

    /// Whether to stop at the next opportunity.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
impl StopRequest {
    /// Sets or clears the flag, in place of the signal.
    pub(crate) fn request(&self, stop: bool) {
        self.0.store(stop, Ordering::Relaxed);
    }
}
