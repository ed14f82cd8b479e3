//! Studies in shards: options to work, and what is printed when there is no report.

use shards::{Division, Outcome, StopRequest, missing_list};
use studies::Failure;

use crate::args::StudyShards;
use crate::learning::stop_request;
use crate::output::print_line;

/// What a command does of its study; a shard ends after the item in work when SIGTERM comes.
pub(super) fn divided(options: &StudyShards) -> Result<(Division, StopRequest), Failure> {
    let division = options.division();
    let stop = match division {
        Division::Shard(..) => stop_request()?,
        Division::Whole | Division::Missing(..) | Division::Merge(..) => StopRequest::default(),
    };
    Ok((division, stop))
}

/// The result of all items; prints what was done instead, if there is none.
pub(super) fn report_of<R>(outcome: Outcome<R>) -> Option<R> {
    match outcome {
        Outcome::All(report) => return Some(report),
        Outcome::Missing(numbers) => print_line!("{}", missing_list(&numbers)),
        Outcome::Made(made) => print_line!(
            "{}: {} items, {} of them from an earlier run",
            made.file.display(),
            made.items,
            made.kept
        ),
    }
    None
}
