//! `tactus export --format nc`: a session as a netCDF file (classic, 64-bit offset), written frame by frame.

mod layout;
mod maps;
mod quantities;

use std::io::Write;
use std::path::Path;

use imaging::recorded::SessionParts;
use logbook::FrameRecord;
use netcdf3::DataType;
use outfile::OutFile;
use survey::{Electrode, Measurement};

use super::{Written, seconds, volts};
use crate::args::Export;
use crate::failure::Failure;
use crate::maps::frame_maps::FrameMaps;
use crate::maps::reconstruction::Reconstruction;
use crate::output::Printer;
use crate::output::time::utc;
use layout::{Layout, RECORD_COUNT_AT, RecordBytes};
use maps::MapVariables;

/// The values of [`survey::Reading::flag`], and their meanings in the same order.
const FLAGS: [i8; 3] = [0, 1, 3];
const FLAG_MEANINGS: &str = "ok overload not_measured";

/// Writes the file and reports its path.
pub(super) fn write(
    path: &Path,
    session: &SessionParts,
    export: &Export,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let header = session.header();
    if outfile::is_stream(&export.out) {
        return Err(Failure::Usage(format!(
            "{} is a device or a pipe, and a netCDF file begins with the number of frames, which is known only after the last one: name a \
             file with --out",
            export.out.display()
        )));
    }
    let first = super::first_frame(session)?;
    let compared = match export.maps {
        true => {
            super::check_comparable(session)?;
            Some(Reconstruction::of_session(path, &export.asked)?)
        }
        false => None,
    };
    let reconstruction = compared.as_ref().map(|(_, reconstruction)| reconstruction);
    let mut maps = match &compared {
        Some((recording, reconstruction)) => Some(MapVariables::new(
            FrameMaps::new(reconstruction, &export.asked.tracked, recording)?
                .with_deviation(export.sd),
            reconstruction,
            export.sd,
        )),
        None => None,
    };
    let mut layout = layout(session, &first, reconstruction, export.sd)?;
    let folder = logbook::folder_of(path);
    let lost = quantities::quantities(&mut layout, folder, header.session())?;
    if lost > 0 {
        eprintln!("tactus: {lost} of the stored minutes of quantities are damaged and left out");
    }
    let mut file = OutFile::create(&export.out, export.replacing.existing())?;
    file.put(&layout.bytes()?)?;
    let (mut written, mut last) = (0_u32, header.first_sequence - 1);
    let mut bytes = RecordBytes::default();
    let damaged = super::each_frame(session, printer.is_terminal(), |record| {
        bytes.clear();
        frame(&mut bytes, &record)?;
        if let Some(maps) = &mut maps {
            maps.put(&mut bytes, &record)?;
        }
        file.put(bytes.bytes())?;
        last = record.frame.sequence;
        written += 1;
        Ok(())
    })?;
    file.put_at(RECORD_COUNT_AT, &written.to_be_bytes())?;
    let path = file.finish()?;
    for remark in reconstruction.iter().flat_map(|made| &made.remarks) {
        printer.text(remark)?;
    }
    Written::table("nc", &path, written as usize, header).report(printer)?;
    super::finish(session, damaged, last, export)?;
    match maps.is_some_and(|maps| maps.made() == 0) {
        true => Err(Failure::Failed(format!(
            "no frame of session {} has a map; its readings are in the file",
            header.id
        ))),
        false => Ok(()),
    }
}

/// Everything before the records.
fn layout(
    session: &SessionParts,
    first: &FrameRecord,
    reconstruction: Option<&Reconstruction>,
    sd: bool,
) -> Result<Layout, Failure> {
    let header = session.header();
    let settings = &first.frame.settings;
    let baseline = session.baseline()?;
    let mut layout = Layout::new("time")?;
    layout.dimension("reading", header.protocol.len())?;
    layout.dimension("electrode", header.protocol.electrodes())?;
    let conventions = match reconstruction {
        Some(_) => "CF-1.11 UGRID-1.0",
        None => "CF-1.11",
    };
    let simulated = match header.simulated {
        true => "SIMULATED: voltages of a simulated sheet",
        false => "measured",
    };
    for (name, text) in [
        ("Conventions", conventions),
        ("title", &format!("Tactus session {}", header.session())),
        ("source", simulated),
        ("session", header.session()),
        ("started", &utc(header.started)),
        ("note", &header.note),
        ("build", &header.build),
        ("protocol_hash", &header.protocol.hash()),
        ("configuration", &header.config_toml),
        ("configuration_hash", &header.config_hash),
        (
            "geometry_hash",
            header.geometry_hash.as_deref().unwrap_or_default(),
        ),
        ("wiring", &settings.wiring),
        ("method", reconstruction.map_or("", Reconstruction::method)),
        (
            "baseline_session",
            baseline.as_ref().map_or("", |baseline| &baseline.id),
        ),
    ] {
        layout.text(name, text)?;
    }
    for (name, value) in [
        ("current_a", settings.current.0),
        ("range_v", settings.range.0),
        ("nplc", settings.nplc),
        ("settle_s", settings.settle.as_secs_f64()),
    ] {
        layout.number(name, value)?;
    }
    let electrodes = (0..header.protocol.electrodes()).map(number);
    layout.whole_numbers(
        "electrode",
        &["electrode"],
        electrodes.collect(),
        &[(
            "long_name",
            "electrode, counted from 0; the label on the sheet is one more",
        )],
    )?;
    type Of = fn(&Measurement) -> Electrode;
    let ends: [(&str, Of, &str); 4] = [
        (
            "inject_plus",
            |one| one.drive.plus,
            "electrode where the current enters",
        ),
        (
            "inject_minus",
            |one| one.drive.minus,
            "electrode where the current leaves",
        ),
        (
            "measure_plus",
            |one| one.sense.plus,
            "positive electrode of the voltage",
        ),
        (
            "measure_minus",
            |one| one.sense.minus,
            "negative electrode of the voltage",
        ),
    ];
    for (name, of, meaning) in ends {
        let measurements = header.protocol.measurements().iter();
        let numbers = measurements.map(|one| number(of(one).0));
        let meaning = format!("{meaning}, counted from 0");
        layout.whole_numbers(
            name,
            &["reading"],
            numbers.collect(),
            &[("long_name", &meaning)],
        )?;
    }
    if let Some(baseline) = &baseline {
        layout.numbers(
            "baseline",
            &["reading"],
            baseline.readings.iter().map(volts).collect(),
            &[
                ("long_name", "voltage of the unloaded sheet"),
                ("units", "V"),
            ],
        )?;
        layout.count("baseline", "frames", number(baseline.frames))?;
    }
    if let Some(reconstruction) = reconstruction {
        maps::mesh(&mut layout, reconstruction.mesh())?;
    }
    // no `_FillValue`: readers take NaN as missing without it, and `netcdf3` compares attributes, where NaN differs
    // from itself. The order of the variables of records is that of `frame` and of `MapVariables::put`
    layout.variable(
        "time",
        &["time"],
        DataType::F64,
        &[
            ("standard_name", "time"),
            ("long_name", "first step of the frame"),
            ("units", "seconds since 1970-01-01 00:00:00"),
            ("calendar", "standard"),
            ("axis", "T"),
        ],
    )?;
    layout.variable(
        "sequence",
        &["time"],
        DataType::I32,
        &[("long_name", "number of the frame in its session, from 1")],
    )?;
    layout.variable(
        "quality",
        &["time", "reading"],
        DataType::I8,
        &[
            ("long_name", "why a reading is missing"),
            ("standard_name", "status_flag"),
            ("flag_meanings", FLAG_MEANINGS),
        ],
    )?;
    layout.flags("quality", "flag_values", &FLAGS)?;
    layout.variable(
        "voltage",
        &["time", "reading"],
        DataType::F64,
        &[
            (
                "long_name",
                "voltage between measure_plus and measure_minus",
            ),
            ("units", "V"),
            ("ancillary_variables", "quality"),
        ],
    )?;
    if let Some(reconstruction) = reconstruction {
        maps::records(&mut layout, reconstruction, sd)?;
    }
    Ok(layout)
}

/// The values of a frame, in the order of [`layout`].
fn frame(bytes: &mut RecordBytes, record: &FrameRecord) -> Result<(), Failure> {
    let frame = &record.frame;
    let sequence = i32::try_from(frame.sequence).map_err(|_| {
        Failure::Failed(format!(
            "frame {} has a number above {}, the largest of a netCDF file; --format csv has no limit",
            frame.sequence,
            i32::MAX
        ))
    })?;
    bytes.reals([seconds(record)]);
    bytes.whole(sequence);
    bytes.small(frame.readings.iter().map(|reading| reading.flag() as i8));
    bytes.reals(frame.readings.iter().map(volts));
    Ok(())
}

/// A count as the format stores it; those of meshes and protocols are far below the limit.
fn number(count: usize) -> i32 {
    i32::try_from(count).unwrap_or(i32::MAX)
}
