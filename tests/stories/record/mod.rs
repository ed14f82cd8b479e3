//! Sessions on disk: nights of frames, kills, and playback of recordings. `logbook` tests the file format.

mod killed_daemon;
mod logging;
mod recorded_tank;
