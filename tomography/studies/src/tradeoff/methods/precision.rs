//! Diagram 5: width and number format of a deep network.

use std::path::Path;
use std::time::Instant;

use eit::model;

use crate::artifact_cache::ArtifactCache;
use crate::evaluation::{average, maps, of_frames, quantile};
use crate::failure::{Attempt, Failure};
use crate::tradeoff::Effort;
use crate::tradeoff::panel::{Panel, Point};
use crate::tradeoff::trained::{Trained, judged_sets};

pub(crate) fn panel(effort: &Effort, place: &ArtifactCache<'_>) -> Result<Panel, Failure> {
    let sets = judged_sets(effort, place, "polygons", effort.of(4, 8))?;
    let mut points = Vec::new();
    for &width in widths(effort) {
        let mut reference: Option<Vec<Vec<f64>>> = None;
        for precision in ["f32", "f16", "int8"] {
            // the trainings differ in the stored format only: equal seeds give equal weights before rounding
            let trained = deep(effort, place, width, precision)?;
            let load_s = loading(&trained.file)?;
            let bytes = std::fs::metadata(&trained.file)
                .map_err(|cause| Failure::of(&trained.file.display().to_string(), &cause))?
                .len() as f64;
            let memory = place.resident_bytes(&trained.file);
            let memory = memory.map_or(f64::NAN, |bytes| bytes as f64);
            let (mut errors, mut times, mut all) = (Vec::new(), Vec::new(), Vec::new());
            for set in &sets {
                let judged = maps(set, precision, &trained.words())?;
                let frames = of_frames(&judged)?;
                errors.push(average(frames.iter().map(|frame| 1.0 - frame.correlation)));
                times.extend(judged.frames.iter().map(|frame| 1e-3 * frame.ms));
                all.extend(judged.frames.into_iter().map(|frame| frame.map.values));
            }
            // largest difference relative to the largest value of all maps
            let away = reference.as_ref().map_or(0.0, |reference: &Vec<Vec<f64>>| {
                let pairs = reference.iter().flatten().zip(all.iter().flatten());
                let top = reference
                    .iter()
                    .flatten()
                    .fold(0.0_f64, |top, v| top.max(v.abs()));
                pairs.fold(0.0_f64, |worst, (a, b)| worst.max((a - b).abs())) / top
            });
            let p99 = quantile(&mut times, 0.99);
            points.push(
                Point::new(
                    format!("width {width}"),
                    precision,
                    quantile(&mut times, 0.5),
                    &errors,
                )
                .with("p99, s", p99)
                .with("file, bytes", bytes)
                .with("memory to load it, bytes", memory)
                .with("loading, s", load_s)
                .with("worst difference from f32, of the largest value", away),
            );
            reference.get_or_insert(all);
        }
    }
    Ok(Panel {
        panel: "precision".to_owned(),
        title: "Precision and size of a deep network".to_owned(),
        across: "a frame, s".to_owned(),
        up: "1 - correlation".to_owned(),
        shows: format!(
            "Deep networks of several widths, their weights kept in f32, f16 and int8, on cases of Algorithm 1 kept back; the \
                          table has bytes, peak memory and time of loading, and how far a map moves from that of f32. Trained on {} cases for {} epochs.",
            cases(effort),
            epochs(effort)
        ),
        not_proved: "A longer training may use more of the precision than this one does."
            .to_owned(),
        not_built: vec!["weights in f64: no model file has them".to_owned()],
        costs: true,
        points,
    })
}

/// Number of training cases in diagrams 3 and 5.
pub(crate) fn cases(effort: &Effort) -> &'static str {
    effort.of("2000", "6000")
}

fn epochs(effort: &Effort) -> &'static str {
    effort.of("1", "6")
}

/// Widths of the deep networks in diagrams 3 and 5.
pub(crate) fn widths(effort: &Effort) -> &'static [usize] {
    effort.of(&[32, 96], &[64, 256, 1024])
}

/// The deep network of this width, with weights in this format.
pub(crate) fn deep(
    effort: &Effort,
    place: &ArtifactCache<'_>,
    width: usize,
    precision: &str,
) -> Result<Trained, Failure> {
    let (cases, epochs, seed) = (cases(effort), epochs(effort), effort.seed);
    let arguments = format!(
        "dnn --profile matched --cases {cases} --epochs {epochs} --set width={width} --repeats 2 --seed {seed} \
         --precision {precision}"
    );
    Trained::new(place, &arguments)
}

/// Median time to read and check a model file, s.
fn loading(file: &Path) -> Result<f64, Failure> {
    let mut times = Vec::new();
    for _ in 0..5 {
        let start = Instant::now();
        let model = model::load(file).attempt("a trained model")?;
        let reconstructor = model.into_reconstructor();
        times.push(start.elapsed().as_secs_f64());
        drop(reconstructor);
    }
    Ok(quantile(&mut times, 0.5))
}
