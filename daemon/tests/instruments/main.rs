//! Instruments that are discovered, checked, lost and replaced, and the effect on a session. Sessions on a rig without
//! faults are tested in `session`, the service itself in `service`.

mod discovery;
mod every_fault;
mod faults;
mod outages;
mod self_test;
#[path = "../stage/mod.rs"]
mod stage;
mod unknown_instruments;
