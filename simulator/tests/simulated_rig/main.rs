//! The simulated rig in memory: circuits, relays, frames measured by the real drivers, faults of the wires.
//! `served_rig` tests the served program, `clients` third-party clients.

mod circuits;
mod drivers;
mod frames;
mod measuring;
mod relays;
mod scenes;
mod wires;
