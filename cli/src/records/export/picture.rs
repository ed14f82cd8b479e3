//! `tactus export --format png`, `svg` and `raster`: the map of one frame.

use std::io::Write;
use std::path::Path;

use eit::Pressure;
use imaging::recorded::{Recording, SessionParts};

use super::Written;
use crate::args::Export;
use crate::failure::Failure;
use crate::maps::drawing;
use crate::maps::follower::Follower;
use crate::options::choices::Format;
use crate::output::Printer;
use crate::output::time::local;

/// Writes the picture and reports its path.
pub(super) fn picture(
    path: &Path,
    session: &SessionParts,
    export: &Export,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let header = session.header();
    super::check_comparable(session)?;
    let sequence = match export.frame {
        Some(sequence) => sequence,
        None => session.last_sequence()?,
    };
    let record = session.frame(sequence)?;
    let recording = Recording::from_session(path, None, false)?;
    let reconstruction = super::reconstruction(export, &recording)?;
    let of_frame = Follower::of(&reconstruction, &export.tracked, &recording)?
        .map(|mut follower| follower.up_to(&recording, sequence))
        .transpose()?;
    let (baseline, readings) = match &of_frame {
        Some(frame) => (&frame.baseline, &frame.readings),
        None => (&recording.unloaded.readings, &record.frame.readings),
    };
    let map = reconstruction.map(baseline, readings)?;
    let found = reconstruction.field.found(&map, reconstruction.noise);
    let pressure = reconstruction.pressure(&map)?;
    let calibrated = pressure.as_ref().map(|pressure| pressure.map(&map));
    let shown = calibrated.as_ref().unwrap_or(&map);
    let title = drawing::title(
        format!(
            "{}, frame {sequence}, {}",
            header.id,
            local(record.frame.wall),
        ),
        of_frame.as_ref().map(|frame| &frame.tracked),
    );
    let style = drawing::style(
        title,
        (export.scale, shown.unit),
        header.simulated,
        found,
        &map,
        reconstruction.noise,
    )?;
    let (what, bytes) = match export.format {
        Format::Svg => (
            "svg",
            drawing::svg(&reconstruction.field, shown, &style)?.into_bytes(),
        ),
        Format::Raster => (
            "raster",
            drawing::raster(&reconstruction.field, shown, export.raster)?.into_bytes(),
        ),
        Format::Png | Format::Csv | Format::Nc | Format::Mat => {
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
        newtons: pressure.as_ref().map(|pressure| pressure.newtons),
        largest_kpa: pressure.as_ref().map(Pressure::largest_kpa),
        quality: map.quality.clone(),
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
