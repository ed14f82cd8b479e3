//! The instruments of a rig: addresses, locks, identities, connecting, and making them safe. The drivers are separate
//! crates.

pub(crate) mod address;
pub(crate) mod assembly;
pub(crate) mod discovery;
pub(crate) mod identities;
pub(crate) mod kinds;
pub(crate) mod last_resort;
pub(crate) mod lock;
pub(crate) mod relay_wear;
pub(crate) mod rig_plan;
#[cfg(feature = "simulator")]
pub(crate) mod simulation;
#[cfg(not(feature = "simulator"))]
#[path = "without_simulator.rs"]
pub(crate) mod simulation;
pub(crate) mod transcripts;
