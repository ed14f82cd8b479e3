//! `tactus export --format parquet`: frames, events and stored quantities as Parquet files.

mod table;

use std::io::Write;
use std::path::Path;

use chrono::{DateTime, Utc};
use imaging::quantities::{STORED_S, joined, stored};
use imaging::recorded::SessionParts;
use logbook::{FrameRecord, SessionHeader};
use outfile::OutFile;

use super::csv::{electrodes, missing};
use super::{Written, volts};
use crate::args::Export;
use crate::failure::Failure;
use crate::output::Printer;
use table::{Column, Kind, Table};

/// Frames in a row group: 20 MB in memory for 598 readings.
const GROUP: usize = 2048;

/// Columns of frames before the voltages: those of the CSV table, without those that are the same in all rows.
const FRAME: [(&str, Kind); 7] = [
    ("sequence", Kind::Whole),
    ("wall_utc", Kind::Time),
    ("monotonic_s", Kind::Real),
    ("duration_s", Kind::Real),
    ("current_A", Kind::Real),
    ("compliance", Kind::Text),
    ("missing", Kind::Text),
];
const EVENT: [(&str, Kind); 3] = [
    ("at_utc", Kind::Time),
    ("kind", Kind::Text),
    ("text", Kind::Text),
];
/// Columns of quantities, as in `tactus quantities --csv`.
const QUANTITY: [(&str, Kind); 9] = [
    ("begin_utc", Kind::Time),
    ("region", Kind::Text),
    ("quantity", Kind::Text),
    ("unit", Kind::Text),
    ("min", Kind::Real),
    ("mean", Kind::Real),
    ("max", Kind::Real),
    ("frames", Kind::Whole),
    ("known", Kind::Whole),
];

/// Writes the files and reports their paths.
pub(super) fn write(
    path: &Path,
    session: &SessionParts,
    export: &Export,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let header = session.header();
    super::first_frame(session)?;
    if outfile::is_stream(&export.out) {
        return Err(Failure::Usage(format!(
            "{} is a device or a pipe, and a Parquet export is several files: name a file with --out",
            export.out.display()
        )));
    }
    let existing = export.replacing.existing();
    let beside = |what: &str| export.out.with_extension(format!("{what}.parquet"));
    let folder = logbook::folder_of(path);
    let (rows, lost) = stored(folder, header.session())?.unwrap_or_default();
    let events = session.events()?;
    let frames = OutFile::create(&export.out, existing)?;
    let event_file = OutFile::create(&beside("events"), existing)?;
    let quantity_path = beside("quantities");
    outfile::check(&quantity_path, existing)?;
    let quantity_file = match rows.is_empty() {
        true => None,
        false => Some(OutFile::create(&quantity_path, existing)?),
    };
    let mut columns = named(&FRAME);
    columns.extend((0..header.protocol.len()).map(|reading| (format!("m{reading}_V"), Kind::Real)));
    let mut table = Table::new(frames, &columns, &facts(header))?;
    let mut group: Vec<FrameRecord> = Vec::with_capacity(GROUP);
    let (mut written, mut last) = (0, header.first_sequence - 1);
    let damaged = super::each_frame(session, printer.is_terminal(), |record| {
        last = record.frame.sequence;
        written += 1;
        group.push(record);
        if group.len() == GROUP {
            table.put(&of_frames(&group, header.protocol.len()))?;
            group.clear();
        }
        Ok(())
    })?;
    table.put(&of_frames(&group, header.protocol.len()))?;
    let mut event_table = Table::new(event_file, &named(&EVENT), &facts(header))?;
    let text = |of: fn(&logbook::Event) -> &str| {
        Column::Text(
            events
                .iter()
                .map(|event| Some(of(event).to_owned()))
                .collect(),
        )
    };
    event_table.put(&[
        Column::Whole(
            events
                .iter()
                .map(|event| event.at.timestamp_micros())
                .collect(),
        ),
        text(|event| &event.kind),
        text(|event| &event.text),
    ])?;
    let report = |what, path: &Path, printer: &mut Printer<_>| {
        Written::table(what, path, written, header).report(printer)
    };
    report("frames", &table.finish()?, printer)?;
    report("events", &event_table.finish()?, printer)?;
    if let Some(file) = quantity_file {
        let mut table = Table::new(file, &named(&QUANTITY), &facts(header))?;
        let rows = joined(&rows, STORED_S);
        for rows in rows.chunks(1 << 16) {
            let text = |of: &dyn Fn(&imaging::quantities::QuantityRow) -> String| {
                Column::Text(rows.iter().map(|row| Some(of(row))).collect())
            };
            let real = |of: fn(&imaging::quantities::QuantityRow) -> f64| {
                Column::Real(rows.iter().map(|row| Some(of(row))).collect())
            };
            let whole = |of: fn(&imaging::quantities::QuantityRow) -> i64| {
                Column::Whole(rows.iter().map(of).collect())
            };
            table.put(&[
                whole(|row| micros(row.begin_s)),
                text(&|row| row.region.clone()),
                text(&|row| row.quantity.name().to_owned()),
                text(&|row| row.quantity.unit(row.of).to_owned()),
                real(|row| row.min),
                real(|row| row.mean),
                real(|row| row.max),
                whole(|row| row.frames as i64),
                whole(|row| row.known as i64),
            ])?;
        }
        report("quantities", &table.finish()?, printer)?;
    } else {
        // the quantities of an earlier export are not those of these frames
        outfile::remove(&quantity_path, existing)?;
    }
    if lost > 0 {
        eprintln!("tactus: {lost} of the stored minutes of quantities are damaged and left out");
    }
    super::finish(session, damaged, last, export)
}

/// Columns with their names.
fn named(columns: &[(&str, Kind)]) -> Vec<(String, Kind)> {
    columns
        .iter()
        .map(|(name, kind)| ((*name).to_owned(), *kind))
        .collect()
}

/// Metadata of the whole file.
fn facts(header: &SessionHeader) -> [(&'static str, &str); 6] {
    let source = match header.simulated {
        true => "SIMULATED: voltages of a simulated sheet",
        false => "measured",
    };
    [
        ("session", header.session()),
        ("source", source),
        ("note", &header.note),
        ("build", &header.build),
        ("configuration", &header.config_toml),
        ("configuration_hash", &header.config_hash),
    ]
}

fn micros(begin_s: i64) -> i64 {
    DateTime::<Utc>::from_timestamp(begin_s, 0).map_or(0, |begin| begin.timestamp_micros())
}

/// The columns of a group of frames.
fn of_frames(records: &[FrameRecord], readings: usize) -> Vec<Column> {
    let real = |of: fn(&FrameRecord) -> f64| {
        Column::Real(records.iter().map(|record| Some(of(record))).collect())
    };
    let text = |of: fn(&FrameRecord) -> String| {
        let texts = records.iter().map(of);
        Column::Text(
            texts
                .map(|text| Some(text).filter(|text| !text.is_empty()))
                .collect(),
        )
    };
    let whole = |of: fn(&FrameRecord) -> i64| Column::Whole(records.iter().map(of).collect());
    let mut columns = vec![
        whole(|record| record.frame.sequence as i64),
        whole(|record| record.frame.wall.timestamp_micros()),
        real(|record| record.frame.monotonic.as_secs_f64()),
        real(|record| record.frame.duration.as_secs_f64()),
        real(|record| record.frame.settings.current.0),
        text(|record| electrodes(&record.frame)),
        text(|record| missing(&record.frame)),
    ];
    columns.extend((0..readings).map(|reading| {
        let values = records
            .iter()
            .map(|record| volts(&record.frame.readings[reading]));
        Column::Real(
            values
                .map(|value| Some(value).filter(|value| !value.is_nan()))
                .collect(),
        )
    }));
    columns
}
