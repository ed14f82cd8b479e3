//! Commands that need no daemon, run as processes on session files written by the tests.

#[cfg(feature = "archive")]
mod archived;
mod exports;
mod files;
mod hostile;
mod maps;
mod report;
mod scene;
// shared with the tests of the archive crate, which use more of it
#[cfg(feature = "archive")]
#[path = "../../../archive/tests/postgres/server.rs"]
#[allow(dead_code)]
mod server;
mod untimed;
mod upkeep;
