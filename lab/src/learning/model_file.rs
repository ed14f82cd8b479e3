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
    })
}
