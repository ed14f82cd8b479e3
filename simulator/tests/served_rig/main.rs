//! The rig as `tactus-sim` serves it: sockets, VXI-11, pages, faults, transcripts and goldens, hostile clients.
//! What the instruments measure is tested by `simulated_rig`.

mod fault_kinds;
mod faults;
mod goldens;
mod hostile;
mod program;
mod serve;
mod sockets;
mod vxi11;
