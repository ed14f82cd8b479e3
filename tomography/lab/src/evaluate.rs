//! `tactus-lab evaluate`: every method on judging data, in one table.
//!
//! A judged folder is what `tactus-lab judge` makes: frames from a finer, different mesh, drawn from other random streams
//! than any training. The methods get the folder's case and frames; the truth is opened here alone.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Parser;
use eit::Case;
use eit::merit::{Image, likeness};
use picture::{WorkPoint, work_precision_png};
use rayon::prelude::*;
use survey::{Map, MapUnit};

use crate::args::{
    Arguments, Command, EvaluateOptions, JudgeOptions, JudgeSet, ReconstructOptions,
};
use crate::choice::{self, Choice};
use crate::failure::Failure;
use crate::recording::Recording;
use crate::solve::median;
use crate::{geometry, judge, progress};

/// Pixels along the longer side of the raster for SSIM and GREIT's figures.
const PIXELS: usize = 64;
/// What is compared where nothing is said.
const METHODS: [&str; 6] = [
    "one-step",
    "one-step --loss-only",
    "tv",
    "tv --loss-only",
    "linear",
    "best",
];
/// The paper's times a frame (section 5.4), ms.
const PAPER: [(&str, f64); 3] = [("paper: TV", 650.0), ("DNN", 5.0), ("RBF", 3.0)];

/// Means over the frames of one set by one method.
struct Figures {
    set: String,
    method: String,
    frames: usize,
    error_mm: f64,
    worst_mm: f64,
    correlation: f64,
    relative_error: f64,
    dice: f64,
    ssim: f64,
    greit: [f64; 5],
    ms: f64,
}

/// Compares and prints; makes the sets first where none is given.
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
        println!(
            "{:<22} {:<24} {:>6} {:>8} {:>8} {:>6} {:>6} {:>6} {:>6} {:>9} {:>6} {:>6} {:>6} {:>6} {:>9}",
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
            "ms"
        );
    }
    let mut all = Vec::new();
    for folder in &sets {
        for (name, words) in &methods {
            let figures = judged(folder, name, words)?;
            show(&figures, options.json);
            all.push(figures);
        }
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
        std::fs::write(path, png)
            .map_err(|cause| Failure::of(&format!("cannot write {}", path.display()), &cause))?;
    }
    Ok(())
}

fn show(figures: &Figures, json: bool) {
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
            "frame_ms": figures.ms,
        });
        println!("{line}");
    } else {
        println!(
            "{:<22} {:<24} {:>6} {:>8.2} {:>8.2} {:>6.3} {:>6.3} {:>6.3} {:>6.3} {:>9.2} {:>6.3} {:>6.3} {:>6.3} {:>6.3} {:>9.3}",
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
            figures.ms
        );
    }
}

/// Standard sets in a folder that goes when they have been judged.
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
            (JudgeSet::Presses10, 2e-6, "presses-10"),
            (JudgeSet::Presses30, 2e-6, "presses-30"),
            (JudgeSet::Polygons, 2e-6, "polygons"),
            (JudgeSet::Polygons, 396e-6, "polygons-396uV"),
        ] {
            let out = folder.join(name);
            judge::make(&JudgeOptions {
                set,
                noise_v,
                seed: options.seed,
                count: options.count,
                case: None,
                out: out.clone(),
            })?;
            made.sets.push(out);
        }
        Ok(made)
    }
}

impl Drop for Made {
    fn drop(&mut self) {
        // what is left in the folder of temporary files is the system's to clear
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Rows of numbers; a header is left out.
fn rows(path: &Path) -> Result<Vec<Vec<f64>>, Failure> {
    let text = std::fs::read_to_string(path)
        .map_err(|cause| Failure::of(&format!("{}", path.display()), &cause))?;
    Ok(text
        .lines()
        .filter_map(|line| line.split(',').map(|field| field.parse().ok()).collect())
        .collect())
}

/// One method on one set.
fn judged(folder: &Path, name: &str, words: &[String]) -> Result<Figures, Failure> {
    let case = geometry::read(folder)?;
    let said = judge::said(folder)?;
    let frames = folder.join("frames.csv");
    let mut line: Vec<String> = ["tactus-lab", "reconstruct", "--out", "-", "--case"]
        .map(str::to_owned)
        .to_vec();
    line.push(folder.display().to_string());
    line.push("--frames".to_owned());
    line.push(frames.display().to_string());
    line.extend(words.iter().cloned());
    if words[0] == "--method" {
        line.extend(["--noise-v".to_owned(), said.noise_v.to_string()]);
    }
    let parsed = Arguments::try_parse_from(&line)
        .map_err(|fault| Failure::usage(format!("method '{name}': {fault}")))?;
    let Command::Reconstruct(options) = parsed.command else {
        return Err(Failure::usage(format!("method '{name}' is none")));
    };
    let options: ReconstructOptions = options;
    let recording = Recording::read(&frames, "first:1", case.protocol.len(), false)?;
    let choice: Choice = choice::prepare(&options, &case, &recording)?;
    let truths = rows(&folder.join("truth.csv"))?;
    let presses: Vec<Option<[f64; 2]>> = {
        let path = folder.join("presses.csv");
        let known = if path.exists() {
            rows(&path)?
        } else {
            Vec::new()
        };
        (0..truths.len())
            .map(|k| known.get(k).map(|row| [row[1], row[2]]))
            .collect()
    };
    let bar = progress::bar(truths.len(), "frames");
    let one = |k: usize| -> Result<(Map, f64), Failure> {
        let (frame_name, frame) = &recording.frames[k + 1];
        let start = Instant::now();
        let map = choice
            .reconstructor
            .reconstruct(&recording.baseline, frame)
            .map_err(|fault| Failure::of(&format!("{name}, frame '{frame_name}'"), &fault))?;
        bar.inc(1);
        Ok((map, start.elapsed().as_secs_f64() * 1e3))
    };
    let maps: Vec<(Map, f64)> = if choice.slow {
        (0..truths.len())
            .into_par_iter()
            .map(one)
            .collect::<Result<_, Failure>>()?
    } else {
        (0..truths.len()).map(one).collect::<Result<_, Failure>>()?
    };
    bar.finish_and_clear();
    let raster = Raster::new(&case);
    let (centroids, areas) = (case.mesh.region_centroids(), case.mesh.region_areas());
    let mut times = Vec::new();
    let mut errors = Vec::new();
    let mut sums = [0.0; 9];
    for (k, (map, time)) in maps.into_iter().enumerate() {
        times.push(time);
        let truth = Map {
            mesh_hash: map.mesh_hash.clone(),
            values: truths[k].clone(),
            unit: MapUnit::RelativeConductance,
            method: "truth".to_owned(),
            masked: 0,
        };
        let like = likeness(&map.values, &truth.values, &areas);
        let place = presses[k].or_else(|| truth.found(&centroids, &areas));
        if let (Some(_), Some(at), Some(found)) = (presses[k], place, map.found(&centroids, &areas))
        {
            errors.push(1e3 * (found[0] - at[0]).hypot(found[1] - at[1]));
        }
        let image = raster.image(&map.values)?;
        let wanted = raster.image(&truth.values)?;
        let greit = place.and_then(|at| image.greit(raster.place(at)).ok());
        let ssim = image.ssim(&wanted, 1.0).unwrap_or(0.0);
        let greit = greit.map_or([0.0; 5], |g| {
            [
                g.amplitude,
                g.position_error,
                g.resolution,
                g.shape_deformation,
                g.ringing,
            ]
        });
        for (sum, value) in sums.iter_mut().zip(
            [like.correlation, like.relative_error, like.dice, ssim]
                .into_iter()
                .chain(greit),
        ) {
            *sum += value;
        }
    }
    let count = truths.len() as f64;
    let [
        correlation,
        relative_error,
        dice,
        ssim,
        ar,
        pe,
        res,
        sd,
        rng,
    ] = sums.map(|sum| sum / count);
    Ok(Figures {
        set: said.name,
        method: name.to_owned(),
        frames: truths.len(),
        error_mm: errors.iter().sum::<f64>() / errors.len() as f64,
        worst_mm: errors.iter().copied().reduce(f64::max).unwrap_or(f64::NAN),
        correlation,
        relative_error,
        dice,
        ssim,
        greit: [ar, pe, res, sd, rng],
        ms: median(&mut times),
    })
}

/// Pixels over the sheet's bounding box; inside is the sheet, where a map has no value it is 0.
struct Raster {
    rows: usize,
    columns: usize,
    low: [f64; 2],
    high: [f64; 2],
    /// `None` outside; the index in the region, or none where the sheet is bare.
    pixels: Vec<Option<Option<usize>>>,
}

impl Raster {
    fn new(case: &Case) -> Self {
        let mesh = &case.mesh;
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for node in mesh.nodes() {
            for axis in 0..2 {
                low[axis] = low[axis].min(node[axis]);
                high[axis] = high[axis].max(node[axis]);
            }
        }
        let longer = (high[0] - low[0]).max(high[1] - low[1]);
        let count = |axis: usize| {
            ((PIXELS as f64 * (high[axis] - low[axis]) / longer).round() as usize).max(2)
        };
        // x along the first index
        let (rows, columns) = (count(0), count(1));
        let mut unknown = vec![None; mesh.triangles().len()];
        for (k, &t) in mesh.region().iter().enumerate() {
            unknown[t] = Some(k);
        }
        let at = |k: usize, n: usize, axis: usize| {
            low[axis] + (high[axis] - low[axis]) * k as f64 / (n - 1) as f64
        };
        let mut pixels = vec![None; rows * columns];
        for (t, unknown) in unknown.iter().enumerate() {
            let c = mesh.corners(t);
            let range = |axis: usize, n: usize| {
                let step = (high[axis] - low[axis]) / (n - 1) as f64;
                let from = c.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
                let to = c.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
                let first = ((from - low[axis]) / step).floor().max(0.0) as usize;
                let last = ((to - low[axis]) / step).ceil() as usize;
                first..=last.min(n - 1)
            };
            for i in range(0, rows) {
                for j in range(1, columns) {
                    let p = [at(i, rows, 0), at(j, columns, 1)];
                    let holds = (0..3).all(|k| {
                        let (a, b) = (c[k], c[(k + 1) % 3]);
                        (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) >= -1e-15
                    });
                    if holds {
                        pixels[i * columns + j] = Some(*unknown);
                    }
                }
            }
        }
        Self {
            rows,
            columns,
            low,
            high,
            pixels,
        }
    }

    /// Losses positive.
    fn image(&self, map: &[f64]) -> Result<Image, Failure> {
        let values: Vec<Vec<f64>> = (0..self.rows)
            .map(|i| {
                (0..self.columns)
                    .map(|j| match self.pixels[i * self.columns + j] {
                        None => f64::NAN,
                        Some(None) => 0.0,
                        Some(Some(unknown)) => -map[unknown],
                    })
                    .collect()
            })
            .collect();
        Image::new(&values).map_err(|fault| Failure::of("the raster", &fault))
    }

    /// A place on the sheet (m) in the raster's [-1, 1].
    fn place(&self, at: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| {
            2.0 * (at[axis] - self.low[axis]) / (self.high[axis] - self.low[axis]) - 1.0
        })
    }
}
