//! `tactus export`: writes a recorded session as tables or as a file of another program, or a frame's map as a picture.

mod csv;
mod film;
mod instant;
mod mat;
mod netcdf;
#[cfg(feature = "parquet")]
mod parquet;
mod picture;

use std::io::Write;
use std::path::Path;

use imaging::recorded::SessionParts;
use logbook::{FrameRecord, SessionHeader, SessionKind};
use serde::Serialize;
use survey::{MapQuality, Reading};

use crate::args::{Export, Global, MapOptions};
use crate::failure::Failure;
use crate::maps::recording::left_out;
use crate::options::choices::{Format, GeometryChoice, MethodArguments, Scale, TrackedArguments};
use crate::output::Printer;
use crate::output::progress::progress;
use crate::session_files;

/// A line of `export --json`; see `docs/reference/json.md`.
#[derive(Debug, Default, Serialize)]
struct Written {
    what: &'static str,
    path: String,
    session: String,
    frames: usize,
    simulated: bool,
    /// For a picture: the frame, the method, and the result.
    frame: Option<u64>,
    method: Option<String>,
    found_mm: Option<[f64; 2]>,
    largest_loss: Option<f64>,
    significant: Option<bool>,
    noise: Option<f64>,
    unit: Option<&'static str>,
    newtons: Option<f64>,
    largest_kpa: Option<f64>,
    quality: Option<MapQuality>,
    /// For a film: number of pictures, time between them in the session, and speed relative to the session.
    pictures: Option<usize>,
    every_s: Option<f64>,
    speed: Option<f64>,
}

impl Written {
    /// The result for a file that is not a picture.
    fn table(what: &'static str, path: &Path, frames: usize, header: &SessionHeader) -> Self {
        Self {
            what,
            path: path.display().to_string(),
            session: header.id.clone(),
            frames,
            simulated: header.simulated,
            ..Self::default()
        }
    }

    fn report(&self, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
        printer.record(self, |written| {
            format!("{:<9} {}", written.what, written.path)
        })
    }
}

/// Writes the requested files and reports their paths.
pub(crate) fn run(
    global: &Global,
    export: &Export,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    check_options(export)?;
    let path = session_files::session_file(global, &export.session)?;
    let session = SessionParts::open(&path)?;
    match export.format {
        Format::Csv => csv::tables(&session, export, printer),
        Format::Nc => netcdf::write(&path, &session, export, printer),
        Format::Mat => mat::write(&session, export, printer),
        #[cfg(feature = "parquet")]
        Format::Parquet => parquet::write(&path, &session, export, printer),
        #[cfg(not(feature = "parquet"))]
        Format::Parquet => Err(Failure::Usage(
            "this tactus was built without Parquet: take that of the Debian package, or build it with `--features parquet`; --format nc \
             and csv have the same numbers"
                .to_owned(),
        )),
        Format::Apng => film::write(&path, &session, export, printer),
        Format::Png | Format::Svg | Format::Raster => {
            picture::picture(&path, &session, export, printer)
        }
    }
}

/// Refuses options that have no effect with the format.
fn check_options(export: &Export) -> Result<(), Failure> {
    let format = export.format;
    let one_map = format.is_picture();
    let drawn = one_map || format == Format::Apng;
    let has_maps = drawn || export.maps;
    let MapOptions {
        calibration,
        method,
        tracked,
        geometry,
    } = &export.asked;
    let rules = [
        (
            export.maps,
            format == Format::Nc,
            "--maps belongs to --format nc; `tactus replay SESSION --out maps.csv` writes maps as a table",
        ),
        (
            export.at.is_some(),
            one_map,
            "--at belongs to --format png, svg and raster, which draw one map",
        ),
        (
            export.every.is_some() || export.speed.is_some(),
            format == Format::Apng,
            "--every and --speed belong to --format apng; `tactus quantities` has an --every of its own",
        ),
        (
            export.frame.is_some(),
            one_map,
            "--frame belongs to --format png, svg and raster, which draw one map",
        ),
        (
            export.raster.is_some(),
            format == Format::Raster,
            "--raster belongs to --format raster",
        ),
        (
            export.scale != Scale::Own,
            drawn,
            "--scale belongs to --format png, svg, raster and apng, which draw maps",
        ),
        (
            calibration.is_some(),
            has_maps,
            "--calibration belongs to --format png, svg, raster, apng and nc with --maps, which have maps",
        ),
        (
            *method != MethodArguments::default(),
            has_maps,
            "--method, --noise-v and other options of the method belong to --format png, svg, raster, apng and nc with --maps, which have \
             maps",
        ),
        (
            *tracked != TrackedArguments::default(),
            has_maps,
            "--tracked and --period-s belong to --format png, svg, raster, apng and nc with --maps, which have maps",
        ),
        (
            *geometry != GeometryChoice::default(),
            has_maps || matches!(format, Format::Csv | Format::Mat),
            "--preset, --case and other options of the geometry belong to --format csv, mat, png, svg, raster, apng and nc with --maps",
        ),
    ];
    match rules.into_iter().find(|(stated, used, _)| *stated && !used) {
        Some((.., refusal)) => Err(Failure::Usage(refusal.to_owned())),
        None => Ok(()),
    }
}

/// Refuses a session whose frames cannot be compared with a baseline.
fn check_comparable(session: &SessionParts) -> Result<(), Failure> {
    let header = session.header();
    if header.kind == SessionKind::Baseline {
        return Err(Failure::Failed(format!(
            "session {} is a baseline: it is the reference of maps and has no maps itself; name a measurement \
             (`tactus sessions`), or take --format csv",
            header.id
        )));
    }
    if session.baseline()?.is_none() {
        return Err(Failure::Failed(format!(
            "session {} has no baseline, so there is no change to draw; `tactus replay {} --baseline first:N` can",
            header.id, header.id
        )));
    }
    Ok(())
}

/// Passes each readable frame on, with progress; returns the number of damaged frames, each of which is named.
fn each_frame(
    session: &SessionParts,
    on_terminal: bool,
    mut take: impl FnMut(FrameRecord) -> Result<(), Failure>,
) -> Result<usize, Failure> {
    let bar = progress(Some(session.len()?), on_terminal);
    let mut damaged = 0;
    for record in session.frames() {
        match record {
            Ok(record) => take(record)?,
            Err(error) => {
                bar.suspend(|| left_out(&error));
                damaged += 1;
            }
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(damaged)
}

/// The failure of an export without the damaged frames.
fn check_undamaged(damaged: usize, header: &SessionHeader) -> Result<(), Failure> {
    crate::maps::recording::check_undamaged(damaged, &format!("session {}", header.id))
}

/// Marks the frames up to `last` as exported, unless some are damaged; `sessions prune --exported-only` uses the mark.
fn finish(
    session: &SessionParts,
    damaged: usize,
    last: u64,
    export: &Export,
) -> Result<(), Failure> {
    check_undamaged(damaged, session.header())?;
    // output to a device or a pipe may not be stored anywhere
    if outfile::is_stream(&export.out) {
        return Ok(());
    }
    for part in session.each() {
        let own = part.last_sequence()?;
        // frames that a running session has recorded meanwhile were not exported
        crate::records::maintenance::mark(part, own.min(last), export);
    }
    Ok(())
}

/// The first readable frame, whose settings are those of the session.
fn first_frame(session: &SessionParts) -> Result<FrameRecord, Failure> {
    session.frames().find_map(Result::ok).ok_or_else(|| {
        Failure::Failed(format!(
            "session {} has no readable frame, so there is nothing to export; `tactus sessions` lists the frames of each session",
            session.header().id
        ))
    })
}

/// Time of a frame, s since 1970-01-01 UTC.
fn seconds(record: &FrameRecord) -> f64 {
    record.frame.wall.timestamp_micros() as f64 / 1e6
}

/// The voltage; NaN for a missing reading.
fn volts(reading: &Reading) -> f64 {
    reading.volts().map_or(f64::NAN, |volts| volts.0)
}

/// Why a reading is missing.
fn reason(reading: Reading) -> Option<&'static str> {
    match reading {
        Reading::Ok(_) => None,
        Reading::Overload => Some("overload"),
        Reading::NotMeasured => Some("not_measured"),
    }
}
