//! Finds and checks every output on a command line, by the types of the arguments.

use clap::builder::ValueParser;
use clap::{Arg, ArgMatches, Command};

use crate::{Existing, GrowingFolder, OutFileError, OutFolder, OutPath, check, check_folder};

/// Checks every output of a parsed command line before the command starts, so that hours of work are not lost to an
/// existing file. Respects `--force` of the same command.
///
/// # Errors
/// The first output that would be refused.
pub fn check_arguments(command: &Command, matches: &ArgMatches) -> Result<(), OutFileError> {
    let forced =
        command.get_arguments().any(|arg| arg.get_id() == "force") && matches.get_flag("force");
    let existing = Existing::forced(forced);
    for arg in outputs_of(command) {
        let id = arg.get_id().as_str();
        if let Ok(Some(path)) = matches.try_get_one::<OutPath>(id) {
            check(path, existing)?;
        } else if let Ok(Some(folder)) = matches.try_get_one::<OutFolder>(id) {
            check_folder(folder, existing)?;
        } else if let Ok(Some(folder)) = matches.try_get_one::<GrowingFolder>(id) {
            check_folder(folder, Existing::Replace)?;
        }
    }
    match matches.subcommand() {
        Some((name, inner)) => command
            .find_subcommand(name)
            .map_or(Ok(()), |command| check_arguments(command, inner)),
        None => Ok(()),
    }
}

/// The arguments of a command (not of its subcommands) that name an output.
pub fn outputs_of(command: &Command) -> impl Iterator<Item = &Arg> {
    let types = [
        ValueParser::from(clap::value_parser!(OutPath)).type_id(),
        ValueParser::from(clap::value_parser!(OutFolder)).type_id(),
        ValueParser::from(clap::value_parser!(GrowingFolder)).type_id(),
    ];
    command
        .get_arguments()
        .filter(move |arg| types.contains(&arg.get_value_parser().type_id()))
}
