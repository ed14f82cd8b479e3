//! `tactus-lab reconstruct`: maps of recorded frames.

use std::time::Instant;

use eit::{Case, matrix_text};
use nalgebra::DMatrix;
use rayon::prelude::*;
use survey::{Map, Reading, error_chain};

use imaging::TrackedFrame;
use imaging::recorded::{
    DeviationSummary, FRAMES_HEADING, FrameTable, MapCompanions, MapRow, TableOptions,
    triangles_text,
};
use studies::evaluation::median;
use studies::{Failure, progress, write};

use super::calibrate;
use crate::args::ReconstructOptions;
use crate::geometry;
use crate::output::print_line;

/// Writes a row for each frame of the file. A frame that the method refuses is an error that names it.
pub(crate) fn reconstruct(options: &ReconstructOptions) -> Result<(), Failure> {
    let case = geometry::with_depth(geometry::read(&options.case)?, &options.depth)?;
    // a device or a pipe has no companion files
    let beside = (!outfile::is_stream(&options.out)).then(|| MapCompanions::of(&options.out));
    if options.sd && beside.is_none() {
        return Err(Failure::usage(
            "--sd writes a file beside the maps; --out must be a file",
        ));
    }
    if let Some(beside) = &beside {
        outfile::check(&beside.frames, options.replacing.existing())?;
        outfile::check(&beside.triangles, options.replacing.existing())?;
        if options.sd {
            outfile::check(&beside.deviations, options.replacing.existing())?;
        }
    }
    if options.tracked.tracked == Some(true) && options.method.removes_drift() {
        return Err(Failure::usage(
            "--drift frame is for frames whose baseline is not followed; leave it or --tracked out",
        ));
    }
    let recording = frames(options, case.protocol.len())?;
    let calibration = options
        .calibration
        .as_deref()
        .map(calibrate::read)
        .transpose()?;
    let model = options.method.prepare(&case, &recording)?;
    for note in &model.notes {
        eprintln!("tactus-lab: {}", survey::printable(note));
    }
    let followed = follow(options, &case, &recording)?;
    let (centroids, areas) = (case.mesh.region_centroids(), case.mesh.region_areas());
    let bar = progress::bar(recording.frames.len(), "frames");
    let one = |(index, (name, frame)): (usize, &(String, Vec<Reading>))| {
        let start = Instant::now();
        let (baseline, readings) = match &followed {
            Some(followed) => (&followed[index].baseline, &followed[index].readings),
            None => (&recording.unloaded.readings, frame),
        };
        let failed = |fault| Failure::of(&format!("frame '{name}'"), &fault);
        let map = model.reconstruct(baseline, readings).map_err(failed)?;
        let time = start.elapsed().as_secs_f64() * 1e3;
        let deviation = match options.sd {
            true => Some(match model.deviation(baseline, readings) {
                Ok(Some(found)) => found.values(),
                Ok(None) => {
                    return Err(Failure::usage(
                        "--sd needs the sheet behind the frames; with --model FILE say --drift frame too",
                    ));
                }
                // its map is written all the same
                Err(why) => {
                    eprintln!(
                        "tactus-lab: frame '{name}': no standard deviation is known: {}",
                        error_chain(&why)
                    );
                    vec![f64::NAN; areas.len()]
                }
            }),
            false => None,
        };
        bar.inc(1);
        Ok((map, time, deviation))
    };
    // fast methods run sequentially, so that their times do not influence each other
    let made: Vec<(Map, f64, Option<Vec<f64>>)> = if model.slow {
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
    let numbered = recording.frames.iter().zip(&recording.numbers);
    for (index, (((name, _), &frame), (map, time, deviation))) in numbered.zip(made).enumerate() {
        let tracked = followed.as_ref().map(|followed| &followed[index].tracked);
        times.push(time);
        let pressure = match &calibration {
            Some(calibration) => Some(
                calibration
                    .pressure(&case.mesh, &map)
                    .map_err(|fault| Failure::of(&format!("frame '{name}'"), &fault))?,
            ),
            None => None,
        };
        let row = MapRow {
            frame,
            label: name,
            time: None,
            found: map.found(&centroids, &areas),
            noise: None,
            map: &map,
            pressure: pressure.as_ref(),
        };
        rows += &row.text();
        if options.json {
            let line = serde_json::json!({
                "frame": frame,
                "label": name,
                "method": map.method,
                "largest_loss": map.largest_loss().map(|(_, loss)| loss),
                "found_mm": row.found.map(|place| place.map(|metres| 1e3 * metres)),
                "masked": map.masked,
                "evidence": map.evidence,
                "quality": map.quality,
                "tracked": tracked,
                "map_sd": deviation.as_ref().map(|deviation| DeviationSummary::of(deviation, &areas)),
                "unit": if pressure.is_some() { "kPa" } else { map.unit.label() },
                "newtons": pressure.as_ref().map(|pressure| pressure.newtons),
                "largest_kpa": pressure.as_ref().map(eit::Pressure::largest_kpa),
            });
            print_line!("{}", survey::printable_json(line.to_string()));
        }
        if let Some(tracked) = tracked.filter(|tracked| !tracked.known) {
            eprintln!("tactus-lab: frame '{name}': {tracked}");
        }
        if let Some(quality) = map.quality.as_ref().filter(|quality| !quality.is_silent()) {
            eprintln!("tactus-lab: frame '{name}' is {quality}");
        }
        if map.method.ends_with(eit::CLIPPED) {
            eprintln!(
                "tactus-lab: frame '{name}': the bounded problem was not solved; its map is the unbounded one, clipped"
            );
        }
        maps.extend_from_slice(row.values());
        deviations.extend(deviation.into_iter().flatten());
    }
    let maps = DMatrix::from_row_slice(recording.frames.len(), areas.len(), &maps);
    let existing = options.replacing.existing();
    write(&options.out, existing, matrix_text(&maps))?;
    if let Some(beside) = beside {
        write(&beside.frames, existing, rows)?;
        write(&beside.triangles, existing, triangles_text(&case.mesh))?;
        if options.sd {
            let rows = DMatrix::from_row_slice(recording.frames.len(), areas.len(), &deviations);
            write(&beside.deviations, existing, matrix_text(&rows))?;
        }
    }
    if options.timing {
        eprintln!("frame {:.3} ms", median(&mut times));
    }
    Ok(())
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

/// The frames with the baseline that is followed through them; `None` where that is not asked for.
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
