//! Diagram 3: all methods on four kinds of data.

use std::path::PathBuf;
use std::time::Instant;

use outfile::Existing;
use phantom::Scene;

use super::precision;
use crate::artifact_cache::{ArtifactCache, FOLDER};
use crate::evaluation::{Judged, average, figures, maps_not_refused, of_frames, quantile};
use crate::failure::Failure;
use crate::judging_seed;
use crate::tradeoff::Effort;
use crate::tradeoff::panel::{FARTHEST_MM, Panel, Point};
use crate::tradeoff::trained::{Trained, judged_sets};

/// A method's options and name.
struct Method {
    line: &'static str,
    setting: String,
    words: Vec<String>,
    /// Time of the preparation before the first frame, without loading of a model, s; `None` for methods without
    /// training.
    training_s: Option<f64>,
}

pub(crate) fn panel(effort: &Effort, place: &ArtifactCache<'_>) -> Result<Panel, Failure> {
    let methods = methods(effort, place)?;
    let mut points = Vec::new();
    let mut refused = Vec::new();
    for kind in effort.of(&[Kind::Presses10][..], &Kind::ALL) {
        let sets = kind.sets(effort, place)?;
        for method in &methods {
            let (mut errors, mut times, mut all, mut setups) =
                (Vec::new(), Vec::new(), Vec::new(), Vec::new());
            let (mut means, mut requested, mut made) = (Vec::new(), 0, 0);
            for set in &sets {
                let start = Instant::now();
                let judged = maps_not_refused(&set.folder, method.line, &method.words)?;
                let whole = start.elapsed().as_secs_f64();
                requested += set.frames;
                made += judged.frames.len();
                let seconds: Vec<f64> = judged.frames.iter().map(|frame| 1e-3 * frame.ms).collect();
                setups.push((whole - seconds.iter().sum::<f64>()).max(0.0));
                times.extend(seconds);
                let found = distances_mm(&judged);
                if !found.is_empty() {
                    errors.push(average(found.iter().copied()));
                    all.extend(found);
                    means.push(figures(method.line, &judged, &of_frames(&judged)?));
                }
            }
            if errors.is_empty() {
                refused.push(format!(
                    "{}: {}, {} refuses every frame",
                    kind.name(),
                    method.line,
                    method.setting
                ));
                continue;
            }
            let mean = |of: fn(&crate::evaluation::Figures) -> f64| {
                average(means.iter().map(of).filter(|value| value.is_finite()))
            };
            let p99 = quantile(&mut times, 0.99);
            points.push(
                Point::new(
                    method.line,
                    &method.setting,
                    quantile(&mut times, 0.5),
                    &errors,
                )
                .of(kind.name())
                .with("refused, share", 1.0 - made as f64 / requested as f64)
                .with("p99, s", p99)
                .with("p95 error, mm", quantile(&mut all, 0.95))
                .with("correlation", mean(|f| f.correlation))
                .with("SSIM", mean(|f| f.ssim))
                .with("Dice", mean(|f| f.dice))
                .with("AR", mean(|f| f.greit[0]))
                .with("PE", mean(|f| f.greit[1]))
                .with("RES", mean(|f| f.greit[2]))
                .with("SD", mean(|f| f.greit[3]))
                .with("RNG", mean(|f| f.greit[4]))
                .with("set-up, s", quantile(&mut setups, 0.5))
                .with("training, s", method.training_s.unwrap_or(f64::NAN)),
            );
        }
    }
    Ok(Panel {
        panel: "reconstruction".to_owned(),
        title: "Reconstruction: location error against a frame's time".to_owned(),
        across: "a frame, s".to_owned(),
        up: "location error, mm".to_owned(),
        shows: "Every method and its sizes on four scenes, five draws of each (other seeds, finer mesh): single presses of 10 and 30 mm \
                under 2 uV of noise, a night at a bedside, and a torture scene with every effect at once; the distance from the true \
                to the found place (centroid of the upper half of the loss), the table with 95th percentile, correlation, SSIM, Dice, \
                GREIT's figures and the share of frames that a method refuses. Networks are trained here on few cases; total \
                variation goes by its gap to the minimum, which is what its iterations are for."
            .to_owned(),
        not_proved: "The location error says nothing of shapes: the table's other columns do. Times are of one frame after the other \
                     in one process. In the torture scene electrodes come off and are shorted, and \
                     no method is told."
            .to_owned(),
        not_built: refused,
        costs: true,
        points,
    })
}

/// Kind of data.
#[derive(Clone, Copy)]
enum Kind {
    Presses10,
    Presses30,
    Bedside,
    Torture,
}

/// A test set.
struct Set {
    folder: PathBuf,
    frames: usize,
}

impl Kind {
    const ALL: [Self; 4] = [
        Self::Presses10,
        Self::Presses30,
        Self::Bedside,
        Self::Torture,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Presses10 => "clean",
            Self::Presses30 => "large",
            Self::Bedside => "bedside",
            Self::Torture => "torture",
        }
    }

    fn sets(self, effort: &Effort, place: &ArtifactCache<'_>) -> Result<Vec<Set>, Failure> {
        let judged = |set: &str| -> Result<Vec<Set>, Failure> {
            let frames = effort.of(4, 8);
            let sets = judged_sets(effort, place, set, frames)?;
            Ok(sets
                .into_iter()
                .map(|folder| Set { folder, frames })
                .collect())
        };
        match self {
            Self::Presses10 => judged("presses-10"),
            Self::Presses30 => judged("presses-30"),
            // bedside-night: one frame per hour; torture: one frame per minute through all faults
            Self::Bedside => scenes(effort, place, "bedside-night", "3600"),
            Self::Torture => scenes(effort, place, "torture", "60"),
        }
    }
}

/// Frames of a shipped scene, with other seeds.
fn scenes(
    effort: &Effort,
    place: &ArtifactCache<'_>,
    name: &str,
    every: &str,
) -> Result<Vec<Set>, Failure> {
    let text = Scene::shipped()
        .iter()
        .find(|(shipped, _)| *shipped == name)
        .map(|(_, text)| *text)
        .ok_or_else(|| Failure::because(format!("scene '{name}' does not ship with this build")))?;
    (0..Effort::SEEDS)
        .map(|draw| {
            let seed = judging_seed(effort.seed, draw);
            let lines = text.lines().map(|line| match line.starts_with("seed = ") {
                true => format!("seed = {seed}\n"),
                false => format!("{line}\n"),
            });
            let set = format!("sets/{name}-{seed}");
            let scene = place.path(&format!("{set}.toml"));
            crate::failure::write(&scene, Existing::Replace, lines.collect())?;
            let command = format!("scene run {FOLDER}/{set}.toml --every {every} --frames 9");
            let folder = place.made(&set, &command)?;
            Ok(Set { folder, frames: 8 })
        })
        .collect()
}

/// Location error of each frame, mm; frames without a load are skipped. A map without a loss gets the error
/// [`FARTHEST_MM`].
fn distances_mm(judged: &Judged) -> Vec<f64> {
    let mesh = &judged.case.mesh;
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    judged
        .frames
        .iter()
        .filter_map(|frame| {
            let at = frame
                .place
                .or_else(|| frame.truth.found(&centroids, &areas))?;
            Some(match frame.map.found(&centroids, &areas) {
                Some(found) => 1e3 * (found[0] - at[0]).hypot(found[1] - at[1]),
                None => FARTHEST_MM,
            })
        })
        .collect()
}

/// The methods without training.
fn untrained(full: bool) -> Vec<Method> {
    let mut methods = Vec::new();
    let mut plain = |line: &'static str, setting: &str, words: &str| {
        methods.push(Method {
            line,
            setting: setting.to_owned(),
            words: ["--method"]
                .into_iter()
                .chain(words.split(' '))
                .map(str::to_owned)
                .collect(),
            training_s: None,
        });
    };
    plain("one-step", "noser", "one-step");
    plain(
        "one-step",
        "noser, map error 1e-3",
        "one-step --map-error 1e-3",
    );
    plain("one-step, losses only", "noser", "one-step --loss-only");
    if full {
        plain("one-step", "laplace", "one-step --prior laplace");
        plain("one-step", "gaussian", "one-step --prior gaussian");
        plain(
            "one-step, losses only",
            "laplace",
            "one-step --prior laplace --loss-only",
        );
    }
    plain("paper's TV step", "alpha 1e-6", "tv-paper");
    // gaps must be below 1
    let gaps = match full {
        true => &["9e-1", "3e-1", "1e-1", "1e-2", "1e-3", "1e-6"][..],
        false => &["1e-1", "1e-3"],
    };
    for gap in gaps {
        let setting = format!("gap {gap}");
        plain("TV", &setting, &format!("tv --gap {gap}"));
        let words = format!("tv --loss-only --gap {gap}");
        plain("TV, losses only", &setting, &words);
    }
    if full {
        plain("best", "full model", "best");
    }
    methods
}

fn methods(effort: &Effort, place: &ArtifactCache<'_>) -> Result<Vec<Method>, Failure> {
    let mut methods = untrained(effort.full);
    let cases = precision::cases(effort);
    let mut trained = |line: &'static str, setting: String, trained: Trained| {
        methods.push(Method {
            line,
            setting,
            words: trained.words(),
            training_s: Some(trained.seconds),
        });
    };
    let common = format!("--profile matched --cases {cases} --seed {}", effort.seed);
    trained(
        "linear",
        format!("{cases} cases"),
        Trained::new(place, &format!("linear {common}"))?,
    );
    for centres in effort.of(&[25, 100][..], &[25, 50, 100, 200, 400]) {
        trained(
            "RBF network",
            format!("{centres} centres"),
            Trained::new(place, &format!("rbf {common} --neurons {centres}"))?,
        );
    }
    for &width in precision::widths(effort) {
        let model = precision::deep(effort, place, width, "f32")?;
        trained("deep network", format!("width {width}"), model);
    }
    Ok(methods)
}

#[cfg(test)]
mod tests {
    use super::untrained;
    use crate::evaluation::MethodOptions;

    #[test]
    fn options_of_methods_without_training_are_accepted() {
        for method in [false, true].into_iter().flat_map(untrained) {
            let options = MethodOptions::parse(method.line, &method.words);
            assert!(options.is_ok(), "{:?}: {options:?}", method.words);
        }
    }
}
