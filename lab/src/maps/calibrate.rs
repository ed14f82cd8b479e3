//! `tactus-lab calibrate`: fits the conversion from relative loss to kPa to a method's own maps of presses of known
//! mass and area.

use std::f64::consts::PI;
use std::path::Path;

use eit::{Calibration, KnownPress};
use phantom::GRAVITY;

use imaging::recorded::TableOptions;
use studies::evaluation::{MethodOptions, test_set};
use studies::{Failure, write};

use crate::args::CalibrateOptions;
use crate::geometry;
use crate::output::print_line;

use super::presses::Presses;

/// Fits a calibration and writes its file.
pub(crate) fn calibrate(options: &CalibrateOptions) -> Result<(), Failure> {
    let case = geometry::read(&options.case)?;
    let presses = options
        .presses
        .clone()
        .unwrap_or_else(|| geometry::folder(&options.case).join(test_set::PRESSES));
    let presses = Presses::read(&presses)?;
    let table = TableOptions {
        frames: options.frames.as_deref(),
        baseline: options.baseline.as_ref(),
        negate: false,
    };
    let recording = geometry::frames(&options.case, &table, case.protocol.len())?;
    let chosen = MethodOptions::parse(&options.method, &words(options))?;
    if chosen.removes_drift() {
        let attempt = "--drift frame is for readings at one current";
        geometry::one_current(&options.case, &case, attempt)?;
    }
    let model = chosen.prepare(&case, &recording)?;
    for note in &model.notes {
        eprintln!("tactus-lab: {}", survey::printable(note));
    }
    let known = presses
        .all
        .iter()
        .map(|press| {
            let (name, frame) = &recording.frames[presses.row(press, &recording)?];
            let mass = press
                .mass
                .ok_or_else(|| presses.wrong(press, "mass_kg is needed for a calibration"))?;
            let map = model
                .reconstructor
                .reconstruct(&recording.unloaded.readings, frame)
                .map_err(|fault| Failure::of(&format!("frame '{name}'"), &fault))?;
            Ok(KnownPress {
                name: format!("line {}, frame {}", press.line, press.frame),
                map,
                centre: press.centre,
                area: 0.25 * PI * press.diameter * press.diameter,
                newtons: GRAVITY * mass,
            })
        })
        .collect::<Result<Vec<_>, Failure>>()?;
    let calibration = Calibration::fit(&case.mesh, &known)
        .map_err(|fault| Failure::of("no calibration", &fault))?;
    let text = toml::to_string_pretty(&calibration)
        .map_err(|fault| Failure::of("the calibration cannot be written as TOML", &fault))?;
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

/// Reads a calibration from its file.
pub(crate) fn read(path: &Path) -> Result<Calibration, Failure> {
    let refused = |why| Failure::because(format!("calibration {}: {why}", path.display()));
    imaging::read_calibration(path).map_err(refused)
}

/// The method as options of `reconstruct`.
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
