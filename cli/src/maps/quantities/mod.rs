//! `tactus quantities`: numbers that describe the maps of a recording, for spans of time or for each frame.

mod output;
pub(crate) mod usable;
mod words;

use std::cell::Cell;
use std::io::Write;
use std::path::Path;

use imaging::quantities::{
    LoadUnit, Quantifier, QuantityRow, STORED_S, joined, keep_newest_unit, stored,
};
use imaging::recorded::{Origin, Recording, SessionParts};
use logbook::LogbookError;

use crate::args::{Global, Quantities};
use crate::failure::Failure;
use crate::maps::compared::Compared;
use crate::maps::follower::Follower;
use crate::maps::quantities::output::Output;
use crate::maps::quantities::usable::UsableMaps;
use crate::maps::reconstruction::Reconstruction;
use crate::maps::recording::{self, Thinning};
use crate::options::duration::display_span;
use crate::output::Printer;
use crate::output::progress::progress;
use crate::session_files;

/// Computes the quantities of each frame and prints the requested ones.
pub(crate) fn run(
    global: &Global,
    requested: &Quantities,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let source = &requested.from;
    if let Some((rows, damaged)) = stored_rows(global, requested)? {
        return print_stored(requested, &rows, damaged, printer);
    }
    let recording = recording::open(global, source, requested.asked.geometry.electrodes)?;
    let reconstruction = Reconstruction::new(&requested.asked, &recording)?;
    let mut quantifier = reconstruction.quantifier(&recording)?;
    check_region(requested.region.as_deref(), &quantifier, &recording)?;
    if requested.mmhg && quantifier.unit() == LoadUnit::RelativeLoss {
        return Err(not_calibrated(&recording.name));
    }
    if requested.each_frame {
        quantifier = quantifier.with_deviation(reconstruction.deviation());
    }
    let mut follower = Follower::of(&reconstruction, &requested.asked.tracked, &recording)?;
    let has_times = matches!(recording.origin, Origin::Session(_));
    if let Some(every) = requested.every
        && !has_times
    {
        return Err(Failure::Usage(format!(
            "--every {} has no effect: the frames of {} have no times, and all of them are one span; --each-frame \
             prints the values of each frame",
            display_span(every),
            recording.name
        )));
    }
    let mut output = Output::new(requested, has_times);
    if !requested.csv {
        for remark in &reconstruction.remarks {
            printer.text(remark)?;
        }
    }
    let count = recording::count(&recording, source, Thinning::NONE)?;
    let progress = progress(count.map(|count| count as u64), printer.is_terminal());
    let damaged = Cell::new(0);
    let mut usable = UsableMaps::default();
    for (recorded, asked) in recording::frames(&recording, source, Thinning::NONE, &damaged)? {
        if !asked {
            if let Some(follower) = &mut follower {
                follower.pass(&recorded)?;
            }
            continue;
        }
        let followed = match &mut follower {
            Some(follower) => Some(follower.follow(&recorded)?),
            None => None,
        };
        let compared = Compared::new(&recording, &recorded, followed.as_ref());
        let at_s = recorded.time_s(requested.asked.tracked.period_s);
        let (frame, _) = compared.quantities(&reconstruction, &mut quantifier, at_s)?;
        usable.take(&recorded, &frame);
        progress.suspend(|| output.take(&recorded, frame, printer))?;
        progress.inc(1);
    }
    progress.finish_and_clear();
    output.finish(printer)?;
    if let Some(why) = usable.none(&recording.name) {
        return Err(Failure::Failed(why));
    }
    recording::check_undamaged(damaged.get(), &recording.name)
}

/// The rows stored with a session, joined to the requested spans, and the number of damaged lines; `None` if they are
/// not sufficient for the request.
fn stored_rows(
    global: &Global,
    requested: &Quantities,
) -> Result<Option<(Vec<QuantityRow>, usize)>, Failure> {
    let source = &requested.from;
    let span_s = requested.span_s();
    if requested.recomputes() || !span_s.is_multiple_of(STORED_S) {
        return Ok(None);
    }
    if Path::new(&source.source).is_dir() {
        return Ok(None);
    }
    let path = session_files::session_file(global, &source.source)?;
    let parts = SessionParts::open(&path)?;
    let session = parts.header().session();
    let folder = logbook::folder_of(&path);
    let rows = stored(folder, session)?;
    Ok(rows.map(|(rows, damaged)| (joined(&rows, span_s), damaged)))
}

fn print_stored(
    requested: &Quantities,
    rows: &[QuantityRow],
    damaged: usize,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let session = &requested.from.source;
    if rows.is_empty() {
        return Err(Failure::Failed(format!(
            "no stored minute of {session} can be read ({damaged} are damaged); --recompute computes the quantities from the frames"
        )));
    }
    if let Some(name) = &requested.region
        && !rows.iter().any(|row| row.region == *name)
    {
        return Err(no_region(session, name, &regions(rows)));
    }
    if requested.mmhg && rows.iter().any(|row| row.of == LoadUnit::RelativeLoss) {
        return Err(not_calibrated(session));
    }
    if damaged > 0 {
        eprintln!(
            "tactus: {damaged} of the stored minutes are damaged and left out; --recompute computes them from the frames"
        );
    }
    let mut output = Output::new(requested, true);
    for rows in rows.chunk_by(|a, b| (a.begin_s, a.of) == (b.begin_s, b.of)) {
        output.spans(rows, printer)?;
    }
    match usable::none_stored(session, rows, "") {
        Some(why) => Err(Failure::Failed(why)),
        None => Ok(()),
    }
}

/// The rows stored with a session in the unit of the newest row, and a text on the omitted rows for the end of a
/// sentence; `None` if the session has no rows.
///
/// # Errors
/// A file that cannot be read.
pub(crate) fn stored_in_one_unit(
    folder: &Path,
    session: &str,
) -> Result<Option<(Vec<QuantityRow>, String)>, LogbookError> {
    let Some((mut rows, damaged)) = stored(folder, session)? else {
        return Ok(None);
    };
    let mut left_out = match damaged {
        0 => String::new(),
        _ => format!("; {damaged} minutes are damaged and left out"),
    };
    if keep_newest_unit(&mut rows) > 0 {
        left_out.push_str("; those in another unit than the newest are left out");
    }
    Ok(Some((rows, left_out)))
}

/// The names of the regions in the rows, in the order of their first occurrence.
pub(crate) fn regions(rows: &[QuantityRow]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for row in rows {
        if !names.contains(&row.region.as_str()) {
            names.push(&row.region);
        }
    }
    names
}

fn check_region(
    name: Option<&str>,
    quantifier: &Quantifier,
    recording: &Recording,
) -> Result<(), Failure> {
    let known: Vec<&str> = quantifier.surface().regions().collect();
    match name {
        Some(name) if !known.contains(&name) => Err(no_region(&recording.name, name, &known)),
        _ => Ok(()),
    }
}

fn no_region(session: &str, name: &str, known: &[&str]) -> Failure {
    Failure::Usage(format!(
        "{session} has no region '{name}'; it has: {}",
        known.join(", ")
    ))
}

fn not_calibrated(session: &str) -> Failure {
    Failure::Usage(format!(
        "{session} has no calibration, so that its maps have no pressure; name one with --calibration FILE (`tactus-lab calibrate` \
         makes it), or leave out --mmhg"
    ))
}
