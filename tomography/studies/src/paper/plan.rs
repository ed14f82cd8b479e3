//! Extent of a run: the paper's sizes, or small ones.

use std::path::PathBuf;

use eit::{Model, Report, model};

use super::evaluation::{Artifact, Source};
use crate::artifact_cache::ArtifactCache;
use crate::failure::{Attempt, Failure};

/// Settings of a run.
pub(super) struct Plan {
    pub(super) name: &'static str,
    pub(super) seed: u64,
    /// Noise of one reading, uV.
    pub(super) noises: &'static [f64],
    /// Draws of the noise in the experiment with noise.
    pub(super) draws: u64,
    /// Unevenness of the sprayed sheets, as standard deviation of ln(conductance).
    pub(super) sprays: &'static [f64],
    /// Exponents of alpha as a power of ten.
    pub(super) alphas: &'static [i32],
    /// Multiples of Eq. 13's spread.
    pub(super) spreads: &'static [f64],
    /// Size of the sheet relative to the paper's, and numbers of electrodes along width and height.
    pub(super) sheets: &'static [(f64, usize, usize)],
    cases: usize,
    repeats: usize,
    epochs: usize,
    width: usize,
    /// Whether to include the method `best`, which takes seconds per frame.
    pub(super) best: bool,
}

/// A method of the paper, or one for comparison.
pub(super) struct Method {
    /// Name on the page.
    pub(super) name: &'static str,
    /// Its options, or the command that creates its model.
    pub(super) source: Source,
    /// The model of a trained method after [`Plan::load`]; otherwise `None`.
    pub(super) model: Option<Trained>,
}

/// A trained model's file.
pub(super) struct Trained {
    pub(super) file: PathBuf,
    pub(super) bytes: u64,
    pub(super) hash: String,
    pub(super) weights: usize,
    /// Growth of this process by loading the model, bytes; `None` if the system does not report it.
    pub(super) resident: Option<u64>,
    /// The command that made it.
    pub(super) command: String,
}

/// The paper's three methods, by the names of its figures.
pub(super) const TV: &str = "TV as printed";
pub(super) const DEEP: &str = "deep network";
pub(super) const RBF: &str = "RBF network";
/// The file of the paper's RBF network.
pub(super) const RBF_FILE: &str = "models/rbf-paper.safetensors";

impl Plan {
    pub(super) fn new(full: bool, seed: u64) -> Self {
        if full {
            Self {
                name: "full",
                seed,
                noises: &[0.0, 2.0, 20.0, 396.0],
                draws: 8,
                sprays: &[0.0, 0.05, 0.1, 0.3],
                alphas: &[-10, -9, -8, -7, -6, -5, -4, -3, -2],
                spreads: &[0.25, 0.5, 1.0, 2.0, 4.0],
                // on an even smaller sheet the electrodes next to a corner would touch
                sheets: &[
                    (0.85, 6, 7),
                    (1.0, 4, 4),
                    (1.0, 5, 5),
                    (1.0, 6, 7),
                    (1.0, 8, 8),
                    (1.5, 6, 7),
                    (2.0, 6, 7),
                ],
                cases: 15_000,
                repeats: 5,
                epochs: 30,
                width: 2048,
                best: true,
            }
        } else {
            Self {
                name: "quick",
                seed,
                noises: &[0.0, 2.0, 396.0],
                draws: 2,
                sprays: &[0.0, 0.1],
                alphas: &[-8, -6, -4, -2],
                spreads: &[0.5, 1.0, 2.0],
                sheets: &[(1.0, 4, 4), (1.0, 6, 7)],
                cases: 600,
                repeats: 2,
                epochs: 2,
                width: 96,
                best: false,
            }
        }
    }

    /// The settings, for `settings.json`.
    pub(super) fn described(&self) -> serde_json::Value {
        serde_json::json!({
            "run": self.name,
            "seed": self.seed,
            "noise_uv": self.noises,
            "noise_draws": self.draws,
            "spray": self.sprays,
            "spread_times": self.spreads,
            "training_cases": self.cases,
            "jittered_copies": self.repeats,
            "epochs": self.epochs,
            "width": self.width,
            "version": env!("CARGO_PKG_VERSION"),
            "threads": rayon::current_num_threads(),
            "build": if cfg!(debug_assertions) { "development" } else { "release" },
        })
    }

    /// The command that trains an RBF network, for the paper's sheet if no case folder is added.
    pub(super) fn rbf(&self, profile: &str) -> String {
        format!("train rbf --profile {profile} {}", self.size())
    }

    fn size(&self) -> String {
        let (cases, repeats, seed) = (self.cases, self.repeats, self.seed);
        // `--yes`: a model without any training success is accepted, because the study evaluates it
        format!("--cases {cases} --repeats {repeats} --seed {seed} --yes")
    }

    /// All methods; their networks are not loaded yet.
    pub(super) fn methods(&self) -> Vec<Method> {
        let deep = format!(
            "train dnn --profile paper {} --epochs {} --set width={}",
            self.size(),
            self.epochs,
            self.width
        );
        let linear = format!(
            "train linear --profile matched --cases {} --seed {} --symmetric --yes",
            self.cases, self.seed
        );
        let plain = |name: &'static str, options: &str| Method {
            name,
            source: Source::Options(options.to_owned()),
            model: None,
        };
        let trained = |name: &'static str, file: &str, command: String| Method {
            name,
            source: Source::Model(Artifact {
                name: file.to_owned(),
                command,
            }),
            model: None,
        };
        let mut methods = vec![
            plain(TV, "--method tv-paper"),
            trained(DEEP, "models/dnn-paper.safetensors", deep),
            trained(RBF, RBF_FILE, self.rbf("paper")),
            plain("TV", "--method tv"),
            plain("TV, losses only", "--method tv --loss-only"),
            plain("one-step", "--method one-step"),
            plain("one-step, losses only", "--method one-step --loss-only"),
            trained(
                "linear, trained",
                "models/linear-matched.safetensors",
                linear,
            ),
            trained(
                "RBF, matched",
                "models/rbf-matched.safetensors",
                self.rbf("matched"),
            ),
        ];
        if self.best {
            methods.push(plain("best", "--method best"));
        }
        methods
    }

    /// Creates and loads the models of the methods.
    pub(super) fn load(
        &self,
        place: &ArtifactCache<'_>,
        methods: &mut [Method],
    ) -> Result<(), Failure> {
        for method in methods.iter_mut().filter(|method| method.model.is_none()) {
            let Source::Model(artifact) = &method.source else {
                continue;
            };
            let file = artifact.make(place)?;
            let loaded = model::load(&file).attempt("cannot use a trained model")?;
            let bytes = std::fs::metadata(&file)
                .map_err(|cause| Failure::of(&format!("{}", file.display()), &cause))?
                .len();
            method.model = Some(Trained {
                bytes,
                hash: loaded.hash().to_owned(),
                weights: weights(&loaded),
                resident: place.resident_bytes(&file),
                command: format!("tactus-lab {}", artifact.command),
                file,
            });
        }
        Ok(())
    }
}

/// Number of weights and biases; for an RBF network those of its output layer, as in the paper.
fn weights(loaded: &Model) -> usize {
    match &loaded.metadata().report {
        Report::Deep(report) => report.parameters,
        Report::Rbf(_) => loaded.metadata().training.neurons * loaded.mesh().region().len(),
    }
}
