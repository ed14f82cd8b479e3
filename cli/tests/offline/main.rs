//! The commands that need no daemon, run as a person runs them, on session files written here.

mod files;
mod hostile;
mod maps;
mod scene;
mod upkeep;
