//! Progress bars on standard error if that is a terminal.

use std::sync::Mutex;
use training::samples::Stage;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar with `length` steps.
pub fn bar(length: usize, what: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:12} {wide_bar} {pos}/{len} {eta}")
        .expect("the template is a constant and well formed");
    ProgressBar::new(length as u64)
        .with_style(style)
        .with_message(what)
}

/// The bars of a training, one per stage.
#[derive(Default)]
pub struct Training {
    current: Mutex<Option<(Stage, ProgressBar)>>,
}

impl Training {
    /// Shows the progress of a stage.
    pub fn show(&self, stage: Stage, done: usize, of: usize) {
        let mut current = self.current.lock().expect("no bar panics while it is held");
        if current.as_ref().is_none_or(|(shown, _)| *shown != stage) {
            if let Some((_, bar)) = current.take() {
                bar.finish();
            }
            let what = match stage {
                Stage::Cases => "cases",
                Stage::Clusters => "clusters",
                Stage::Weights => "weights",
            };
            *current = Some((stage, bar(of, what)));
        }
        if let Some((_, bar)) = current.as_ref() {
            bar.set_position(done as u64);
        }
    }
}

impl Drop for Training {
    fn drop(&mut self) {
        if let Ok(Some((_, bar))) = self.current.get_mut().map(Option::take) {
            bar.finish();
        }
    }
}
