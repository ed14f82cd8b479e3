//! `tactus-lab calibrate`: from relative loss to kPa, fitted to a method's own maps of presses of known mass and area.

use std::f64::consts::PI;
use std::path::Path;

use eit::{Calibration, KnownPress};
use phantom::GRAVITY;

use imaging::recorded::{FrameTable, TableOptions};
use studies::evaluation::MethodOptions;
use studies::{Failure, write};

use crate::args::CalibrateOptions;
use crate::geometry;
use crate::output::print_line;

const HEADER: [&str; 5] = ["frame", "x_m", "y_m", "diameter_m", "mass_kg"];

/// Fits a calibration and writes its file.
pub(crate) fn calibrate(options: &CalibrateOptions) -> Result<(), Failure> {
    let case = geometry::read(&options.case)?;
    let presses = options
        .presses
        .clone()
        .unwrap_or_else(|| options.case.join("presses.csv"));
    let presses = read_presses(&presses)?;
    let table = TableOptions {
        frames: options.frames.as_deref(),
        baseline: options.baseline.as_ref(),
        negate: false,
    };
    let recording = FrameTable::read(&options.case, &table, case.protocol.len())?;
    let chosen = MethodOptions::parse(&options.method, &words(options))?;
    let model = chosen.prepare(&case, &recording)?;
    for note in &model.notes {
        eprintln!("tactus-lab: {}", survey::printable(note));
    }
    let known = presses
        .iter()
        .map(|press| {
            let row = recording.numbers.iter().position(|number| *number == press.frame);
            let (name, frame) = row.map(|row| &recording.frames[row]).ok_or_else(|| {
                Failure::because(format!(
                    "frame {} of line {} of the presses is not there; there are {}, numbered {} to {}",
                    press.frame,
                    press.line,
                    recording.frames.len(),
                    recording.numbers.first().unwrap_or(&1),
                    recording.numbers.last().unwrap_or(&1),
                ))
            })?;
            let map = model
                .reconstructor
                .reconstruct(&recording.unloaded.readings, frame)
                .map_err(|fault| Failure::of(&format!("frame '{name}'"), &fault))?;
            Ok(KnownPress {
                name: format!("line {}, frame {}", press.line, press.frame),
                map,
                centre: press.centre,
                area: 0.25 * PI * press.diameter * press.diameter,
                newtons: GRAVITY * press.mass,
            })
        })
        .collect::<Result<Vec<_>, Failure>>()?;
    let calibration = Calibration::fit(&case.mesh, &known)
        .map_err(|fault| Failure::of("no calibration", &fault))?;
    let text = toml::to_string_pretty(&calibration)
        .map_err(|fault| Failure::of("the calibration cannot be written down", &fault))?;
    write(&options.out, options.replacing.existing(), text)?;
    if options.json {
        let line = serde_json::json!({
            "calibration": options.out.display().to_string(),
            "method": calibration.method,
            "presses": calibration.presses,
            "rms": calibration.rms,
            "loss": calibration.loss,
            "kpa": calibration.kpa,
        });
        print_line!("{}", survey::printable_json(line.to_string()));
    } else {
        print_line!(
            "{}: {} presses by '{}'; the load in newtons comes back within {:.0} % (rms), up to {:.0} kPa at a loss of {:.2}",
            options.out.display(),
            calibration.presses,
            calibration.method,
            100.0 * calibration.rms,
            calibration.kpa.last().copied().unwrap_or(0.0),
            calibration.loss.last().copied().unwrap_or(0.0)
        );
    }
    Ok(())
}

/// A calibration from its file.
pub(crate) fn read(path: &Path) -> Result<Calibration, Failure> {
    let refused = |why: String| Failure::because(format!("calibration {}: {why}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|cause| refused(cause.to_string()))?;
    let calibration: Calibration =
        toml::from_str(&text).map_err(|fault| refused(fault.to_string()))?;
    calibration
        .check()
        .map_err(|fault| refused(fault.to_string()))?;
    Ok(calibration)
}

/// The method as arguments of `reconstruct`.
fn words(options: &CalibrateOptions) -> Vec<String> {
    let mut words: Vec<String> = match options.method.strip_prefix("model ") {
        Some(file) => vec!["--model".to_owned(), file.to_owned()],
        None => ["--method"]
            .into_iter()
            .chain(options.method.split_whitespace())
            .map(str::to_owned)
            .collect(),
    };
    if let Some(noise_v) = options.noise_v {
        words.extend(["--noise-v".to_owned(), noise_v.to_string()]);
    }
    words
}

/// A line of `presses.csv`.
struct Press {
    line: usize,
    frame: u64,
    centre: [f64; 2],
    diameter: f64,
    mass: f64,
}

fn read_presses(path: &Path) -> Result<Vec<Press>, Failure> {
    let text = std::fs::read_to_string(path)
        .map_err(|cause| Failure::of(&format!("cannot read {}", path.display()), &cause))?;
    let mut lines = text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty());
    let wrong =
        |line: usize, why: String| Failure::because(format!("{}:{line}: {why}", path.display()));
    let header: Vec<&str> = lines.next().map_or(Vec::new(), |(_, line)| {
        line.split(',').map(str::trim).collect()
    });
    let column = |name: &str| {
        header
            .iter()
            .position(|found| *found == name)
            .ok_or_else(|| {
                wrong(
                    1,
                    format!(
                        "column '{name}' is missing; expected are {}",
                        HEADER.join(",")
                    ),
                )
            })
    };
    let columns = [
        column(HEADER[0])?,
        column(HEADER[1])?,
        column(HEADER[2])?,
        column(HEADER[3])?,
        column(HEADER[4])?,
    ];
    lines
        .map(|(index, line)| {
            let fields: Vec<&str> = line.split(',').map(str::trim).collect();
            let field = |k: usize| -> Result<f64, Failure> {
                let text = fields.get(columns[k]).copied().unwrap_or("");
                text.parse::<f64>()
                    .ok()
                    .filter(|value| value.is_finite())
                    .ok_or_else(|| {
                        wrong(
                            index + 1,
                            format!("{} is '{text}', a number is expected", HEADER[k]),
                        )
                    })
            };
            let frame = field(0)?;
            if !(frame >= 1.0 && frame.fract() == 0.0) {
                return Err(wrong(
                    index + 1,
                    format!("frame is {frame}, frames are numbered from 1"),
                ));
            }
            Ok(Press {
                line: index + 1,
                frame: frame as u64,
                centre: [field(1)?, field(2)?],
                diameter: field(3)?,
                mass: field(4)?,
            })
        })
        .collect()
}
