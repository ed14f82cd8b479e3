//! The daemon's service: buses, the peer socket, access, limits, configuration and reload, metrics, systemd. Sessions
//! are tested in `session`, faults of instruments in `instruments`.

mod access;
mod brokers;
mod configuration;
mod contract;
mod handshakes;
mod limits;
mod listening;
mod numbers;
mod observed;
mod reload;
#[path = "../stage/mod.rs"]
mod stage;
mod watchdog;
