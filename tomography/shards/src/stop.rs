//! SIGTERM as a request to stop between two items.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::SIGTERM;

/// Exit status of a process that SIGTERM ends, as shells report it.
const TERMINATED: i32 = 128 + SIGTERM;

/// Whether the process was asked to stop.
#[derive(Debug, Clone, Default)]
pub struct StopRequest(Arc<AtomicBool>);

impl StopRequest {
    /// From now on the first SIGTERM sets the request instead of ending the process; a second one ends it at once, with
    /// exit code 143.
    ///
    /// # Errors
    /// The system refuses the handler.
    pub fn on_sigterm() -> std::io::Result<Self> {
        let request = Self::default();
        // handlers run in the order of their registration: the first signal finds the flag unset
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
    /// As by the signal.
    pub(crate) fn request(&self, stop: bool) {
        self.0.store(stop, Ordering::Relaxed);
    }
}
