//! `tactus export --format png`, `svg` and `raster`: the map of one frame.

use std::io::Write;
use std::path::Path;

use eit::Pressure;
use imaging::recorded::{Recording, SessionParts};

use super::{Written, instant};
use crate::args::Export;
use crate::failure::Failure;
use crate::maps::drawing;
use crate::maps::pictures::Pictures;
use crate::maps::reconstruction::Reconstruction;
use crate::options::choices::Format;
use crate::output::Printer;

/// Default number of pixels along each side of a raster.
const PIXELS: usize = 32;

/// Writes the picture and reports its path.
pub(super) fn picture(
    path: &Path,
    session: &SessionParts,
    export: &Export,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let header = session.header();
    super::check_comparable(session)?;
    let sequence = match (&export.at, export.frame) {
        (Some(instant), _) => instant::frame_at(session, instant)?,
        (None, Some(sequence)) => sequence,
        (None, None) => session.last_sequence()?,
    };
    let recording = Recording::from_session(path, None, false)?;
    let frame = match recording.frame(sequence) {
        Ok(frame) => frame,
        Err(error) => {
            let first = super::first_frame(session)?.frame.sequence;
            let last = session.last_sequence()?;
            if (first..=last).contains(&sequence) {
                return Err(error.into());
            }
            return Err(Failure::Usage(format!(
                "session {} has no frame {sequence}; its frames have the numbers {first} to {last}: name one of these \
                 with --frame or --at, or omit both for the last one",
                header.id
            )));
        }
    };
    let reconstruction = Reconstruction::new(&export.asked, &recording)?;
    let pictures = Pictures::new(&reconstruction, &export.asked.tracked, &recording)?;
    let (picture, style) = pictures.only(&frame, export.scale)?;
    let (map, shown, found) = (&picture.made.map, &picture.shown, picture.found);
    let pressure = picture.made.pressure.as_ref();
    let (what, bytes) = match export.format {
        Format::Svg => (
            "svg",
            drawing::svg(&reconstruction.field, shown, &style)?.into_bytes(),
        ),
        Format::Raster => (
            "raster",
            drawing::raster(
                &reconstruction.field,
                shown,
                export.raster.unwrap_or(PIXELS),
            )?
            .into_bytes(),
        ),
        Format::Png | Format::Apng | Format::Csv | Format::Parquet | Format::Nc | Format::Mat => {
            ("png", drawing::png(&reconstruction.field, shown, &style)?)
        }
    };
    outfile::write(&export.out, export.replacing.existing(), &bytes)?;
    for remark in &reconstruction.remarks {
        printer.text(remark)?;
    }
    let written = Written {
        what,
        path: export.out.display().to_string(),
        session: header.id.clone(),
        frames: 1,
        simulated: header.simulated,
        frame: Some(sequence),
        method: Some(map.method.clone()),
        found_mm: drawing::millimetres(found),
        largest_loss: Some(map.largest_loss().map_or(0.0, |(_, loss)| loss)),
        significant: map.is_significant(reconstruction.noise),
        noise: reconstruction.noise,
        unit: Some(drawing::unit(shown)),
        newtons: pressure.map(|pressure| pressure.newtons),
        largest_kpa: pressure.map(Pressure::largest_kpa),
        quality: map.quality.clone(),
        ..Written::default()
    };
    printer.record(&written, |written| {
        format!(
            "{} {}: frame {sequence}, {}",
            written.what,
            written.path,
            match style.nothing_above {
                Some(noise) => render::nothing_above(noise),
                None => format!("found {}", drawing::place(written.found_mm)),
            }
        )
    })
}
