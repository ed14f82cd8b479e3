//! The last step of every training: its model file, and the output of `--json`.

use std::path::Path;

use eit::{Model, model};
use serde::Serialize;
use serde_json::{Value, json};
use studies::Failure;

use crate::args::Replacing;

/// Writes the model file.
pub(super) fn save(path: &Path, replacing: &Replacing, trained: &Model) -> Result<(), Failure> {
    model::save(path, replacing.existing(), trained)
        .map_err(|fault| Failure::of("cannot write the model", &fault))
}

/// The model and the results of its training.
pub(super) fn json(path: &Path, model: &Model, report: &impl Serialize) -> Value {
    json!({
        "model": path.display().to_string(),
        "hash": model.hash(),
        "name": model.metadata().name,
        "training": model.metadata().training,
        "report": report,
        "own_misfit": model.metadata().own_misfit,
    })
}

/// What its maps leave unexplained of cases that it has not seen, by the size of their change.
pub(super) fn misfit(model: &Model) -> String {
    let Some(misfit) = &model.metadata().own_misfit else {
        return "what its maps leave unexplained is not known: too few held-out cases".to_owned();
    };
    let classes: Vec<String> = misfit
        .classes
        .iter()
        .map(|class| {
            format!(
                "{:.0} % (at most {:.0} %) of {} changes from {:.1e}",
                100.0 * class.median,
                100.0 * class.limit,
                class.cases,
                class.above
            )
        })
        .collect();
    format!(
        "its maps of held-out cases leave unexplained: {}; of the largest baseline reading",
        classes.join(", ")
    )
}
