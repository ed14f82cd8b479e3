//! `tactus-lab dataset --recorded`: presses of a real sheet as a training set.

use std::path::Path;

use eit::model::fingerprint;
use eit::{Case, Mesh, TrainingSettings, bounding_box};
use imaging::recorded::{FrameTable, TableOptions};
use studies::Failure;
use studies::evaluation::test_set;
use survey::Reading;
use training::dataset::keep_recorded;
use training::samples::Sample;
use training::single_current;

use crate::args::DatasetOptions;
use crate::maps::{Press, Presses};
use crate::output::print_line;

/// Number of sampled positions along each edge of a triangle for the share that a press covers.
const PLACES: u32 = 6;
/// Share of the sheet: if all presses are so near to the origin, their positions are in a wrong unit.
const SPECK: f64 = 0.01;
/// Default of the relative loss under the largest pressure.
const LOSS: f64 = 0.5;
/// Millimetres in a metre.
const MILLI: f64 = 1e3;

/// Makes the set and prints its content.
pub(super) fn dataset(options: &DatasetOptions, case: &Case, folder: &Path) -> Result<(), Failure> {
    let presses = Presses::read(&folder.join(test_set::PRESSES))?;
    if let Some(loss) = options.loss
        && presses.all.iter().any(|press| press.loss.is_some())
    {
        return Err(Failure::usage(format!(
            "--loss {loss} does not apply: {} has the loss of each press in its column loss; leave one of them out",
            presses.file.display()
        )));
    }
    let table = TableOptions {
        baseline: options.baseline.as_ref(),
        ..TableOptions::default()
    };
    let recording = FrameTable::read(folder, &table, case.protocol.len())?;
    check_places(&case.mesh, &presses)?;
    check_count(presses.all.len(), case.protocol.len(), options.yes)?;
    let current = single_current(case)?;
    let unloaded = volts("the baseline", &recording.unloaded.readings)?;
    let largest = unloaded.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    if largest == 0.0 {
        return Err(Failure::because(format!(
            "{}: every reading of the baseline is zero",
            folder.display()
        )));
    }
    let strengths = strengths(&presses, options.loss.unwrap_or(LOSS))?;
    let mut samples = Vec::with_capacity(presses.all.len());
    for (press, loss) in presses.all.iter().zip(strengths) {
        let (name, frame) = &recording.frames[presses.row(press, &recording)?];
        let frame = volts(&format!("frame '{name}'"), frame)?;
        let target = target(&case.mesh, press, loss);
        if target.is_empty() {
            return Err(presses.wrong(
                press,
                "the press covers no part of the region that maps show",
            ));
        }
        samples.push(Sample {
            input: frame
                .iter()
                .zip(&unloaded)
                .map(|(loaded, unloaded)| ((loaded - unloaded) / largest) as f32)
                .collect(),
            target,
        });
    }
    let at_one_ampere: Vec<f64> = unloaded.iter().map(|volts| volts / current).collect();
    let made = keep_recorded(
        case,
        &samples,
        &at_one_ampere,
        &source(&samples, &at_one_ampere),
        options.seed.unwrap_or(TrainingSettings::default().seed),
        &options.out,
    )?;
    match made.sha256 {
        None => print_line!(
            "{}: exists already, {} presses",
            made.file.display(),
            made.cases.len()
        ),
        Some(hash) => print_line!(
            "{}: {} presses, largest reading of the baseline {largest:.3e}, the unit of --noise-v; sha256 {hash}",
            made.file.display(),
            made.cases.len()
        ),
    }
    Ok(())
}

/// Hash of all recorded data.
fn source(samples: &[Sample], unloaded: &[f64]) -> String {
    let mut bytes: Vec<u8> = unloaded.iter().flat_map(|v| v.to_le_bytes()).collect();
    for sample in samples {
        bytes.extend(sample.input.iter().flat_map(|value| value.to_le_bytes()));
        for (triangle, change) in &sample.target {
            bytes.extend(triangle.to_le_bytes());
            bytes.extend(change.to_le_bytes());
        }
    }
    fingerprint(&bytes)
}

/// The readings of a frame, V; a missing one is an error.
fn volts(of: &str, readings: &[Reading]) -> Result<Vec<f64>, Failure> {
    let found = readings.iter().enumerate().map(|(number, reading)| {
        reading.volts().map(|volts| volts.0).ok_or_else(|| {
            Failure::because(format!(
                "{of} has no value for reading m{number}; a training set needs all of them"
            ))
        })
    });
    found.collect()
}

/// Refuses presses whose centres are not on the sheet; the error distinguishes a wrong unit from a wrong position.
fn check_places(mesh: &Mesh, presses: &Presses) -> Result<(), Failure> {
    let [low, high] = bounding_box(mesh.nodes().iter().copied());
    let ranges = [0, 1].map(|axis| [low[axis], high[axis]]);
    let within = |at: [f64; 2]| {
        let axes = at.iter().zip(&ranges);
        axes.clone()
            .all(|(x, [low, high])| (low..=high).contains(&x))
    };
    let times = |factor: f64| {
        let mut all = presses.all.iter();
        all.all(|press| within(press.centre.map(|x| factor * x)))
    };
    let millimetres =
        |[low, high]: [f64; 2]| format!("{:.1} to {:.1} mm", MILLI * low, MILLI * high);
    let sheet = format!(
        "the sheet reaches from {} in x, from {} in y",
        millimetres(ranges[0]),
        millimetres(ranges[1])
    );
    let place = |press: &Press| {
        // rounded to the nanometre
        let [x, y] = press.centre.map(|x| (1e6 * MILLI * x).round() / 1e6);
        format!("the press at ({x}, {y}) mm")
    };
    if let Some(press) = presses.all.iter().find(|press| !within(press.centre)) {
        let hint = match times(1.0 / MILLI) {
            true => {
                "; if the places are in mm, all lie on it: name the columns x_mm, y_mm, diameter_mm"
            }
            false => "",
        };
        let why = format!("{} is outside of the sheet: {sheet}{hint}", place(press));
        return Err(presses.wrong(press, &why));
    }
    // positions in m in columns of mm are all near the origin
    let at_origin = |press: &Press| {
        let mut axes = press.centre.iter().zip(&ranges);
        axes.all(|(x, [low, high])| x.abs() < SPECK * (high - low))
    };
    if let Some(press) = presses.all.first()
        && presses.all.len() > 1
        && presses.all.iter().all(at_origin)
        && times(MILLI)
    {
        let why = format!(
            "{} and all others lie within {:.0} % of the sheet from (0, 0): {sheet}; if the places are in m, name the columns x_m, \
             y_m, diameter_m",
            place(press),
            100.0 * SPECK
        );
        return Err(presses.wrong(press, &why));
    }
    Ok(())
}

/// Refuses fewer presses than readings, unless confirmed.
fn check_count(presses: usize, readings: usize, confirmed: bool) -> Result<(), Failure> {
    if presses >= readings || confirmed && presses > 0 {
        return Ok(());
    }
    Err(Failure::usage(format!(
        "{presses} presses for {readings} readings: a linear map has {readings} unknowns for each triangle, so that {} more presses are \
         needed to determine them. --yes makes the set nevertheless: the noise of the training then determines what the presses do not",
        readings - presses
    )))
}

/// Relative loss under each press: the stated loss, or a share of `largest` in proportion to the pressure, or `largest`
/// for all presses if neither is stated for any. If only some presses have a loss or a mass, those without are refused.
fn strengths(presses: &Presses, largest: f64) -> Result<Vec<f64>, Failure> {
    let pressure = |press: &Press| press.mass.map(|mass| mass / press.diameter.powi(2));
    let most = presses.all.iter().filter_map(pressure).fold(0.0, f64::max);
    let known = |press: &Press| press.loss.is_some() || press.mass.is_some();
    let some_known = presses.all.iter().any(known);
    presses
        .all
        .iter()
        .map(|press| match (press.loss, pressure(press)) {
            (Some(loss), _) => Ok(loss),
            (None, Some(pressure)) if pressure > 0.0 => Ok(largest * pressure / most),
            (None, Some(_)) => Err(presses.wrong(press, "mass_kg is 0: a press needs a mass")),
            (None, None) if some_known => Err(presses.wrong(
                press,
                "neither mass_kg nor loss is given, and other presses have one: give it here too",
            )),
            (None, None) => Ok(largest),
        })
        .collect()
}

/// The map of a press: its loss times the covered share of each triangle.
fn target(mesh: &Mesh, press: &Press, loss: f64) -> Vec<(u32, f32)> {
    let radius = 0.5 * press.diameter;
    let mut target = Vec::new();
    for (unknown, &triangle) in mesh.region().iter().enumerate() {
        let [a, b, c] = mesh.corners(triangle);
        let away = |at: [f64; 2]| (at[0] - press.centre[0]).hypot(at[1] - press.centre[1]);
        // the whole triangle is within a distance of its perimeter from each corner
        let size = [(a, b), (b, c), (c, a)].map(|(p, q)| (p[0] - q[0]).hypot(p[1] - q[1]));
        if away(a) > radius + size.iter().sum::<f64>() {
            continue;
        }
        let mut covered = 0_u32;
        for i in 0..PLACES {
            for j in 0..PLACES {
                // midpoints of the cells of a square, whose upper half is folded into the triangle
                let mut at = [i, j].map(|k| (f64::from(k) + 0.5) / f64::from(PLACES));
                if at[0] + at[1] > 1.0 {
                    at = at.map(|x| 1.0 - x);
                }
                let along = |axis: usize| {
                    a[axis] + at[0] * (b[axis] - a[axis]) + at[1] * (c[axis] - a[axis])
                };
                covered += u32::from(away([along(0), along(1)]) < radius);
            }
        }
        if covered > 0 {
            let share = f64::from(covered) / f64::from(PLACES * PLACES);
            target.push((unknown as u32, (-loss * share) as f32));
        }
    }
    target
}
