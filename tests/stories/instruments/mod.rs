//! Instruments over TCP and serial lines: discovery and the self-test of a rig.
//! The drivers by themselves are tested in `drivers`.

mod discovery;
mod self_test;
