//! Shared parts of the system tests (stories): the temporary rig of [`demo`], and a binary that is any of the five
//! programs.

use std::ffi::OsString;
use std::process::ExitCode;

pub use demo::{DEADLINE, DaemonProcess, SIMULATED, Spoken, Stage, StageError, TWO_MICROVOLTS};

/// Runs one of the five programs when the first argument names it; `None` when it names none.
///
/// `args` are those of the process; the first one is this binary itself.
pub fn act_as(args: impl Iterator<Item = OsString>) -> Option<ExitCode> {
    let args: Vec<OsString> = args.collect();
    if args.get(1).is_some_and(|program| program == "tactus-lab") {
        return Some(lab::run(args.into_iter().skip(1)));
    }
    if args
        .get(1)
        .is_some_and(|program| program == "tactus-archive")
    {
        return Some(archive::run(args.into_iter().skip(1)));
    }
    demo::act_as(args.into_iter())
}
