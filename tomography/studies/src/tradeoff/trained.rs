//! Models and judging data that several diagrams use.

use std::path::PathBuf;
use std::time::Instant;

use outfile::Existing;

use super::Effort;
use crate::artifact_cache::ArtifactCache;
use crate::failure::Failure;

/// A model that was trained for a diagram, and how long that took.
pub(crate) struct Trained {
    pub(crate) file: PathBuf,
    /// Wall time of the training; of the run that made it.
    pub(crate) seconds: f64,
}

impl Trained {
    /// Trains, or takes what the same words have trained before.
    pub(crate) fn new(place: &ArtifactCache<'_>, words: &[&str]) -> Result<Self, Failure> {
        let name = words[1..].join("-").replace("--", "").replace('=', "-");
        let name = format!("models/{name}.safetensors");
        let start = Instant::now();
        let file = place.made(&name, words)?;
        let took = start.elapsed().as_secs_f64();
        let kept = place.path(&format!("{name}.seconds"));
        let seconds = match std::fs::read_to_string(&kept)
            .ok()
            .and_then(|text| text.trim().parse().ok())
        {
            Some(seconds) if took < 0.5 * seconds => seconds,
            _ => {
                crate::failure::write(&kept, Existing::Replace, format!("{took}\n"))?;
                took
            }
        };
        Ok(Self { file, seconds })
    }

    /// What `reconstruct` is told.
    pub(crate) fn words(&self) -> Vec<String> {
        vec!["--model".to_owned(), self.file.display().to_string()]
    }
}

/// Judging data of some kind, one set a seed.
pub(crate) fn judged_sets(
    effort: &Effort,
    place: &ArtifactCache<'_>,
    set: &str,
    count: usize,
) -> Result<Vec<PathBuf>, Failure> {
    (0..effort.seeds())
        .map(|draw| {
            // never a training's seed
            let seed = (1000 * (effort.seed + 1) + draw).to_string();
            let count = count.to_string();
            place.made(
                &format!("sets/{set}-{count}-{seed}"),
                &["judge", "--set", set, "--count", &count, "--seed", &seed],
            )
        })
        .collect()
}
