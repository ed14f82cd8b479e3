//! Instruments over TCP and serial lines: discovery and the self-test of a rig. The tests in `drivers` are for single
//! drivers.

mod discovery;
mod self_test;
