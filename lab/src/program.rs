//! Runs the commands of this program for studies.

use std::ffi::OsString;
use std::path::Path;

use clap::Parser;
use studies::{Failure, Program};

use crate::args::Arguments;

/// This program, `tactus-lab`.
pub(crate) struct TactusLab;

fn parsed(words: &[OsString]) -> Result<Arguments, clap::Error> {
    Arguments::try_parse_from(
        std::iter::once(OsString::from("tactus-lab")).chain(words.iter().cloned()),
    )
}

impl Program for TactusLab {
    fn check(&self, words: &[OsString]) -> Result<(), String> {
        parsed(words).map(drop).map_err(|fault| fault.to_string())
    }

    fn run(&self, words: &[OsString]) -> Result<(), Failure> {
        let arguments = parsed(words).map_err(|fault| Failure::usage(fault.to_string()))?;
        crate::perform(&arguments.command)
    }

    /// Measured in a new process, because in this one the model would reuse memory freed by the training.
    fn resident_bytes(&self, model: &Path) -> Option<u64> {
        let program = std::env::current_exe().ok()?;
        let mut command = std::process::Command::new(&program);
        if program.file_stem()? != "tactus-lab" {
            command.arg("tactus-lab");
        }
        let output = command
            .args(["paper", "--resident"])
            .arg(model)
            .output()
            .ok()?;
        String::from_utf8(output.stdout).ok()?.trim().parse().ok()
    }
}
