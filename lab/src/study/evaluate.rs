//! `tactus-lab judge` and `tactus-lab evaluate`: test sets, and a table of all methods on them.

use std::path::PathBuf;

use eit::{PaperSheet, Preset};
use imaging::PresetName;
use outfile::Existing;
use render::{WorkPoint, work_precision_png};
use studies::Failure;
use studies::evaluation::test_set::{self, TestSet, TestSetName};
use studies::evaluation::{Figures, figures, maps, of_frames};

use crate::args::{EvaluateOptions, TestSetOptions};
use crate::geometry;
use crate::output::print_line;

/// Makes a test set.
pub(crate) fn judge(options: &TestSetOptions) -> Result<(), Failure> {
    let Preset::PaperSheet(sheet) = geometry::preset(PresetName::PaperSheet, &options.measures)?
    else {
        unreachable!("the preset was asked for by its name");
    };
    let case = options.case.as_deref().map(geometry::read).transpose()?;
    let set = TestSet {
        set: options.set,
        noise_v: options.noise_v,
        seed: options.seed,
        count: options.count,
        spray: options.spray,
        sheet_seed: options.spray_seed,
        sheet,
        case,
    };
    let count = test_set::make(&set, &options.out, options.replacing.existing())?;
    print_line!(
        "{}: baseline and {count} frames of {}, {:e} V of noise on each reading, seed {}",
        options.out.display(),
        options.set.name(),
        options.noise_v,
        options.seed
    );
    Ok(())
}

/// Default methods.
const METHODS: [&str; 6] = [
    "one-step",
    "one-step --loss-only",
    "tv",
    "tv --loss-only",
    "linear",
    "best",
];
/// The paper's times per frame (section 5.4), ms.
const PAPER: [(&str, f64); 3] = [
    ("paper: TV", 650.0),
    ("paper: DNN", 5.0),
    ("paper: RBF", 3.0),
];

/// What the columns mean, with their best value.
const LEGEND: &str = "\
mean mm, worst  distance from the true place to the found one, mean and largest, mm (0)
corr            correlation of the map with the truth, weighed by area (1)
error           norm of the difference from the truth over the norm of the truth (0)
Dice            overlap of the parts at or above half of the largest loss (1)
SSIM            structural similarity of the rasters (1)
AR PE RES       GREIT: amplitude response, position error, resolution (the same everywhere; 0; small)
SD RNG          GREIT: shape deformation, ringing (0)
NF              noise figure of the method: noise to signal of the map over that of the readings
new             share of the frames that a trained model calls unlike its training
ms              median time of a frame, ms
A - stands where the method has no such figure.";

/// Evaluates methods and prints the table; without sets, makes the standard ones first.
pub(crate) fn evaluate(options: &EvaluateOptions) -> Result<(), Failure> {
    let made = match options.set.is_empty() {
        true => Some(Made::new(options)?),
        false => None,
    };
    let sets: Vec<PathBuf> = match &made {
        Some(made) => made.sets.clone(),
        None => options.set.clone(),
    };
    let mut methods: Vec<(String, Vec<String>)> = options
        .method
        .iter()
        .map(|text| {
            let words = text.split_whitespace().map(str::to_owned);
            let with: Vec<String> = ["--method".to_owned()].into_iter().chain(words).collect();
            (text.clone(), with)
        })
        .collect();
    for model in &options.model {
        let path = model.display().to_string();
        let name = model
            .file_stem()
            .map_or(path.clone(), |stem| stem.to_string_lossy().into_owned());
        methods.push((name, vec!["--model".to_owned(), path]));
    }
    if methods.is_empty() {
        methods = METHODS
            .iter()
            .map(|text| {
                let words = text.split(' ').map(str::to_owned);
                let with: Vec<String> = ["--method".to_owned()].into_iter().chain(words).collect();
                ((*text).to_owned(), with)
            })
            .collect();
    }
    if !options.json {
        print_line!(
            "{:<22} {:<24} {:>6} {:>8} {:>8} {:>6} {:>6} {:>6} {:>6} {:>9} {:>6} {:>6} {:>6} {:>6} {:>6} {:>5} {:>9}",
            "set",
            "method",
            "frames",
            "mean mm",
            "worst",
            "corr",
            "error",
            "Dice",
            "SSIM",
            "AR",
            "PE",
            "RES",
            "SD",
            "RNG",
            "NF",
            "new",
            "ms"
        );
    }
    let mut all = Vec::new();
    for folder in &sets {
        for (name, words) in &methods {
            let judged = maps(folder, name, words)?;
            let figures = figures(name, &judged, &of_frames(&judged)?);
            let (own_noise, novel) = (judged.noise_figure(), judged.novel_share());
            show(&figures, own_noise, novel, options.json);
            all.push(figures);
        }
    }
    if !options.json {
        print_line!("\n{LEGEND}");
    }
    if let Some(path) = &options.picture {
        let points: Vec<WorkPoint> = all
            .iter()
            .map(|figures| WorkPoint {
                panel: figures.set.clone(),
                name: figures.method.clone(),
                ms: figures.ms,
                value: figures.correlation,
                words: if figures.error_mm.is_finite() {
                    format!("{:.1} mm", figures.error_mm)
                } else {
                    String::new()
                },
            })
            .collect();
        let png = work_precision_png(
            "Accuracy against time: correlation with the truth, ms a frame",
            &points,
            &PAPER,
        )
        .map_err(|fault| Failure::of("the picture", &fault))?;
        outfile::write(path, options.replacing.existing(), &png)?;
    }
    Ok(())
}

/// Prints one line; noise figure and share of novel frames belong to the method, not to its maps.
fn show(figures: &Figures, noise_figure: Option<f64>, novel_share: Option<f64>, json: bool) {
    let [ar, pe, res, sd, rng] = figures.greit;
    if json {
        let number = |value: f64| value.is_finite().then_some(value);
        let line = serde_json::json!({
            "set": figures.set,
            "method": figures.method,
            "frames": figures.frames,
            "location_error_mm": number(figures.error_mm),
            "worst_location_error_mm": number(figures.worst_mm),
            "correlation": figures.correlation,
            "relative_error": figures.relative_error,
            "dice": figures.dice,
            "ssim": figures.ssim,
            "amplitude": ar,
            "position_error": pe,
            "resolution": res,
            "shape_deformation": sd,
            "ringing": rng,
            "noise_figure": noise_figure,
            "novel_share": novel_share,
            "frame_ms": figures.ms,
        });
        print_line!("{}", survey::printable_json(line.to_string()));
    } else {
        print_line!(
            "{:<22} {:<24} {:>6} {:>8.2} {:>8.2} {:>6.3} {:>6.3} {:>6.3} {:>6.3} {:>9.2} {:>6.3} {:>6.3} {:>6.3} {:>6.3} {:>6} {:>5} {:>9.3}",
            figures.set,
            figures.method,
            figures.frames,
            figures.error_mm,
            figures.worst_mm,
            figures.correlation,
            figures.relative_error,
            figures.dice,
            figures.ssim,
            ar,
            pe,
            res,
            sd,
            rng,
            noise_figure.map_or("-".to_owned(), |figure| format!("{figure:.2}")),
            novel_share.map_or("-".to_owned(), |share| format!("{share:.2}")),
            figures.ms
        );
    }
}

/// Standard sets in a temporary folder, which is removed afterwards.
struct Made {
    folder: PathBuf,
    sets: Vec<PathBuf>,
}

impl Made {
    fn new(options: &EvaluateOptions) -> Result<Self, Failure> {
        let folder = std::env::temp_dir().join(format!("tactus-evaluate-{}", std::process::id()));
        let mut made = Self {
            folder: folder.clone(),
            sets: Vec::new(),
        };
        for (set, noise_v, name) in [
            (TestSetName::Presses10, 2e-6, "presses-10"),
            (TestSetName::Presses30, 2e-6, "presses-30"),
            (TestSetName::Polygons, 2e-6, "polygons"),
            (TestSetName::Polygons, 396e-6, "polygons-396uV"),
        ] {
            let out = folder.join(name);
            let set = TestSet {
                set,
                noise_v,
                seed: options.seed,
                count: options.count,
                spray: None,
                sheet_seed: None,
                sheet: PaperSheet::default(),
                case: None,
            };
            test_set::make(&set, &out, Existing::Refuse)?;
            made.sets.push(out);
        }
        Ok(made)
    }
}

impl Drop for Made {
    fn drop(&mut self) {
        // a folder that cannot be removed is left to the system's cleaning of temporary files
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
