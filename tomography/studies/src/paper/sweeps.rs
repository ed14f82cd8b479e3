//! Experiments that vary one parameter: the size of a load, alpha, the spread of Eq. 13, the sheet and its electrodes.

use super::evaluation::{Artifact, Evaluations, Job, Source, TEST_SET};
use super::experiments::{FIGURES_AT, Set, test_set};
use super::plan::{DEEP, Method, Plan, RBF, RBF_FILE, TV};
use crate::evaluation::{OfFrame, mean_and_deviation};
use crate::failure::Failure;
use crate::judging_seed;

/// Results for one varied parameter.
pub(super) struct Sweep {
    /// Name of the chart's files.
    pub(super) file: &'static str,
    pub(super) title: &'static str,
    pub(super) across: &'static str,
    pub(super) up: &'static str,
    /// A vertical line with a label.
    pub(super) mark: Option<(f64, &'static str)>,
    pub(super) log: bool,
    pub(super) points: Vec<Point>,
    /// Caption, which states what the chart shows and what it does not prove.
    pub(super) words: &'static str,
}

pub(super) struct Point {
    pub(super) curve: String,
    pub(super) across: f64,
    pub(super) up: f64,
    /// Standard deviation over the frames, or the standard error of the mean.
    pub(super) spread: f64,
}

impl Sweep {
    pub(super) fn described(&self) -> serde_json::Value {
        serde_json::json!({
            "sweep": self.title,
            "across": self.across,
            "up": self.up,
            "points": self.points.iter().map(|point| serde_json::json!({
                "curve": point.curve,
                "across": point.across,
                "up": point.up,
                "standard_deviation": point.spread,
            })).collect::<Vec<_>>(),
        })
    }
}

pub(super) fn run(
    plan: &Plan,
    evaluations: &Evaluations,
    methods: &[Method],
) -> Result<Vec<Sweep>, Failure> {
    let mut sweeps = vec![alphas(plan, evaluations)?];
    sweeps.extend(sizes(plan, evaluations, methods)?);
    sweeps.push(spreads(plan, evaluations)?);
    sweeps.extend(sheets(plan, evaluations)?);
    Ok(sweeps)
}

/// Figures of merit of one method for each frame of a set.
fn figures_of(
    evaluations: &Evaluations,
    method: &str,
    source: &Source,
    set: &Artifact,
) -> Result<Vec<OfFrame>, Failure> {
    let evaluated = evaluations.of(Job {
        method: method.to_owned(),
        source: source.clone(),
        set: set.clone(),
        maps: false,
    })?;
    Ok(evaluated.of_frames)
}

/// Loads of 20 to 140 mm, beyond the largest in training.
fn sizes(
    plan: &Plan,
    evaluations: &Evaluations,
    methods: &[Method],
) -> Result<Vec<Sweep>, Failure> {
    let set = Artifact {
        name: "sets/sizes".to_owned(),
        command: format!("judge --set sizes --seed {}", judging_seed(plan.seed, 0)),
    };
    let (mut errors, mut dice) = (Vec::new(), Vec::new());
    for method in methods {
        let shown = [
            TV,
            DEEP,
            RBF,
            "TV, losses only",
            "one-step, losses only",
            "linear, trained",
        ];
        if !shown.contains(&method.name) {
            continue;
        }
        let frames = figures_of(evaluations, method.name, &method.source, &set)?;
        // four of each size, in order
        for (k, four) in frames.chunks(4).enumerate() {
            let across = 20.0 * (k + 1) as f64;
            let of = |values: Vec<f64>| (!values.is_empty()).then(|| mean_and_deviation(&values));
            let found = of(four.iter().filter_map(|frame| frame.error_mm).collect());
            for (points, value) in [
                (&mut errors, found),
                (&mut dice, of(four.iter().map(|frame| frame.dice).collect())),
            ] {
                let Some((up, spread)) = value else { continue };
                points.push(Point {
                    curve: method.name.to_owned(),
                    across,
                    up,
                    spread,
                });
            }
        }
    }
    let sweep = |file, up, points, words| Sweep {
        file,
        title: "Size of the load, half the conductance lost, 2 uV",
        across: "diameter of a disc, mm",
        up,
        mark: Some((140.0, "training ends (radius)")),
        log: false,
        points,
        words,
    };
    Ok(vec![
        sweep(
            "size-location",
            "location error, mm",
            errors,
            "How far the found place lies from the centre of a disc, by its size. Training has polygons within circles of up \
             to 70 mm radius (our reading of R_p), few of which fill their circle; four places a size say little about one place.",
        ),
        sweep(
            "size-dice",
            "Dice",
            dice,
            "How well the half-maximum region covers the disc. The loss is the same everywhere under it: nothing is said of \
             loads with soft edges.",
        ),
    ])
}

/// alpha of Eq. 4, and true total variation for comparison.
fn alphas(plan: &Plan, evaluations: &Evaluations) -> Result<Sweep, Failure> {
    let mut points = Vec::new();
    // true total variation does not depend on this alpha, so it is a horizontal line
    let power = |exponent: Option<&i32>| exponent.map(|&exponent| 10.0_f64.powi(exponent));
    let ends: Vec<f64> = [plan.alphas.first(), plan.alphas.last()]
        .into_iter()
        .filter_map(power)
        .collect();
    for noise_uv in plan.noises.iter().copied().filter(|uv| *uv <= 20.0) {
        let set = test_set(plan, Set::even(1, noise_uv));
        let mut error = |curve: String, across: &[f64], options: String| -> Result<(), Failure> {
            let source = Source::Options(options);
            let frames = figures_of(evaluations, &curve, &source, &set)?;
            let errors: Vec<f64> = frames.iter().filter_map(|frame| frame.error_mm).collect();
            if errors.is_empty() {
                return Ok(());
            }
            let (up, spread) = mean_and_deviation(&errors);
            points.extend(across.iter().map(|across| Point {
                curve: curve.clone(),
                across: *across,
                up,
                spread: spread / (errors.len() as f64).sqrt(),
            }));
            Ok(())
        };
        for &exponent in plan.alphas {
            let curve = format!("as printed, {noise_uv} uV");
            let across = [10.0_f64.powi(exponent)];
            let options = format!("--method tv-paper --lambda 1e{exponent}");
            error(curve, &across, options)?;
        }
        if noise_uv == FIGURES_AT {
            let curve = format!("true TV, {noise_uv} uV");
            error(curve, &ends, "--method tv".to_owned())?;
        }
    }
    Ok(Sweep {
        file: "alpha",
        title: "TV as printed (Eq. 4 and 5): alpha, Test #1",
        across: "alpha",
        up: "location error, mm",
        mark: Some((1e-6, "the paper's")),
        log: true,
        points,
        words: "One quadratic step with changes over the largest reading and over the unloaded conductance, which is our reading: \
                the paper's alpha of 1e-6 does not say what it multiplies, and another scaling moves the curves sideways. Bars are \
                standard errors over the 16 places; true total variation takes its strength from the noise.",
    })
}

/// The spread of Eq. 13 times a factor, on held-out cases of Algorithm 1.
fn spreads(plan: &Plan, evaluations: &Evaluations) -> Result<Sweep, Failure> {
    let seed = judging_seed(plan.seed, 0);
    let count = if plan.best { "100" } else { "10" };
    let mut points = Vec::new();
    for noise in ["2e-6", "396e-6"] {
        let set = Artifact {
            name: format!("sets/polygons-{noise}"),
            command: format!(
                "judge --set polygons --noise-v {noise} --count {count} --seed {seed}"
            ),
        };
        for &times in plan.spreads {
            let rbf = plan.rbf("paper");
            // the network of factor 1 is the paper's, which exists already
            let (name, command) = match times == 1.0 {
                true => (RBF_FILE.to_owned(), rbf),
                false => (
                    format!("models/rbf-spread-{times}.safetensors"),
                    format!("{rbf} --spread-times {times}"),
                ),
            };
            let source = Source::Model(Artifact { name, command });
            let frames = figures_of(evaluations, &format!("{noise} V"), &source, &set)?;
            let values: Vec<f64> = frames.iter().map(|frame| frame.correlation).collect();
            let (up, spread) = mean_and_deviation(&values);
            points.push(Point {
                curve: format!("noise {} uV", if noise == "2e-6" { 2 } else { 396 }),
                across: times,
                up,
                spread: spread / (values.len() as f64).sqrt(),
            });
        }
    }
    Ok(Sweep {
        file: "spread",
        title: "RBF network: times Eq. 13's spread, on held-out polygons",
        across: "spread over that of Eq. 13",
        up: "correlation with the truth",
        mark: Some((1.0, "Eq. 13")),
        log: true,
        points,
        words: "Whether the spread of Eq. 13 is the best one, on cases drawn as the training's are but on a finer mesh; bars are \
                standard errors. Centres and training set are the same for all: another draw of either is not judged.",
    })
}

/// Other sheets and electrodes, with presses of 10 mm.
fn sheets(plan: &Plan, evaluations: &Evaluations) -> Result<Vec<Sweep>, Failure> {
    let seed = judging_seed(plan.seed, 0);
    let count = if plan.best { "16" } else { "4" };
    let (mut electrodes, mut sizes) = (Vec::new(), Vec::new());
    for &(scale, along_width, along_height) in plan.sheets {
        let ring = 2 * (along_width + along_height);
        let measures = [
            format!("width_mm={}", 214.0 * scale),
            format!("height_mm={}", 230.0 * scale),
            format!("region_half_width_mm={}", 107.0 * scale - 18.24),
            format!("region_half_height_mm={}", 115.0 * scale - 19.6),
            format!("electrodes_per_width={along_width}"),
            format!("electrodes_per_height={along_height}"),
        ];
        let mut command = format!("judge --set presses-10 --count {count} --seed {seed}");
        for measure in &measures {
            command += &format!(" --measure {measure}");
        }
        let name = format!("sets/sheet-{scale}-{ring}");
        let set = Artifact { name, command };
        let trained = Artifact {
            name: format!("models/rbf-sheet-{scale}-{ring}.safetensors"),
            command: format!("{} --case {TEST_SET}", plan.rbf("paper")),
        };
        for (method, source) in [
            (RBF, Source::Model(trained)),
            (
                "one-step, losses only",
                Source::Options("--method one-step --loss-only".to_owned()),
            ),
        ] {
            let frames = figures_of(evaluations, method, &source, &set)?;
            let errors: Vec<f64> = frames.iter().filter_map(|frame| frame.error_mm).collect();
            if errors.is_empty() {
                continue;
            }
            let (up, spread) = mean_and_deviation(&errors);
            let point = |across| Point {
                curve: method.to_owned(),
                across,
                up,
                spread,
            };
            if scale == 1.0 {
                electrodes.push(point(f64::from(ring as u32)));
            }
            if ring == 26 {
                sizes.push(point(214.0 * scale));
            }
        }
    }
    let sweep = |file, title, across, points| Sweep {
        file,
        title,
        across,
        up: "location error, mm",
        mark: None,
        log: false,
        points,
        words: "Presses of 10 mm, 2 uV of noise at 1 mA; an RBF network trained for each sheet. Bars are standard deviations over \
                the presses. Contact and sheet resistance stay as they are, electrodes keep their size.",
    };
    let mut found = vec![sweep(
        "electrodes",
        "Electrodes on the paper's sheet",
        "electrodes",
        electrodes,
    )];
    if plan
        .sheets
        .iter()
        .filter(|sheet| 2 * (sheet.1 + sheet.2) == 26)
        .count()
        > 1
    {
        found.push(sweep(
            "sheets",
            "Size of a sheet with 26 electrodes",
            "width, mm",
            sizes,
        ));
    }
    Ok(found)
}
