//! Reads the configuration of a daemon.

use std::path::Path;

use config::Config;
use config::problems::Source;
use studies::Failure;

/// Reads a configuration file.
///
/// # Errors
/// A file that cannot be read, or the first of its problems.
pub(crate) fn read(path: &Path) -> Result<Config, Failure> {
    let refused = |why: String| {
        Failure::usage(format!(
            "{}: {why}; name another configuration with --config FILE",
            path.display()
        ))
    };
    let text = std::fs::read_to_string(path).map_err(|cause| refused(cause.to_string()))?;
    match Source::new(path, text).read() {
        (Some(config), _) => Ok(config),
        (None, problems) => Err(refused(
            problems
                .first()
                .map_or_else(String::new, ToString::to_string),
        )),
    }
}
