//! Commands that need no daemon, run as processes on session files written by the tests.

mod exports;
mod files;
mod hostile;
mod maps;
mod report;
mod scene;
mod upkeep;
