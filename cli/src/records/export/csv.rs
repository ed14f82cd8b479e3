//! `tactus export --format csv`: a session as tables, with the files of a case folder next to them.

use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

use imaging::recorded::{SessionParts, table_time};
use logbook::FrameRecord;
use outfile::OutFile;
use survey::{Baseline, Frame, Protocol};

use super::{Written, reason};
use crate::args::Export;
use crate::failure::Failure;
use crate::output::Printer;
use crate::records::case_folder::{self, cell};

/// Writes the tables and reports their paths.
pub(super) fn tables(
    session: &SessionParts,
    export: &Export,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let header = session.header();
    let baseline = session.baseline()?;
    let say = |printer: &mut Printer<_>, what, path: &Path, frames: usize| {
        Written::table(what, path, frames, header).report(printer)
    };
    let existing = export.replacing.existing();
    // no companion file can be written next to a device or a pipe
    let companions = (!outfile::is_stream(&export.out)).then(|| CompanionFiles::of(&export.out));
    let mut file = OutFile::create(&export.out, existing)?;
    file.put(frames_heading(header.protocol.len()).as_bytes())?;
    let mut case = match &companions {
        Some(companions) => {
            outfile::check(&companions.baseline, existing)?;
            outfile::make_folder(&companions.case, existing)?;
            let mut case = OutFile::create(&companions.case.join("frames.csv"), existing)?;
            case.put(case_folder::heading(&header.protocol).as_bytes())?;
            Some(case)
        }
        None => None,
    };
    let (mut written, mut current) = (0, None);
    let mut last = header.first_sequence - 1;
    let damaged = super::each_frame(session, printer.is_terminal(), |record| {
        file.put(frame_row(&record).as_bytes())?;
        if let Some(case) = &mut case {
            let label = format!("f{}", record.frame.sequence);
            case.put(case_folder::row(&label, &record.frame.readings).as_bytes())?;
        }
        current.get_or_insert(record.frame.settings.current);
        last = record.frame.sequence;
        written += 1;
        Ok(())
    })?;
    say(printer, "frames", &file.finish()?, written)?;
    if let (Some(companions), Some(case)) = (&companions, case) {
        match &baseline {
            Some(baseline) => {
                let table = baseline_table(&header.protocol, baseline);
                outfile::write(&companions.baseline, existing, table.as_bytes())?;
                say(printer, "baseline", &companions.baseline, baseline.frames)?;
            }
            // the baseline of an earlier export is not that of these frames
            None => outfile::remove(&companions.baseline, existing)?,
        }
        case.finish()?;
        case_folder::write(
            &companions.case,
            header,
            current,
            baseline.as_ref(),
            &export.asked.geometry,
            existing,
        )?;
        say(printer, "case", &companions.case, written)?;
    }
    super::finish(session, damaged, last, export)
}

/// The companion files of a table of frames.
struct CompanionFiles {
    baseline: PathBuf,
    case: PathBuf,
}

impl CompanionFiles {
    fn of(frames: &Path) -> Self {
        Self {
            baseline: frames.with_extension("baseline.csv"),
            case: frames.with_extension("case"),
        }
    }
}

/// Columns of the table of frames: summary values first, then the voltages. Electrodes count from 0 in files.
fn frames_heading(readings: usize) -> String {
    let mut heading = String::from(
        "sequence,wall_utc,monotonic_s,duration_s,simulated,current_A,overloads,not_measured,compliance,missing",
    );
    for reading in 0..readings {
        let _infallible = write!(heading, ",m{reading}_V");
    }
    heading.push('\n');
    heading
}

fn frame_row(record: &FrameRecord) -> String {
    let frame = &record.frame;
    let mut row = format!(
        "{},{},{},{},{},{},{},{},{},{}",
        frame.sequence,
        table_time(frame.wall),
        frame.monotonic.as_secs_f64(),
        frame.duration.as_secs_f64(),
        frame.simulated,
        frame.settings.current.0,
        record.quality.overloads,
        record.quality.not_measured,
        electrodes(frame),
        missing(frame),
    );
    for reading in &frame.readings {
        row.push(',');
        row.push_str(&cell(*reading));
    }
    row.push('\n');
    row
}

/// The electrodes at which the source was in compliance, from 0.
pub(super) fn electrodes(frame: &Frame) -> String {
    let numbers = frame.compliance.iter();
    let numbers: Vec<String> = numbers.map(|electrode| electrode.0.to_string()).collect();
    numbers.join(" ")
}

/// The missing readings of a frame, each with the reason.
pub(super) fn missing(frame: &Frame) -> String {
    let readings = frame.readings.iter().enumerate();
    let missing: Vec<String> = readings
        .filter_map(|(index, &reading)| Some(format!("m{index}:{}", reason(reading)?)))
        .collect();
    missing.join(" ")
}

fn baseline_table(protocol: &Protocol, baseline: &Baseline) -> String {
    let mut table = String::from("reading,source,sink,v_plus,v_minus,flag,mean_V,deviation_V\n");
    for (index, (measurement, reading)) in protocol
        .measurements()
        .iter()
        .zip(&baseline.readings)
        .enumerate()
    {
        let deviation = baseline.deviation.get(index).copied().flatten();
        let _infallible = writeln!(
            table,
            "m{index},{},{},{},{},{},{},{}",
            measurement.drive.plus.0,
            measurement.drive.minus.0,
            measurement.sense.plus.0,
            measurement.sense.minus.0,
            reason(*reading).unwrap_or("ok"),
            cell(*reading),
            deviation
                .map(|deviation| deviation.to_string())
                .unwrap_or_default(),
        );
    }
    table
}
