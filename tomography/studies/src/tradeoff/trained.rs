//! Models and test sets for several diagrams.

use std::path::PathBuf;

use super::Effort;
use crate::artifact_cache::ArtifactCache;
use crate::failure::Failure;
use crate::judging_seed;

/// A model trained for a diagram, and the time of its training.
pub(crate) struct Trained {
    pub(crate) file: PathBuf,
    /// Wall time of the training, s, from the run in which it took place.
    pub(crate) seconds: f64,
}

impl Trained {
    /// Trains a model, or reuses one trained with the same arguments of `train`.
    pub(crate) fn new(place: &ArtifactCache<'_>, arguments: &str) -> Result<Self, Failure> {
        let name = arguments.replace("--", "").replace([' ', '='], "-");
        let name = format!("models/{name}.safetensors");
        // `--yes`: a model without any training success is accepted, because the study evaluates it
        let (file, seconds) = place.made_timed(&name, &format!("train {arguments} --yes"))?;
        Ok(Self { file, seconds })
    }

    /// Arguments of `reconstruct`.
    pub(crate) fn words(&self) -> Vec<String> {
        vec!["--model".to_owned(), self.file.display().to_string()]
    }
}

/// Test sets of one kind, one per seed.
pub(crate) fn judged_sets(
    effort: &Effort,
    place: &ArtifactCache<'_>,
    set: &str,
    count: usize,
) -> Result<Vec<PathBuf>, Failure> {
    (0..Effort::SEEDS)
        .map(|draw| {
            let seed = judging_seed(effort.seed, draw);
            place.made(
                &format!("sets/{set}-{count}-{seed}"),
                &format!("judge --set {set} --count {count} --seed {seed}"),
            )
        })
        .collect()
}
