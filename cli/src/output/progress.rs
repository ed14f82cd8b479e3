//! Progress bars on standard error.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};

/// A progress bar for `frames`, or a spinner if their number is unknown; hidden without a terminal.
pub(crate) fn progress(frames: Option<u64>, terminal: bool) -> ProgressBar {
    if !terminal || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let (bar, template) = match frames {
        Some(frames) => (
            ProgressBar::new(frames),
            "{bar:40} {pos}/{len} frames, {eta} left",
        ),
        None => (
            ProgressBar::new_spinner(),
            "{spinner} {pos} frames, {elapsed}",
        ),
    };
    bar.with_style(
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()),
    )
}
