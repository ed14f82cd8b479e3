//! The rig as served by `tactus-sim`: sockets, VXI-11, pages, faults, transcripts and goldens, hostile clients, clients
//! of third parties.
//! `simulated_rig` tests the measurements.

mod clients;
mod fault_kinds;
mod faults;
mod goldens;
mod hostile;
mod program;
mod serve;
mod sockets;
mod vxi11;
