//! `tactus-lab merit`: figures of merit of raster images in CSV files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use eit::digits;
use eit::metrics::{Image, Likeness, likeness};

use crate::args::MeritOptions;
use crate::output::print_line;
use studies::Failure;

/// Name of the file in the folder of the images with a row x, y for each image.
const TARGETS: &str = "targets.csv";

/// Prints a line for each image: GREIT's figures, and the figures that compare the image with the truth.
pub(crate) fn merit(options: &MeritOptions) -> Result<(), Failure> {
    let files = images(&options.images)?;
    let targets = targets(options, &files)?;
    if options.width_mm.is_some() && targets.is_empty() {
        return Err(Failure::usage(format!(
            "--width-mm and --height-mm are for the location error, which needs the true places: --targets FILE, or {TARGETS} among the \
             images"
        )));
    }
    if !options.json {
        print_line!(
            "image,amplitude,position_error,resolution,shape_deformation,ringing,location_error_mm,correlation,\
             relative_error,ssim,dice"
        );
    }
    for (name, path) in &files {
        let failed = |fault| Failure::of(&format!("{}", path.display()), &fault);
        let mut image = Image::new(&read(path)?).map_err(failed)?;
        if options.negate {
            image = image.negated();
        }
        let target = targets.get(name).copied();
        let merit = image.greit(target.unwrap_or([0.0; 2])).map_err(failed)?;
        let millimetres = target
            .zip(options.width_mm.zip(options.height_mm))
            .map(|(t, (w, h))| {
                // the unit of the coordinates is half the box; x is along rows, which is along the sheet's height
                (0.5 * h * (t[0] - merit.centroid[0])).hypot(0.5 * w * (t[1] - merit.centroid[1]))
            });
        let beside = match &options.truth {
            None => None,
            Some(folder) => {
                let path = folder.join(format!("{name}.csv"));
                let failed = |fault| Failure::of(&format!("{}", path.display()), &fault);
                let mut truth = Image::new(&read(&path)?).map_err(failed)?;
                if options.negate {
                    truth = truth.negated();
                }
                if truth.shape() != image.shape() {
                    return Err(Failure::because(format!(
                        "{}: {:?} pixels, its image has {:?}",
                        path.display(),
                        truth.shape(),
                        image.shape()
                    )));
                }
                let (mut map, mut wanted) = (Vec::new(), Vec::new());
                for (a, b) in image.values().iter().zip(truth.values()) {
                    if !(a.is_nan() || b.is_nan()) {
                        map.push(*a);
                        wanted.push(*b);
                    }
                }
                let range = wanted.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
                let like = likeness(&map, &wanted, &vec![1.0; map.len()]);
                Some((like, image.ssim(&truth, range)))
            }
        };
        let position = target.map(|_| merit.position_error);
        let figure = |of: fn(&Likeness) -> f64| {
            let like = beside.as_ref().map(|(like, _)| like);
            like.map(of).filter(|figure| !figure.is_nan())
        };
        let correlation = figure(|like| like.correlation);
        let relative = figure(|like| like.relative_error);
        let dice = figure(|like| like.dice);
        let ssim = beside.and_then(|(_, ssim)| ssim);
        if options.json {
            let line = serde_json::json!({
                "image": name,
                "amplitude": merit.amplitude,
                "position_error": position,
                "resolution": merit.resolution,
                "shape_deformation": merit.shape_deformation,
                "ringing": merit.ringing,
                "location_error_mm": millimetres,
                "correlation": correlation,
                "relative_error": relative,
                "ssim": ssim,
                "dice": dice,
            });
            print_line!("{}", survey::printable_json(line.to_string()));
        } else {
            let figures = [
                Some(merit.amplitude),
                position,
                Some(merit.resolution),
                Some(merit.shape_deformation),
                Some(merit.ringing),
                millimetres,
                correlation,
                relative,
                ssim,
                dice,
            ];
            let figures = figures.map(|value| value.map(digits).unwrap_or_default());
            print_line!("{},{}", csv_text(name), figures.join(","));
        }
    }
    Ok(())
}

/// A text as a field of CSV, in double quotes if it would otherwise be read as several.
fn csv_text(text: &str) -> String {
    let text = survey::printable(text);
    match text.contains([',', '"']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.into_owned(),
    }
}

/// Every CSV file of the folder by its name, except the targets.
fn images(folder: &Path) -> Result<BTreeMap<String, PathBuf>, Failure> {
    let failed = |cause: std::io::Error| Failure::of(&format!("{}", folder.display()), &cause);
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let csv = path.extension().is_some_and(|extension| extension == "csv");
        if !csv || path.file_name().is_some_and(|name| name == TARGETS) {
            continue;
        }
        if let Some(name) = path.file_stem().and_then(|stem| stem.to_str()) {
            files.insert(name.to_owned(), path);
        }
    }
    if files.is_empty() {
        return Err(Failure::because(format!(
            "{}: the folder has no image (CSV files, one line per row of pixels, NaN outside)",
            folder.display()
        )));
    }
    Ok(files)
}

/// x, y of each image: `name,x,y`, or `x,y` in the order of the names.
fn targets(
    options: &MeritOptions,
    files: &BTreeMap<String, PathBuf>,
) -> Result<BTreeMap<String, [f64; 2]>, Failure> {
    let path = match &options.targets {
        Some(path) => path.clone(),
        None => {
            let path = options.images.join(TARGETS);
            if !path.exists() {
                return Ok(BTreeMap::new());
            }
            path
        }
    };
    let text = std::fs::read_to_string(&path)
        .map_err(|cause| Failure::of(&format!("{}", path.display()), &cause))?;
    let mut names = files.keys();
    let mut targets = BTreeMap::new();
    for (number, line) in text.lines().enumerate() {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let (label, place) = fields.split_at(fields.len().saturating_sub(2));
        let numbers: Vec<f64> = place
            .iter()
            .filter_map(|field| field.parse().ok())
            .collect();
        if numbers.is_empty() && (number == 0 || line.trim().is_empty()) {
            continue; // the header
        }
        let place = <[f64; 2]>::try_from(numbers).ok();
        let place = place.filter(|place| place.iter().all(|x| x.is_finite()));
        let [x, y] = place.ok_or_else(|| {
            Failure::because(format!(
                "{}:{}: 'image,x,y' or 'x,y' is expected",
                path.display(),
                number + 1
            ))
        })?;
        let name = match label {
            [] => names.next().cloned(),
            [name, ..] => Some(name.trim_end_matches(".csv").to_owned()),
        };
        match name {
            Some(name) if files.contains_key(&name) => {
                targets.insert(name, [x, y]);
            }
            _ => {
                return Err(Failure::because(format!(
                    "{}:{}: a target without an image",
                    path.display(),
                    number + 1
                )));
            }
        }
    }
    Ok(targets)
}

/// Rows of pixels; an empty field is outside, like NaN.
fn read(path: &Path) -> Result<Vec<Vec<f64>>, Failure> {
    let text = std::fs::read_to_string(path)
        .map_err(|cause| Failure::of(&format!("{}", path.display()), &cause))?;
    text.lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty())
        .map(|(number, line)| {
            line.split(',')
                .map(|field| match field.trim() {
                    "" => Ok(f64::NAN),
                    field => field.parse().map_err(|_| {
                        Failure::because(format!(
                            "{}:{}: '{field}' is not a number",
                            path.display(),
                            number + 1
                        ))
                    }),
                })
                .collect()
        })
        .collect()
}
