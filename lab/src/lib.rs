//! The command line for offline work, `tactus-lab`: meshes, forward solutions, sensitivities, training, reconstruction
//! of recorded data, the studies. The computations are in `eit`, `imaging`, `training` and `studies`.
//!
//! All commands read and write plain files: case folders (geometry, protocol, conductances as CSV), frames, maps, model
//! files. The daemon does not link this crate.
//!
//! - **case**: a folder with a mesh, electrodes and a protocol; **preset**: a case made from dimensions
//! - **frames**: rows (or columns) of readings; **baseline**: the frame of the unloaded sheet
//! - **maps**: a row per frame, a column per triangle of the region, relative change of conductance
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
mod daemon_config;
mod geometry;
mod learning;
mod maps;
mod output;
mod program;
mod scene;
mod study;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::CommandFactory;
use studies::Failure;

use args::{Arguments, Command};

/// The definition of the command line: every command and option, for reference pages and completions.
pub fn command() -> clap::Command {
    help_examples::with_examples(Arguments::command(), include_str!("examples.txt"))
}

/// Runs the program; `words` are the arguments, starting with the program's name. The exit codes are
/// those of [`studies::EXIT_TABLE`].
pub fn run(words: impl IntoIterator<Item = OsString>) -> ExitCode {
    let words: Vec<OsString> = words.into_iter().collect();
    let json = survey::asks_for_json(&words);
    let command = command();
    let refused = |text| report(&Failure::usage(text), json);
    let parsed = help_examples::parsed::<Arguments>(&command, &words, json, refused);
    let (matches, arguments) = match parsed {
        Ok(parsed) => parsed,
        Err(code) => return code,
    };
    let outputs = outfile::check_arguments(&command, &matches).map_err(Failure::from);
    match outputs.and_then(|()| perform(&arguments.command)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => report(&failure, json),
    }
}

/// Prints on standard error why the command failed, as text or as one JSON object in the form of `tactus --json`.
fn report(failure: &Failure, json: bool) -> ExitCode {
    let text = failure.to_string();
    let row = failure.exit().row();
    match json {
        true => eprintln!("{}", survey::error_line(row.kind, row.code, &text)),
        false => eprintln!("tactus-lab: {}", survey::printable_lines(&text)),
    }
    ExitCode::from(row.code)
}

fn perform(command: &Command) -> Result<(), Failure> {
    match command {
        Command::Mesh(options) => geometry::mesh(options),
        Command::Sheet(options) => geometry::sheet(options),
        Command::Forward(options) => geometry::forward(options),
        Command::Jacobian(options) => geometry::jacobian(options),
        Command::Transfer(options) => geometry::transfer(options),
        Command::Train { network } => learning::train(network),
        Command::Dataset(options) => learning::dataset(options),
        Command::Scene { command } => scene::scene(command),
        Command::Judge(options) => study::judge(options),
        Command::Evaluate(options) => study::evaluate(options),
        Command::Paper(options) => study::paper(options),
        Command::Tradeoff(options) => study::tradeoff(options),
        Command::Advise(options) => study::advise(options),
        Command::Stability(options) => study::stability(options),
        Command::Honesty(options) => study::honesty(options),
        Command::Months(options) => study::months(options),
        Command::Calibrate(options) => maps::calibrate(options),
        Command::Merit(options) => maps::merit(options),
        Command::Reconstruct(options) => maps::reconstruct(options),
        Command::Completions { shell } => {
            let mut command = Arguments::command();
            clap_complete::generate(*shell, &mut command, "tactus-lab", &mut std::io::stdout());
            Ok(())
        }
    }
}

#[cfg(test)]
mod outputs {
    use clap::CommandFactory;
    use outfile::trial::{Paths, attack_every_output};

    use crate::args::Arguments;

    #[test]
    fn no_output_replaces_what_is_not_its_own() {
        let paths = Paths {
            outputs: &[
                (
                    "calibrate --out",
                    "calibrate --case c --method best --out {}",
                ),
                ("dataset --out", "dataset --out {}"),
                ("evaluate --parts", "evaluate --shard 0/1 --parts {}"),
                ("evaluate --picture", "evaluate --picture {}"),
                ("forward --out", "forward --case c --sigma s --out {}"),
                (
                    "forward --potentials",
                    "forward --case c --sigma s --out {} --potentials {}",
                ),
                ("honesty --out", "honesty --count 1 --faults 1 --out {}"),
                (
                    "jacobian --centres",
                    "jacobian --case c --sigma s --out {} --cells-mm 5 --centres {}",
                ),
                ("jacobian --out", "jacobian --case c --sigma s --out {}"),
                ("judge --out", "judge --set presses-10 --out {}"),
                (
                    "judge --parts",
                    "judge --set presses-10 --shard 0/1 --parts {}",
                ),
                ("mesh --out", "mesh --preset disc-tank --out {}"),
                ("months --out", "months --quick --out {}"),
                ("paper --out", "paper --quick --out {}"),
                (
                    "paper --parts",
                    "paper --quick --shard 0/1 --parts {} --out {}",
                ),
                (
                    "reconstruct --out",
                    "reconstruct --case c --frames f --out {}",
                ),
                ("scene run --logbook", "scene run quiet --logbook {}"),
                ("scene run --out", "scene run quiet --out {}"),
                ("sheet --out", "sheet --case c --out {}"),
                ("stability --out", "stability --only 1 --out {}"),
                (
                    "stability --parts",
                    "stability --only 1 --shard 0/1 --parts {}",
                ),
                ("tradeoff --out", "tradeoff --quick --out {}"),
                (
                    "tradeoff --parts",
                    "tradeoff --quick --shard 0/1 --parts {} --out {}",
                ),
                ("train dnn --out", "train dnn --profile paper --out {}"),
                (
                    "train linear --out",
                    "train linear --profile paper --out {}",
                ),
                ("train rbf --out", "train rbf --profile paper --out {}"),
                (
                    "transfer --admittance",
                    "transfer --case c --sigma s --admittance {}",
                ),
                (
                    "transfer --impedance",
                    "transfer --case c --sigma s --impedance {}",
                ),
            ],
            inputs: &[
                "advise --config",
                "advise --table",
                "calibrate --case",
                "calibrate --frames",
                "calibrate --presses",
                "dataset --case",
                "dataset --parts",
                "dataset --recorded",
                "dataset --settings",
                "evaluate --model",
                "evaluate --set",
                "forward --case",
                "forward --sigma-rows",
                "jacobian --case",
                "judge --case",
                "merit --images",
                "merit --targets",
                "merit --truth",
                "months --model",
                "paper --resident",
                "reconstruct --calibration",
                "reconstruct --case",
                "reconstruct --frames",
                "reconstruct --model",
                "scene run --config",
                "sheet --case",
                "sheet --frames",
                "sheet --session",
                "train dnn --case",
                // a checkpoint of the same training is replaced, any other file is refused
                "train dnn --checkpoint",
                "train dnn --dataset",
                "train dnn --noise-frames",
                "train dnn --settings",
                "train linear --case",
                "train linear --dataset",
                "train linear --noise-frames",
                "train rbf --case",
                "train rbf --dataset",
                "train rbf --noise-frames",
                "transfer --case",
            ],
        };
        attack_every_output(&Arguments::command(), &paths, crate::run);
    }
}
