//! The evaluations of the study: methods on test sets, each an item of work in shards. The code that uses the results
//! runs twice: a first pass without results lists the evaluations, so that the list cannot differ from the use.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use survey::Map;

use crate::artifact_cache::{ArtifactCache, FOLDER};
use crate::evaluation::{Figures, OfFrame, figures, maps, of_frames};
use crate::failure::Failure;

/// Placeholder in the command of a model for the folder of the test set on which the model is evaluated.
pub(super) const TEST_SET: &str = "{set}";

/// A file or folder of the output folder, and the command that creates it.
#[derive(Debug, Clone)]
pub(super) struct Artifact {
    pub(super) name: String,
    pub(super) command: String,
}

impl Artifact {
    /// The path of the artifact, which is created if it does not exist.
    pub(super) fn make(&self, place: &ArtifactCache<'_>) -> Result<PathBuf, Failure> {
        place.made(&self.name, &self.command)
    }
}

/// Options of `reconstruct`, or a model that a command creates.
#[derive(Debug, Clone)]
pub(super) enum Source {
    Options(String),
    Model(Artifact),
}

impl Source {
    pub(super) fn is_model(&self) -> bool {
        matches!(self, Self::Model(_))
    }
}

/// A method on a test set.
#[derive(Debug, Clone)]
pub(super) struct Job {
    /// Displayed name of the method.
    pub(super) method: String,
    pub(super) source: Source,
    pub(super) set: Artifact,
    /// Whether the maps are needed in addition to their figures of merit.
    pub(super) maps: bool,
}

impl Job {
    /// A text with everything that determines the result, except the build.
    pub(super) fn name(&self) -> String {
        let source = match &self.source {
            Source::Options(options) => options.clone(),
            Source::Model(Artifact { name, command }) => format!("{name} by {command}"),
        };
        let maps = if self.maps { ", with maps" } else { "" };
        let Artifact { name, command } = &self.set;
        format!("{name} by {command}: {source}{maps}")
    }

    /// Creates the artifacts that the job needs, and evaluates the method.
    pub(super) fn run(&self, place: &ArtifactCache<'_>) -> Result<Evaluated, Failure> {
        let folder = self.set.make(place)?;
        let words = match &self.source {
            Source::Options(options) => options.split(' ').map(str::to_owned).collect(),
            Source::Model(Artifact { name, command }) => {
                let set = format!("{FOLDER}/{}", self.set.name);
                let file = place.made(name, &command.replace(TEST_SET, &set))?;
                vec!["--model".to_owned(), file.display().to_string()]
            }
        };
        let judged = maps(&folder, &self.method, &words)?;
        let of_frames = of_frames(&judged)?;
        let figures = figures(&self.method, &judged, &of_frames);
        let kept = judged.frames.into_iter().filter(|_| self.maps);
        Ok(Evaluated {
            figures: Some(figures),
            of_frames,
            maps: kept
                .map(|frame| FoundMap {
                    map: frame.map,
                    place: frame.place,
                })
                .collect(),
        })
    }
}

/// A map, and the position of the load, m, if it is one disc.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct FoundMap {
    pub(super) map: Map,
    pub(super) place: Option<[f64; 2]>,
}

/// The result of a job; empty in the first pass.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Evaluated {
    pub(super) figures: Option<Figures>,
    pub(super) of_frames: Vec<OfFrame>,
    pub(super) maps: Vec<FoundMap>,
}

/// The jobs of a study (first pass), or their results (second pass).
pub(super) enum Evaluations {
    /// The first pass collects the jobs.
    Listing(RefCell<Vec<Job>>),
    /// The second pass uses the results, by the names of the jobs.
    Known(BTreeMap<String, Evaluated>),
}

impl Evaluations {
    pub(super) fn listing() -> Self {
        Self::Listing(RefCell::new(Vec::new()))
    }

    /// The result of a job; in the first pass, an empty one.
    pub(super) fn of(&self, job: Job) -> Result<Evaluated, Failure> {
        match self {
            Self::Listing(jobs) => {
                jobs.borrow_mut().push(job);
                Ok(Evaluated::default())
            }
            Self::Known(results) => results
                .get(&job.name())
                .cloned()
                .ok_or_else(|| Failure::because(format!("{} was not evaluated", job.name()))),
        }
    }

    /// The collected jobs, each once, in the order of their use.
    pub(super) fn jobs(self) -> Vec<Job> {
        let Self::Listing(jobs) = self else {
            return Vec::new();
        };
        let mut names = std::collections::BTreeSet::new();
        let mut jobs = jobs.into_inner();
        jobs.retain(|job| names.insert(job.name()));
        jobs
    }
}
