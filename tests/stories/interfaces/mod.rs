//! Interfaces for users and programs: configuration errors, JSON, D-Bus, and harmless display of hostile text. `manual`
//! tests the pages of the manual.

mod bad_input;
mod dbus_contract;
mod foreign_clients;
mod hostile_text;
mod json_output;
mod live_topics;
mod round_trips;
mod session_names;
mod terminal;
mod top_screen;
mod watch_screen;
