//! `tactus-lab reconstruct`: maps of recorded frames.

use std::path::Path;
use std::time::Instant;

use eit::{Case, Pressure, matrix_text};
use nalgebra::DMatrix;
use rayon::prelude::*;
use survey::{Map, Reading, error_chain, printable};

use imaging::TrackedFrame;
use imaging::recorded::{
    DeviationSummary, FRAMES_HEADING, FrameTable, MapCompanions, MapOfRow, MapRow, TableOptions,
    WithoutMap, triangles_text,
};
use outfile::OutFile;
use studies::evaluation::median;
use studies::{Failure, progress};

use super::calibrate;
use crate::args::ReconstructOptions;
use crate::geometry;
use crate::output::print_line;

/// Writes a map as a row for each frame. Frames without a map are named; the command fails after the others are
/// written.
pub(crate) fn reconstruct(options: &ReconstructOptions) -> Result<(), Failure> {
    let case = geometry::with_depth(geometry::read(&options.case)?, &options.depth)?;
    // no companion file can be written next to a device or a pipe
    let beside = (!outfile::is_stream(&options.out)).then(|| MapCompanions::of(&options.out));
    if options.sd && beside.is_none() {
        return Err(Failure::usage(
            "--sd writes a file next to the maps; --out must be a file",
        ));
    }
    if let Some(beside) = &beside {
        outfile::check(&beside.frames, options.replacing.existing())?;
        outfile::check(&beside.triangles, options.replacing.existing())?;
        outfile::check(&beside.deviations, options.replacing.existing())?;
    }
    if options.tracked.tracked == Some(true) && options.method.removes_drift() {
        return Err(Failure::usage(
            "--drift frame is for frames whose baseline is not tracked; omit it or --tracked",
        ));
    }
    // the model of drift is for readings at one current
    let of_drift = [
        ("--tracked", options.tracked.tracked == Some(true)),
        ("--drift frame", options.method.removes_drift()),
        ("--sd", options.sd),
    ];
    if let Some((option, _)) = of_drift.into_iter().find(|(_, given)| *given) {
        let attempt = format!("{option} is for readings at one current");
        geometry::one_current(&options.case, &case, &attempt)?;
    }
    let recording = frames(options, case.protocol.len())?;
    let calibration = options
        .calibration
        .as_deref()
        .map(calibrate::read)
        .transpose()?;
    let model = options.method.prepare(&case, &recording)?;
    for note in &model.notes {
        eprintln!("tactus-lab: {}", printable(note));
    }
    let followed = follow(options, &case, &recording)?;
    let (centroids, areas) = (case.mesh.region_centroids(), case.mesh.region_areas());
    let noise = options.method.map_noise(&model, &recording);
    let bar = progress::bar(recording.frames.len(), "frames");
    let one = |(index, (name, frame)): (usize, &(String, Vec<Reading>))| {
        let start = Instant::now();
        let (baseline, readings) = match &followed {
            Some(followed) => (&followed[index].baseline, &followed[index].readings),
            None => (&recording.unloaded.readings, frame),
        };
        let map = model.reconstruct(baseline, readings);
        let time = start.elapsed().as_secs_f64() * 1e3;
        bar.inc(1);
        let map = match map {
            Ok(map) => map,
            Err(why) => return Ok(Err(error_chain(&why))),
        };
        let pressure = match &calibration {
            Some(calibration) => match calibration.pressure(&case.mesh, &map) {
                Ok(pressure) => Some(pressure),
                Err(why) => return Ok(Err(error_chain(&why))),
            },
            None => None,
        };
        let deviation = match options.sd {
            true => Some(match model.deviation(baseline, readings) {
                Ok(Some(found)) => found.values(),
                Ok(None) => {
                    return Err(Failure::usage(
                        "--sd needs a case whose sheet explains the baseline; the note above states why this one does not",
                    ));
                }
                // the map itself is still written
                Err(why) => {
                    eprintln!(
                        "tactus-lab: frame '{}': no standard deviation is known: {}",
                        printable(name),
                        error_chain(&why)
                    );
                    vec![f64::NAN; areas.len()]
                }
            }),
            false => None,
        };
        Ok(Ok(Made {
            map,
            pressure,
            time,
            deviation,
        }))
    };
    // fast methods run sequentially, so that their times do not influence each other
    let made: Vec<Result<Made, String>> = if model.slow {
        recording
            .frames
            .par_iter()
            .enumerate()
            .map(one)
            .collect::<Result<_, Failure>>()?
    } else {
        recording
            .frames
            .iter()
            .enumerate()
            .map(one)
            .collect::<Result<_, Failure>>()?
    };
    bar.finish_and_clear();
    let mut maps = Vec::with_capacity(recording.frames.len() * areas.len());
    let mut times = Vec::with_capacity(recording.frames.len());
    let mut rows = String::from(FRAMES_HEADING);
    let mut deviations = Vec::new();
    let mut without = WithoutMap::default();
    let numbered = recording.frames.iter().zip(&recording.numbers);
    for (index, (((name, _), &frame), made)) in numbered.zip(&made).enumerate() {
        let known = made.as_ref().ok();
        let deviation = known.and_then(|made| made.deviation.as_deref());
        let tracked = followed.as_ref().map(|followed| &followed[index].tracked);
        let row = MapRow {
            frame,
            label: name,
            time: None,
            tracked,
            map: match made {
                Ok(made) => Ok(MapOfRow {
                    map: &made.map,
                    found: made.map.found_above(noise, &centroids, &areas),
                    noise,
                    pressure: made.pressure.as_ref(),
                    deviation: deviation.map(|values| DeviationSummary::of(values, &areas)),
                }),
                Err(why) => Err(why.as_str()),
            },
        };
        without.take(&row);
        rows += &row.text();
        if options.json {
            let line = serde_json::to_string(&row.line())
                .map_err(|fault| Failure::of("a line cannot be written as JSON", &fault))?;
            print_line!("{}", survey::printable_json(line));
        }
        let named = format!("tactus-lab: frame '{}'", printable(name));
        if let Some(tracked) = tracked.filter(|tracked| !tracked.known) {
            eprintln!("{named}: {tracked}");
        }
        if let Err(why) = made {
            eprintln!("{named} has no map: {why}");
        }
        let quality = known.and_then(|made| made.map.quality.as_ref());
        if let Some(quality) = quality.filter(|quality| !quality.is_silent()) {
            eprintln!("{named} is {quality}");
        }
        if known.is_some_and(|made| made.map.method.ends_with(eit::CLIPPED)) {
            eprintln!(
                "{named}: the bounded problem was not solved; its map is the unbounded one, clipped"
            );
        }
        times.extend(known.map(|made| made.time));
        maps.extend_from_slice(&row.values(areas.len()));
        if options.sd {
            let unknown = || vec![f64::NAN; areas.len()];
            deviations.extend(deviation.map_or_else(unknown, <[f64]>::to_vec));
        }
    }
    if let Some(text) = without.text().filter(|_| without.is_all()) {
        return Err(Failure::because(text));
    }
    let maps = DMatrix::from_row_slice(recording.frames.len(), areas.len(), &maps);
    let existing = options.replacing.existing();
    let table = |path: &Path, text: String| {
        let mut table = OutFile::create(path, existing)?;
        table.put(text.as_bytes())?;
        Ok::<_, Failure>(table)
    };
    let mut tables = vec![table(&options.out, matrix_text(&maps))?];
    if let Some(beside) = &beside {
        tables.push(table(&beside.frames, rows)?);
        tables.push(table(&beside.triangles, triangles_text(&case.mesh))?);
        if options.sd {
            let rows = DMatrix::from_row_slice(recording.frames.len(), areas.len(), &deviations);
            tables.push(table(&beside.deviations, matrix_text(&rows))?);
        }
    }
    outfile::finish_all(tables)?;
    if let Some(beside) = beside.filter(|_| !options.sd) {
        // the deviations of earlier maps are not those of these
        outfile::remove(&beside.deviations, existing)?;
    }
    if options.timing {
        eprintln!("frame {:.3} ms", median(&mut times));
    }
    without
        .text()
        .map_or(Ok(()), |text| Err(Failure::because(text)))
}

/// The results for a frame.
struct Made {
    map: Map,
    pressure: Option<Pressure>,
    /// Time of the reconstruction, ms.
    time: f64,
    deviation: Option<Vec<f64>>,
}

/// The frames of a MAT-file, or of a table.
fn frames(options: &ReconstructOptions, readings: usize) -> Result<FrameTable, Failure> {
    let table = TableOptions {
        frames: options.frames.as_deref(),
        baseline: options.baseline.as_ref(),
        negate: options.negate,
    };
    geometry::frames(&options.case, &table, readings)
}

/// The frames with the tracked baseline of each; `None` if tracking is not requested.
fn follow(
    options: &ReconstructOptions,
    case: &Case,
    recording: &FrameTable,
) -> Result<Option<Vec<TrackedFrame>>, Failure> {
    let follows = options.tracked.tracked == Some(true);
    let period_s = options.tracked.period_s(follows, false);
    let Some(period_s) = period_s.map_err(Failure::usage)? else {
        return Ok(None);
    };
    let mut tracking = options.method.tracking(case, recording, 0.0)?;
    let numbered = recording.frames.iter().zip(&recording.numbers);
    let frames = numbered.map(|((name, frame), number)| {
        tracking
            .follow(frame, period_s * *number as f64)
            .map_err(|fault| Failure::of(&format!("frame '{name}'"), &fault))
    });
    frames.collect::<Result<_, _>>().map(Some)
}
