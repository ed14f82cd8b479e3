//! `tactus export`: writes a recorded session as tables, or a frame's map as a picture.

mod csv;
mod picture;

use std::io::Write;

use imaging::recorded::SessionParts;
use logbook::SessionKind;
use serde::Serialize;
use survey::MapQuality;

use crate::args::{Export, Global};
use crate::failure::Failure;
use crate::options::choices::Format;
use crate::output::Printer;
use crate::session_files;

/// A line of `export --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
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
}

/// Writes the requested files and reports their paths.
pub(crate) fn run(
    global: &Global,
    export: &Export,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let path = session_files::session_file(global, &export.session)?;
    let session = SessionParts::open(&path)?;
    match export.format {
        Format::Csv => csv::tables(&session, export, printer),
        Format::Png | Format::Svg | Format::Raster
            if session.header().kind == SessionKind::Baseline =>
        {
            Err(Failure::Failed(format!(
                "session {} is a baseline: it is what maps are compared with and has none of its own; name a measurement \
                 (`tactus sessions`), or take --format csv",
                session.header().id
            )))
        }
        Format::Png | Format::Svg | Format::Raster => {
            picture::picture(&path, &session, export, printer)
        }
    }
}
