//! The asynchronous runtime of commands that wait for a daemon, a client or a key.

use tokio::runtime::{Builder, Runtime};

use crate::failure::Failure;

/// A runtime on this thread.
///
/// # Errors
/// The system has no resources for it.
pub(crate) fn current_thread() -> Result<Runtime, Failure> {
    Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|error| Failure::failed("the asynchronous runtime cannot be started", &error))
}
