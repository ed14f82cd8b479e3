//! Instruments that are found, checked, lost and replaced, and what a session does then.
//! Sessions on a rig without faults are tested in `session`, the service itself in `service`.

mod discovery;
mod every_fault;
mod faults;
mod outages;
mod self_test;
#[path = "../stage/mod.rs"]
mod stage;
mod unknown_instruments;
