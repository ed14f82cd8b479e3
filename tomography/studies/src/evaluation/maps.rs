//! The maps of one method for one test set, with the truth.

use std::ops::Range;
use std::path::Path;
use std::time::Instant;

use eit::Case;
use rayon::prelude::*;
use survey::{Map, Reading};

use super::MethodOptions;
use super::statistics::average;
use super::test_set;
use crate::failure::{Attempt, Failure};
use crate::progress;
use imaging::Model;
use imaging::recorded::{BaselineRule, FrameTable, TableOptions, one_current};
use training::noise_figure::by_draws;

/// Noise stated for frames without noise, V; with zero noise a method would fit the error of its model.
const LEAST_NOISE: f64 = 2e-6;
/// File with the true change of each frame.
const TRUTH: &str = "truth.csv";
/// Columns of `presses.csv` with the position of a press.
const PRESS_PLACE: Range<usize> = 1..3;

/// One frame of a test set.
pub struct Frame {
    /// The method's map.
    pub map: Map,
    /// The true change.
    pub truth: Map,
    /// Centre of the disc, m, if the load is one disc.
    pub place: Option<[f64; 2]>,
    /// Time of the reconstruction alone, ms.
    pub ms: f64,
}

/// Maps of a test set by one method.
pub struct Judged {
    /// The test set's case.
    pub case: Case,
    /// Displayed name and noise of the set.
    pub set: String,
    /// The frames after the baseline.
    pub frames: Vec<Frame>,
    model: Model,
    noise_v: f64,
    recording: FrameTable,
}

impl Judged {
    /// The noise figure of the method. For a method without one it is estimated by draws of this set's noise, which
    /// takes the time of several frames.
    pub fn noise_figure(&self) -> Option<f64> {
        let method = self.model.reconstructor.as_ref();
        method
            .noise_figure()
            .or_else(|| by_draws(method, &self.case, self.noise_v, self.model.slow))
    }

    /// Share of the frames that the method reports as novel; `None` if it does not report novelty.
    pub fn novel_share(&self) -> Option<f64> {
        let outside = |(_, frame): &(String, Vec<Reading>)| {
            let novelty = self
                .model
                .reconstructor
                .novelty(&self.recording.unloaded.readings, frame);
            Some(f64::from(u8::from(novelty.ok()??.outside())))
        };
        let frames = self.recording.frames.iter().skip(1);
        let outside: Option<Vec<f64>> = frames.map(outside).collect();
        outside.map(|outside| average(outside.into_iter()))
    }
}

/// Runs a method, given as arguments of `reconstruct`. The truth is read after the method was prepared and is not
/// passed to it. A frame that the method refuses is an error.
///
/// # Errors
/// An unreadable folder, invalid options, or a refused frame.
pub fn maps(folder: &Path, name: &str, words: &[String]) -> Result<Judged, Failure> {
    run(folder, name, words, false)
}

/// As [`maps`], but refused frames are skipped.
///
/// # Errors
/// An unreadable folder, or invalid options.
pub fn maps_not_refused(folder: &Path, name: &str, words: &[String]) -> Result<Judged, Failure> {
    run(folder, name, words, true)
}

fn run(folder: &Path, name: &str, words: &[String], leave_out: bool) -> Result<Judged, Failure> {
    let case = Case::read(folder).attempt("cannot read the case")?;
    let description = test_set::description(folder)?;
    let mut with_noise = words.to_vec();
    // `tv-paper` does not use the noise
    if words[0] == "--method" && words.get(1).is_none_or(|method| method != "tv-paper") {
        let noise_v = description.noise_v.max(LEAST_NOISE);
        with_noise.extend(["--noise-v".to_owned(), noise_v.to_string()]);
    }
    let options = MethodOptions::parse(name, &with_noise)?;
    let first = BaselineRule::First(1);
    let table = TableOptions {
        baseline: Some(&first),
        ..TableOptions::default()
    };
    let recording = FrameTable::read(folder, &table, case.protocol.len())?;
    if options.removes_drift() {
        one_current(&folder.join("protocol.csv"), &case.currents)
            .attempt("--drift frame is for readings at one current")?;
    }
    let model = options.prepare(&case, &recording)?;
    let triangles = case.mesh.region().len();
    let truths = rows(
        &folder.join(TRUTH),
        recording.frames.len().saturating_sub(1),
        0..triangles,
        true,
    )?;
    let bar = progress::bar(truths.len(), "frames");
    let one = |k: usize| -> Result<Option<(Map, f64)>, Failure> {
        let (frame_name, frame) = &recording.frames[k + 1];
        let start = Instant::now();
        let made = model
            .reconstructor
            .reconstruct(&recording.unloaded.readings, frame);
        bar.inc(1);
        match made {
            Ok(map) => Ok(Some((map, start.elapsed().as_secs_f64() * 1e3))),
            Err(_) if leave_out => Ok(None),
            Err(fault) => Err(Failure::of(
                &format!("{name}, frame '{frame_name}'"),
                &fault,
            )),
        }
    };
    // fast methods run sequentially, so that the frames do not change each other's time
    let maps: Vec<Option<(Map, f64)>> = if model.slow {
        (0..truths.len())
            .into_par_iter()
            .map(one)
            .collect::<Result<_, Failure>>()?
    } else {
        (0..truths.len()).map(one).collect::<Result<_, Failure>>()?
    };
    bar.finish_and_clear();
    let presses = folder.join(test_set::PRESSES);
    let places = match presses.exists() {
        true => rows(&presses, truths.len(), PRESS_PLACE, false)?,
        false => Vec::new(),
    };
    let frames = maps
        .into_iter()
        .zip(truths)
        .enumerate()
        .filter_map(|(k, (made, truth))| {
            let (map, ms) = made?;
            Some(Frame {
                truth: Map::relative(&map.mesh_hash, truth, "truth"),
                map,
                place: places.get(k).map(|row| [row[0], row[1]]),
                ms,
            })
        })
        .collect();
    Ok(Judged {
        case,
        set: description.name,
        frames,
        model,
        noise_v: description.noise_v.max(LEAST_NOISE),
        recording,
    })
}

/// Whether a frame of a test set has a true load. A truth that cannot be read counts as one: [`maps`] reports it.
pub fn has_load(folder: &Path) -> bool {
    let is_load = |field: &str| field.trim().parse().is_ok_and(|change: f64| change != 0.0);
    std::fs::read_to_string(folder.join(TRUTH))
        .map_or(true, |text| text.split([',', '\n']).any(is_load))
}

/// The numbers in these columns of a file without a header, one row for each frame after the baseline. Other columns
/// may contain any text; with `only` they must not exist.
fn rows(
    path: &Path,
    count: usize,
    columns: Range<usize>,
    only: bool,
) -> Result<Vec<Vec<f64>>, Failure> {
    let text = std::fs::read_to_string(path)
        .map_err(|cause| Failure::of(&format!("{}", path.display()), &cause))?;
    let mut rows = Vec::new();
    for (k, line) in text.lines().enumerate() {
        let fields: Vec<Option<f64>> = line.split(',').map(|field| field.parse().ok()).collect();
        let header = k == 0 && fields.iter().all(Option::is_none);
        if header || line.trim().is_empty() {
            continue;
        }
        let wanted = fields.get(columns.clone());
        let row = wanted.and_then(|wanted| wanted.iter().copied().collect());
        match row {
            Some(row) if !only || fields.len() == columns.end => rows.push(row),
            _ => {
                return Err(Failure::because(format!(
                    "{}:{}: numbers are expected in the columns {} to {}",
                    path.display(),
                    k + 1,
                    columns.start + 1,
                    columns.end
                )));
            }
        }
    }
    if rows.len() != count {
        return Err(Failure::because(format!(
            "{}: {} row(s), for {count} frames after the baseline",
            path.display(),
            rows.len()
        )));
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::rows;

    #[test]
    fn damaged_rows_of_the_truth_are_errors_with_their_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            rows(&path, 2, 0..3, true).map_err(|fault| fault.to_string())
        };
        let whole = vec![vec![1.0, 2.0, 3.0], vec![4.0, 5.0, 6.0]];
        assert_eq!(read("1,2,3\n4,5,6\n").as_ref(), Ok(&whole));
        assert_eq!(read("frame,x_m,y_m\n1,2,3\n4,5,6\n"), Ok(whole));
        for (text, words) in [
            (
                "frame,x_m,y_m\n1,2,3\n4,y,6\n",
                "truth.csv:3: numbers are expected in the columns 1 to 3",
            ),
            (
                "1,2,x\n4,5,6\n",
                "truth.csv:1: numbers are expected in the columns 1 to 3",
            ),
            (
                "1,2\n4,5,6\n",
                "truth.csv:1: numbers are expected in the columns 1 to 3",
            ),
            ("1,2,3\n", "truth.csv: 1 row(s), for 2 frames"),
            ("1,2,3\n4,5,6\n7,8,9\n", "truth.csv: 3 row(s), for 2 frames"),
        ] {
            let fault = read(text).unwrap_err();
            assert!(fault.contains(words), "{fault}");
        }
    }

    #[test]
    fn of_presses_only_the_places_must_be_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("presses.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            rows(&path, 2, 1..3, false).map_err(|fault| fault.to_string())
        };
        let text = "frame,x_m,y_m,mass_kg\nf17,0.1,0.2,\n\nf18,0.3,0.4,1.5\n";
        assert_eq!(read(text), Ok(vec![vec![0.1, 0.2], vec![0.3, 0.4]]));
        let fault = read("f17,0.1,0.2\nf18,0.3\n").unwrap_err();
        assert!(
            fault.contains("presses.csv:2: numbers are expected in the columns 2 to 3"),
            "{fault}"
        );
    }
}
