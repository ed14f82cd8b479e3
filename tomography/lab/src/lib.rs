//! Offline work: meshes, forward solutions, sensitivities, training, reconstruction of recorded data; `tactus-lab`.
//!
//! Everything here reads and writes plain files: case folders (geometry, protocol, conductances as CSV), frames, maps,
//! model files. Refused at this door: instruments, the bus, the daemon; nothing that runs for months links this crate.
//!
//! - **case**: a folder with a mesh, electrodes and a protocol; **preset**: a case made from measures
//! - **frames**: rows (or columns) of readings; **baseline**: the frame of the unloaded sheet
//! - **maps**: a row a frame, a column a triangle of the region, relative change of conductance
//!
//! ```
//! let folder = tempfile::tempdir()?;
//! let case = folder.path().join("tank");
//! let mesh = ["tactus-lab", "mesh", "--preset", "disc-tank", "--set", "electrodes=8", "--out"];
//! let words = mesh.iter().map(Into::into).chain([case.clone().into_os_string()]);
//! assert_eq!(lab::run(words), std::process::ExitCode::SUCCESS);
//! assert!(case.join("nodes.csv").is_file());
//! # Ok::<(), std::io::Error>(())
//! ```

mod args;
mod calibrate;
mod choice;
mod dataset;
mod deep;
mod evaluate;
mod failure;
mod geometry;
mod html;
mod judge;
mod linear;
mod merit;
mod noise_figure;
mod paper;
mod progress;
mod reconstruct;
mod recording;
mod scene;
mod shapes;
mod solve;
mod stability;
mod symmetry;
mod tradeoff;
mod train;
mod workplace;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{CommandFactory, Parser};

use args::{Arguments, Command};
use failure::Failure;

/// The definition of the command line: every command and option, for reference pages and completions.
pub fn command() -> clap::Command {
    Arguments::command()
}

/// The whole program: `words` are the arguments with the program's name first. 0 done, 1 failed, 2 usage.
pub fn run(words: impl IntoIterator<Item = OsString>) -> ExitCode {
    let arguments = match Arguments::try_parse_from(words) {
        Ok(arguments) => arguments,
        Err(refusal) => {
            // --help and --version come this way too, and are no failure; a closed terminal is not ours to report
            let _ = refusal.print();
            return ExitCode::from(if refusal.use_stderr() { 2 } else { 0 });
        }
    };
    match perform(&arguments.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("tactus-lab: {failure}");
            failure.code()
        }
    }
}

fn perform(command: &Command) -> Result<(), Failure> {
    match command {
        Command::Mesh(options) => geometry::mesh(options),
        Command::Forward(options) => solve::forward(options),
        Command::Jacobian(options) => solve::jacobian(options),
        Command::Transfer(options) => solve::transfer(options),
        Command::Train { network } => train::train(network),
        Command::Scene { command } => scene::scene(command),
        Command::Judge(options) => judge::judge(options),
        Command::Dataset(options) => dataset::dataset(options),
        Command::Evaluate(options) => evaluate::evaluate(options),
        Command::Paper(options) => paper::paper(options),
        Command::Tradeoff(options) => tradeoff::tradeoff(options),
        Command::Advise(options) => tradeoff::advise(options),
        Command::Calibrate(options) => calibrate::calibrate(options),
        Command::Merit(options) => merit::merit(options),
        Command::Reconstruct(options) => reconstruct::reconstruct(options),
        Command::Stability(options) => stability::stability(options),
        Command::Completions { shell } => {
            let mut command = Arguments::command();
            clap_complete::generate(*shell, &mut command, "tactus-lab", &mut std::io::stdout());
            Ok(())
        }
    }
}
