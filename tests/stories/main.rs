//! System tests: all programs together on a simulated rig, by topic. They share one executable, because each additional
//! one would link all crates again; it also acts as the programs.
//!
//! `TACTUS_RIG=rig.toml cargo test -p tactus-tests` runs the same tests on the instruments in `rig.toml` (a
//! configuration of `tactusd`; record and bus are replaced by the test's own). Each test declares its requirements and
//! its largest current; a test whose requirements the rig does not meet is skipped, with the reason printed.

mod browser;
mod instruments;
mod interfaces;
mod manual;
mod maps;
mod measuring;
mod mosquitto;
mod record;
mod rules;
mod test_rig;
mod transport;
