//! System tests: all programs together on a simulated rig, by topic. One executable holds them all, because each more
//! would link all crates once more; it also plays the part of the programs.
//!
//! `TACTUS_RIG=rig.toml cargo test -p tactus-tests` runs the same tests on the instruments that `rig.toml` names (a
//! configuration of `tactusd`; record and bus are replaced by the test's own). Each test declares what it needs and its
//! largest current; what a rig does not have is skipped, and the reason is printed.

mod instruments;
mod interfaces;
mod manual;
mod maps;
mod measuring;
mod record;
mod rules;
mod test_rig;
mod transport;
