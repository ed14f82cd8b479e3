//! Studies in shards: converts the options, and prints the outcome if there is no report.

use shards::{Division, Outcome, StopRequest, missing_list};
use studies::Failure;

use crate::args::StudyShards;
use crate::learning::stop_request;
use crate::output::print_line;

/// The division of a study, and a request to stop: after SIGTERM a shard ends when the current item is complete.
pub(super) fn divided(options: &StudyShards) -> Result<(Division, StopRequest), Failure> {
    let division = options.division();
    let stop = match division {
        Division::Shard(..) => stop_request()?,
        Division::Whole | Division::Missing(..) | Division::Merge(..) => StopRequest::default(),
    };
    Ok((division, stop))
}

/// The report on all items; if there is none, prints what was done and returns `None`.
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
