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

/// The misfit of the model's maps on unseen cases as text, by the size of the change.
pub(super) fn misfit(model: &Model) -> String {
    let Some(misfit) = &model.metadata().own_misfit else {
        return "no limit for own misfit: too few held-out cases".to_owned();
    };
    let classes: Vec<String> = misfit
        .classes
        .iter()
        .map(|class| {
            format!(
                "  changes from {:.1e} of the largest reading: median {:.0} %, limit {:.0} % ({} cases)",
                class.above,
                100.0 * class.median,
                100.0 * class.limit,
                class.cases
            )
        })
        .collect();
    format!(
        "own misfit, the share of the change that maps of held-out cases leave unexplained:\n{}",
        classes.join("\n")
    )
}
