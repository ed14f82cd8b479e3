//! One binary, several programs.

use std::ffi::OsString;
use std::process::ExitCode;

/// Runs `tactusd`, `tactus` or `tactus-sim` when the first argument names it; `None` when it names none of them.
///
/// `args` are those of the process; the first one is this binary itself.
pub fn act_as(mut args: impl Iterator<Item = OsString>) -> Option<ExitCode> {
    args.next();
    let program = args.next()?;
    let run: fn(std::vec::IntoIter<OsString>) -> ExitCode = match program.to_str()? {
        "tactusd" => |args| daemon::run(args),
        "tactus" => |args| cli::run(args),
        "tactus-sim" => |args| simulator::run(args),
        _ => return None,
    };
    let args: Vec<OsString> = std::iter::once(program).chain(args).collect();
    Some(run(args.into_iter()))
}
