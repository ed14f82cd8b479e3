//! Sessions on disk: nights of frames, kills, and recordings that are played again.
//! The file format itself is tested in `logbook`.

mod killed_daemon;
mod logging;
mod recorded_tank;
