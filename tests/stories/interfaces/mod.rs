//! What users and programs see: errors of configuration, JSON, D-Bus, and hostile text that is only shown.
//! The pages of the manual are tested in `manual`.

mod bad_input;
mod dbus_contract;
mod foreign_clients;
mod hostile_text;
mod json_output;
mod round_trips;
mod watch_screen;
