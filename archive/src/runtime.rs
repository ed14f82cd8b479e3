//! The asynchronous runtime for waiting for catalogue, store and daemon.

use std::io;

use tokio::runtime::{Builder, Runtime};

pub(crate) fn runtime() -> io::Result<Runtime> {
    Builder::new_current_thread().enable_all().build()
}
