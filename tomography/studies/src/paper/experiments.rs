//! The paper's two tests with every method, at each noise level, for several draws of the noise, and on unevenly
//! sprayed sheets.

use super::evaluation::{Artifact, Evaluations, FoundMap, Job};
use super::plan::{DEEP, Method, Plan, RBF, TV};
use crate::evaluation::{Figures, OfFrame};
use crate::failure::Failure;
use crate::judging_seed;

/// Result of one method on one set.
pub(super) struct Outcome {
    pub(super) method: &'static str,
    pub(super) set: Set,
    /// The maps, for the paper's three methods; otherwise empty.
    pub(super) maps: Vec<FoundMap>,
    /// Figures of each frame.
    pub(super) of_frames: Vec<OfFrame>,
    /// Means of the figures.
    pub(super) figures: Figures,
}

/// A set of loads with its noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Set {
    /// Number of the test, 1 or 2.
    pub(super) test: u8,
    pub(super) noise_uv: f64,
    pub(super) spray: f64,
    pub(super) draw: u64,
}

impl Set {
    /// A test with the first draw of the noise, on an even sheet.
    pub(super) fn even(test: u8, noise_uv: f64) -> Self {
        Self {
            test,
            noise_uv,
            spray: 0.0,
            draw: 0,
        }
    }
}

pub(super) struct Experiments {
    pub(super) results: Vec<Outcome>,
}

/// Noise of the paper's figures, uV: that of the 34980A at 1 power-line cycle.
pub(super) const FIGURES_AT: f64 = 2.0;

impl Experiments {
    /// Runs the experiments, or only those needed for one figure.
    pub(super) fn run(
        plan: &Plan,
        evaluations: &Evaluations,
        methods: &[Method],
        figure: Option<u8>,
    ) -> Result<Self, Failure> {
        let at = |test, noise_uv, spray, draw| Set {
            test,
            noise_uv,
            spray,
            draw,
        };
        let mut sets = Vec::new();
        match figure {
            Some(7) => sets.push(Set::even(2, FIGURES_AT)),
            Some(_) => sets.push(Set::even(1, FIGURES_AT)),
            None => {
                for &noise in plan.noises {
                    sets.extend([Set::even(1, noise), Set::even(2, noise)]);
                    // further draws, to measure the share of noise in a map
                    if noise > 0.0 {
                        sets.extend((1..plan.draws).map(|draw| at(1, noise, 0.0, draw)));
                    }
                }
                sets.extend(
                    plan.sprays
                        .iter()
                        .filter(|spray| **spray > 0.0)
                        .map(|&spray| at(1, FIGURES_AT, spray, 0)),
                );
            }
        }
        let mut results = Vec::new();
        for set in sets {
            for method in methods {
                let papers = method.source.is_model() || method.name == TV;
                // draws and sprayed sheets are evaluated for the paper's methods only; the others would take hours
                if (set.draw > 0 || set.spray > 0.0 || figure.is_some()) && !papers {
                    continue;
                }
                let evaluated = evaluations.of(Job {
                    method: method.name.to_owned(),
                    source: method.source.clone(),
                    set: test_set(plan, set),
                    maps: [TV, DEEP, RBF].contains(&method.name),
                })?;
                let Some(figures) = evaluated.figures else {
                    continue;
                };
                results.push(Outcome {
                    method: method.name,
                    set,
                    figures,
                    of_frames: evaluated.of_frames,
                    maps: evaluated.maps,
                });
            }
        }
        Ok(Self { results })
    }

    /// The result of a test at a noise level, on an even sheet, for the first draw.
    pub(super) fn of<'a>(
        &'a self,
        method: &'a str,
        test: u8,
        noise_uv: f64,
    ) -> Option<&'a Outcome> {
        self.at(method, test, noise_uv, 0.0).next()
    }

    /// The results of all draws.
    pub(super) fn at<'a>(
        &'a self,
        method: &'a str,
        test: u8,
        noise_uv: f64,
        spray: f64,
    ) -> impl Iterator<Item = &'a Outcome> {
        self.results.iter().filter(move |result| {
            let set = &result.set;
            result.method == method
                && set.test == test
                && set.noise_uv == noise_uv
                && set.spray == spray
        })
    }

    /// All results, for `results.json`.
    pub(super) fn table(&self) -> serde_json::Value {
        let number = |value: f64| value.is_finite().then_some(value);
        self.results
            .iter()
            .map(|result| {
                let f = &result.figures;
                serde_json::json!({
                    "test": result.set.test,
                    "noise_uv": result.set.noise_uv,
                    "spray": result.set.spray,
                    "draw": result.set.draw,
                    "method": result.method,
                    "frames": f.frames,
                    "location_error_mm": number(f.error_mm),
                    "worst_location_error_mm": number(f.worst_mm),
                    "correlation": number(f.correlation),
                    "relative_error": number(f.relative_error),
                    "dice": number(f.dice),
                    "ssim": number(f.ssim),
                    "greit": f.greit.map(number),
                    "frame_ms": f.ms,
                    "peaks": result.of_frames.iter().map(|frame| frame.peak).collect::<Vec<_>>(),
                })
            })
            .collect()
    }
}

/// The artifact of a test set.
pub(super) fn test_set(plan: &Plan, set: Set) -> Artifact {
    let seed = judging_seed(plan.seed, set.draw);
    let (test, noise, spray) = (set.test, set.noise_uv * 1e-6, set.spray);
    let mut command = format!("judge --set test-{test} --noise-v {noise:e} --seed {seed}");
    let mut name = format!("sets/test-{test}-{}uV", set.noise_uv);
    if spray > 0.0 {
        command += &format!(" --spray {spray}");
        name += &format!("-spray-{spray}");
    }
    if set.draw > 0 {
        name += &format!("-draw-{}", set.draw);
    }
    Artifact { name, command }
}
