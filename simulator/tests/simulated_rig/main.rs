//! The simulated rig in memory: circuits, relays, frames that the real drivers measure, faults of the wires.
//! The served program is tested by `served_rig`, foreign clients by `clients`.

mod circuits;
mod drivers;
mod frames;
mod measuring;
mod relays;
mod scenes;
mod wires;
