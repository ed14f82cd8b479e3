//! Connections to the simulated instruments: sockets, telnet, VXI-11, pseudo-terminals, web pages, mDNS. The drivers'
//! simulators compute the replies.

pub(crate) mod announce;
pub(crate) mod client;
pub(crate) mod pty;
pub(crate) mod socket;
pub(crate) mod telnet;
pub(crate) mod vxi11;
pub(crate) mod web;
