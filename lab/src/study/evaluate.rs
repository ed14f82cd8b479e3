//! `tactus-lab judge` and `tactus-lab evaluate`: makes test sets, and compares all methods on them in a table.

use eit::Preset;
use imaging::PresetName;
use render::{WorkPoint, work_precision_png};
use shards::{Division, Study};
use studies::Failure;
use studies::evaluation::test_set::{self, TestSet};
use studies::evaluation::{Figures, figures, maps, of_frames};

use super::chosen::{Method, Sets, methods, settings};
use super::division::{divided, report_of};
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
    let (division, stop) = divided(&options.shards)?;
    let frames = report_of(test_set::frames(&set, &division, &stop)?);
    // without a folder the outcome is a shard or a list of missing shards
    let (Some(frames), Some(folder)) = (frames, &options.out) else {
        return Ok(());
    };
    let count = frames.write(folder, options.replacing.existing())?;
    print_line!(
        "{}: baseline and {count} frames of {}, {:e} V of noise on each reading, seed {}",
        folder.display(),
        options.set.name(),
        options.noise_v,
        options.seed
    );
    Ok(())
}

/// The paper's times per frame (section 5.4), ms.
const PAPER: [(&str, f64); 3] = [
    ("paper: TV", 650.0),
    ("paper: DNN", 5.0),
    ("paper: RBF", 3.0),
];

/// Explanation of the columns, with the best value of each.
const LEGEND: &str = "\
mean mm, worst  distance from the true place to the found one, mean and largest, mm (0)
corr            correlation of the map with the truth, weighted by area (1)
error           norm of the difference from the truth over the norm of the truth, of frames with a load (0)
Dice            overlap of the parts at or above half of the largest loss (1)
SSIM            structural similarity of the rasters (1)
AR PE RES       GREIT: amplitude response, position error, resolution (the same everywhere; 0; small)
SD RNG          GREIT: shape deformation, ringing (0)
NF              noise figure of the method: noise to signal of the map over that of the readings
new             share of the frames that a trained model reports as unlike its training data
ms              median time of a frame, ms
-               no such figure for this set or method";

/// Figures of one method on one set.
#[derive(serde::Serialize, serde::Deserialize)]
struct Line {
    figures: Figures,
    noise_figure: Option<f64>,
    novel_share: Option<f64>,
}

/// Evaluates methods and prints the table; without sets, makes the standard sets first. In shards, an item of work is
/// one method on one set.
pub(crate) fn evaluate(options: &EvaluateOptions) -> Result<(), Failure> {
    let methods = methods(options);
    let sets = Sets::of(options);
    if options.picture.is_some() && !sets.have_load() {
        return Err(Failure::usage(
            "--picture draws the correlation with the truth, and no frame of the sets has a load",
        ));
    }
    let (division, stop) = divided(&options.shards)?;
    let pairs: Vec<(usize, &Method)> = (0..sets.len())
        .flat_map(|set| methods.iter().map(move |method| (set, method)))
        .collect();
    let settings = match division {
        Division::Whole => serde_json::Value::Null,
        Division::Shard(..) | Division::Missing(..) | Division::Merge(..) => {
            settings(options, &sets)?
        }
    };
    let study = Study {
        name: "evaluate",
        settings,
        items: pairs
            .iter()
            .map(|(set, method)| format!("{}: {}", sets.name(*set), method.name))
            .collect(),
    };
    let whole = division == Division::Whole;
    if whole && !options.json {
        print_heading();
    }
    let outcome = study.perform(&division, &stop, &mut |item| {
        let (set, Method { name, words }) = pairs[item];
        let judged = maps(&sets.folder(set)?, name, words)?;
        let line = Line {
            figures: figures(name, &judged, &of_frames(&judged)?),
            noise_figure: judged.noise_figure(),
            novel_share: judged.novel_share(),
        };
        if whole {
            show(&line, options.json);
        }
        Ok::<_, Failure>(line)
    })?;
    let Some(all) = report_of(outcome) else {
        return Ok(());
    };
    if !whole {
        if !options.json {
            print_heading();
        }
        all.iter().for_each(|line| show(line, options.json));
    }
    if !options.json {
        print_line!("\n{LEGEND}");
    }
    if let Some(path) = &options.picture {
        let points: Vec<WorkPoint> = all
            .iter()
            // a set without a load has no correlation
            .filter(|Line { figures, .. }| figures.correlation.is_finite())
            .map(|Line { figures, .. }| WorkPoint {
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

fn print_heading() {
    print_line!(
        "set                    method                   frames  mean mm    worst   corr  error   Dice   SSIM        AR     PE    RES     SD    RNG     NF   new        ms"
    );
}

/// Prints one line. Noise figure and share of novel frames are properties of the method, not of its maps.
fn show(line: &Line, json: bool) {
    let Line {
        figures,
        noise_figure,
        novel_share,
    } = line;
    let [ar, pe, res, sd, rng] = figures.greit;
    let number = |value: f64| value.is_finite().then_some(value);
    if json {
        let line = serde_json::json!({
            "set": figures.set,
            "method": figures.method,
            "frames": figures.frames,
            "location_error_mm": number(figures.error_mm),
            "worst_location_error_mm": number(figures.worst_mm),
            "correlation": number(figures.correlation),
            "relative_error": number(figures.relative_error),
            "dice": number(figures.dice),
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
        let cell = |value: Option<f64>, decimals: usize| {
            value.map_or("-".to_owned(), |value| format!("{value:.decimals$}"))
        };
        print_line!(
            "{:<22} {:<24} {:>6} {:>8} {:>8} {:>6} {:>6} {:>6} {:>6.3} {:>9} {:>6} {:>6} {:>6} {:>6} {:>6} {:>5} {:>9.3}",
            figures.set,
            figures.method,
            figures.frames,
            cell(number(figures.error_mm), 2),
            cell(number(figures.worst_mm), 2),
            cell(number(figures.correlation), 3),
            cell(number(figures.relative_error), 3),
            cell(number(figures.dice), 3),
            figures.ssim,
            cell(number(ar), 2),
            cell(number(pe), 3),
            cell(number(res), 3),
            cell(number(sd), 3),
            cell(number(rng), 3),
            cell(*noise_figure, 2),
            cell(*novel_share, 2),
            figures.ms
        );
    }
}
