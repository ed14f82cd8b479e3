//! `tactus quantities`: numbers that describe the maps of a recording, for spans of time or for each frame.

use std::cell::Cell;
use std::io::Write;
use std::path::Path;

use chrono::{DateTime, Utc};
use imaging::quantities::{
    FrameQuantities, KPA_PER_MMHG, LoadUnit, Quantifier, Quantity, QuantityRow, RegionQuantities,
    Rows, STORED_S, joined, rounded, stored,
};
use imaging::recorded::{RecordedFrame, Recording, SessionParts, table_time};
use serde::Serialize;

use crate::args::{Global, Quantities};
use crate::failure::Failure;
use crate::maps::compared::Compared;
use crate::maps::follower::Follower;
use crate::maps::reconstruction::Reconstruction;
use crate::maps::recording::{self, Thinning};
use crate::output::Printer;
use crate::output::progress::progress;
use crate::output::time::{local, utc};
use crate::session_files;

/// A line of `quantities --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct SpanLine<'a> {
    begin: String,
    region: &'a str,
    quantity: Quantity,
    unit: String,
    min: f64,
    mean: f64,
    max: f64,
    frames: u64,
    known: u64,
}

/// A line of `quantities --each-frame --json`.
#[derive(Debug, Serialize)]
struct FrameLine {
    frame: u64,
    wall: Option<String>,
    #[serde(flatten)]
    quantities: FrameQuantities,
}

/// Computes the quantities of each frame and prints what was asked for.
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
    let reconstruction = Reconstruction::asked(&requested.asked, &recording)?;
    let mut quantifier = reconstruction.quantifier(&recording)?;
    check_region(requested.region.as_deref(), &quantifier, &recording)?;
    if requested.mmhg && quantifier.unit() == LoadUnit::RelativeLoss {
        return Err(not_calibrated(&recording.name));
    }
    if requested.each_frame {
        quantifier = quantifier.with_deviation(reconstruction.deviation());
    }
    let mut follower = Follower::of(&reconstruction, &requested.asked.tracked, &recording)?;
    let mut output = Output::new(requested);
    if !requested.csv {
        for remark in &reconstruction.remarks {
            printer.text(remark)?;
        }
    }
    let count = recording::count(&recording, source, Thinning::NONE)?;
    let progress = progress(count.map(|count| count as u64), printer.is_terminal());
    let damaged = Cell::new(0);
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
        let (frame, _) = compared.quantities(&reconstruction, &mut quantifier)?;
        progress.suspend(|| output.take(&recorded, frame, printer))?;
        progress.inc(1);
    }
    progress.finish_and_clear();
    output.finish(printer)?;
    recording::check_undamaged(damaged.get(), &recording.name)
}

/// The rows stored with a session, joined to the requested spans, and the number of damaged lines; `None` where they do not
/// answer what is asked.
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
    let folder = path.parent().unwrap_or(Path::new("."));
    let rows = stored(folder, session)?;
    Ok(rows.map(|(rows, damaged)| (joined(&rows, span_s), damaged)))
}

fn print_stored(
    requested: &Quantities,
    rows: &[QuantityRow],
    damaged: usize,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    if let Some(name) = &requested.region
        && !rows.iter().any(|row| row.region == *name)
    {
        let mut known: Vec<&str> = Vec::new();
        for row in rows {
            if !known.contains(&row.region.as_str()) {
                known.push(&row.region);
            }
        }
        return Err(no_region(&requested.from.source, name, &known));
    }
    if requested.mmhg && rows.iter().any(|row| row.of == LoadUnit::RelativeLoss) {
        return Err(not_calibrated(&requested.from.source));
    }
    if damaged > 0 {
        eprintln!(
            "tactus: {damaged} of the stored minutes are damaged and left out; --recompute computes them from the frames"
        );
    }
    let mut output = Output::new(requested);
    for rows in rows.chunk_by(|a, b| a.begin_s == b.begin_s) {
        output.spans(rows, printer)?;
    }
    Ok(())
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

struct Output<'a> {
    requested: &'a Quantities,
    rows: Rows,
    begun: bool,
    /// The last frame, for the summary.
    last: Option<FrameQuantities>,
}

impl<'a> Output<'a> {
    fn new(requested: &'a Quantities) -> Self {
        Self {
            requested,
            rows: Rows::new(requested.span_s()),
            begun: false,
            last: None,
        }
    }

    fn take(
        &mut self,
        recorded: &RecordedFrame,
        frame: FrameQuantities,
        printer: &mut Printer<impl Write>,
    ) -> Result<(), Failure> {
        if self.requested.each_frame {
            self.frame(recorded, &frame, printer)?;
        } else {
            let at_s = recorded.at_s();
            let ended = self.rows.take(at_s, &frame);
            self.spans(&ended, printer)?;
        }
        self.last = Some(frame);
        Ok(())
    }

    fn finish(mut self, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
        let ended = self.rows.end();
        self.spans(&ended, printer)?;
        let Some(last) = self.last.filter(|_| !self.requested.csv) else {
            return Ok(());
        };
        for region in last
            .regions
            .iter()
            .filter(|region| self.requested.has(&region.name))
        {
            let at = |place: Option<[f64; 2]>| {
                place.map_or(String::new(), |[x, y]| format!(" at ({x:.0}, {y:.0}) mm"))
            };
            let shown = |quantity| self.requested.shown(quantity, last.unit, &region.values);
            printer.text(&format!(
                "{}: largest dose {}{}, longest unrelieved time at the end {}{}",
                region.name,
                shown(Quantity::Dose),
                at(region.dose_mm),
                shown(Quantity::Unrelieved),
                at(region.unrelieved_mm),
            ))?;
        }
        Ok(())
    }

    /// The rows of one span.
    fn spans(
        &mut self,
        rows: &[QuantityRow],
        printer: &mut Printer<impl Write>,
    ) -> Result<(), Failure> {
        let requested = self.requested;
        let chosen: Vec<&QuantityRow> = rows
            .iter()
            .filter(|row| requested.has(&row.region) && requested.wants(row.quantity))
            .collect();
        if requested.csv {
            self.heading(
                "begin_utc,region,quantity,unit,min,mean,max,frames,known\n",
                printer,
            )?;
        }
        for row in &chosen {
            let convert = |value| requested.convert(row.quantity, row.of, value);
            let begin = DateTime::<Utc>::from_timestamp(row.begin_s, 0).unwrap_or_default();
            let line = SpanLine {
                begin: utc(begin),
                region: &row.region,
                quantity: row.quantity,
                unit: requested.unit(row.quantity, row.of),
                min: convert(row.min),
                mean: convert(row.mean),
                max: convert(row.max),
                frames: row.frames,
                known: row.known,
            };
            if requested.csv {
                let text = format!(
                    "{},{},{},{},{},{},{},{},{}\n",
                    table_time(begin),
                    line.region,
                    line.quantity.name(),
                    line.unit,
                    line.min,
                    line.mean,
                    line.max,
                    line.frames,
                    line.known
                );
                printer.raw(text.as_bytes())?;
            } else if printer.is_json() {
                printer.record(&line, |_| String::new())?;
            }
        }
        if requested.csv || printer.is_json() {
            return Ok(());
        }
        if !chosen.is_empty() {
            self.heading(&requested.table_heading(chosen[0].of), printer)?;
        }
        for of_region in chosen.chunk_by(|a, b| a.region == b.region) {
            printer.text(&requested.table_row(of_region))?;
        }
        Ok(())
    }

    fn frame(
        &mut self,
        recorded: &RecordedFrame,
        frame: &FrameQuantities,
        printer: &mut Printer<impl Write>,
    ) -> Result<(), Failure> {
        let requested = self.requested;
        if requested.csv {
            let time = recorded.wall.map(table_time).unwrap_or_default();
            self.heading(
                "frame,time_utc,region,quantity,unit,value,sd,known\n",
                printer,
            )?;
            for region in frame
                .regions
                .iter()
                .filter(|region| requested.has(&region.name))
            {
                for quantity in Quantity::ALL.into_iter().filter(|q| requested.wants(*q)) {
                    let Some(value) = region.values.get(quantity) else {
                        continue;
                    };
                    let convert = |value| requested.convert(quantity, frame.unit, value);
                    let text = format!(
                        "{},{},{},{},{},{},{},{}\n",
                        recorded.sequence,
                        time,
                        region.name,
                        quantity.name(),
                        requested.unit(quantity, frame.unit),
                        convert(value),
                        region
                            .deviations
                            .get(quantity)
                            .map_or(String::new(), |sd| convert(sd).to_string()),
                        frame.known,
                    );
                    printer.raw(text.as_bytes())?;
                }
            }
            return Ok(());
        }
        let mut quantities = frame.clone();
        quantities
            .regions
            .retain(|region| requested.has(&region.name));
        for region in &mut quantities.regions {
            let kept = |quantity, value| {
                let value = requested.convert(quantity, frame.unit, value);
                requested.wants(quantity).then_some(value)
            };
            region.values = region.values.filter_map(kept);
            region.deviations = region.deviations.filter_map(kept);
        }
        let line = FrameLine {
            frame: recorded.sequence,
            wall: recorded.wall.map(utc),
            quantities,
        };
        printer.record(&line, |_| {
            let mut text = String::new();
            for region in frame
                .regions
                .iter()
                .filter(|region| requested.has(&region.name))
            {
                text.push_str(&requested.frame_sentence(recorded.sequence, region, frame));
                text.push('\n');
            }
            text
        })
    }

    fn heading(&mut self, text: &str, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
        if std::mem::replace(&mut self.begun, true) {
            return Ok(());
        }
        printer.raw(text.as_bytes())
    }
}

/// Width of a column for people.
const WIDTH: usize = 18;

/// What a column shows of a span.
#[derive(Debug, Clone, Copy)]
enum Of {
    Mean,
    Largest,
}

/// Quantities of a line for people, where none are chosen.
const SHOWN: [Quantity; 7] = [
    Quantity::Load,
    Quantity::Contact,
    Quantity::Ppi,
    Quantity::CentreX,
    Quantity::CentreY,
    Quantity::Unrelieved,
    Quantity::Known,
];

impl Quantities {
    fn span_s(&self) -> u32 {
        u32::try_from(self.every.as_secs()).unwrap_or(u32::MAX)
    }

    /// Whether something is asked that the stored rows do not answer.
    fn recomputes(&self) -> bool {
        let source = &self.from;
        self.recompute
            || self.each_frame
            || source.baseline.is_some()
            || source.negate
            || source.from.is_some()
            || source.to.is_some()
            || self.asked.differ()
    }

    fn has(&self, region: &str) -> bool {
        self.region.as_deref().is_none_or(|wanted| wanted == region)
    }

    fn wants(&self, quantity: Quantity) -> bool {
        self.quantities.is_empty() || self.quantities.contains(&quantity)
    }

    /// Whether a line for people shows it.
    fn shows(&self, quantity: Quantity) -> bool {
        match self.quantities.is_empty() {
            true => SHOWN.contains(&quantity),
            false => self.quantities.contains(&quantity),
        }
    }

    fn unit(&self, quantity: Quantity, of: LoadUnit) -> String {
        let unit = quantity.unit(of);
        match self.mmhg {
            true => unit.replace("kPa", "mmHg"),
            false => unit.to_owned(),
        }
    }

    fn convert(&self, quantity: Quantity, of: LoadUnit, value: f64) -> f64 {
        match self.mmhg && quantity.unit(of).contains("kPa") {
            true => value / KPA_PER_MMHG,
            false => value,
        }
    }

    fn shown(
        &self,
        quantity: Quantity,
        of: LoadUnit,
        values: &imaging::quantities::Values,
    ) -> String {
        values
            .get(quantity)
            .map_or("not known".to_owned(), |value| {
                let value = self.convert(quantity, of, value);
                format!("{} {}", rounded(value), self.unit(quantity, of))
            })
    }

    /// Columns of the table for people: the quantity, and which of smallest, mean and largest.
    fn columns(&self) -> Vec<(Quantity, Of)> {
        let of = |quantity: Quantity| match quantity {
            Quantity::Peak | Quantity::Ppi | Quantity::Dose | Quantity::Unrelieved => Of::Largest,
            _ => Of::Mean,
        };
        let shown = Quantity::ALL
            .into_iter()
            .filter(|quantity| self.shows(*quantity));
        shown.map(|quantity| (quantity, of(quantity))).collect()
    }

    fn table_heading(&self, of: LoadUnit) -> String {
        let mut text = format!("{:<26}  {:<10}", "begin", "region");
        for (quantity, _) in self.columns() {
            let title = match (quantity, self.unit(quantity, of).as_str()) {
                (Quantity::Known, _) => "known share".to_owned(),
                (counted, "1") => counted.name().to_owned(),
                (other, unit) => format!("{}, {unit}", other.name()),
            };
            text.push_str(&format!("  {title:>WIDTH$}"));
        }
        text.push('\n');
        text
    }

    /// The rows of a span and region: means, and the largest of what is judged by its largest value.
    fn table_row(&self, rows: &[&QuantityRow]) -> String {
        let Some(first) = rows.first() else {
            return String::new();
        };
        let begin = DateTime::<Utc>::from_timestamp(first.begin_s, 0).unwrap_or_default();
        let mut text = format!("{:<26}  {:<10}", local(begin), first.region);
        for (quantity, of) in self.columns() {
            let row = rows.iter().find(|row| row.quantity == quantity);
            let value = row.map_or("-".to_owned(), |row| {
                let value = match of {
                    Of::Mean => row.mean,
                    Of::Largest => row.max,
                };
                rounded(self.convert(quantity, row.of, value))
            });
            text.push_str(&format!("  {value:>WIDTH$}"));
        }
        text
    }

    fn frame_sentence(
        &self,
        sequence: u64,
        region: &RegionQuantities,
        frame: &FrameQuantities,
    ) -> String {
        let parts: Vec<String> = Quantity::ALL
            .into_iter()
            .filter(|quantity| self.shows(*quantity))
            .filter_map(|quantity| {
                let value = self.convert(quantity, frame.unit, region.values.get(quantity)?);
                let sd = region.deviations.get(quantity).map_or(String::new(), |sd| {
                    format!(" +- {}", rounded(self.convert(quantity, frame.unit, sd)))
                });
                let name = quantity.name();
                Some(match (quantity, self.unit(quantity, frame.unit).as_str()) {
                    (Quantity::Known, _) if value == 1.0 => format!("{name} yes"),
                    (Quantity::Known, _) => format!("{name} no"),
                    (_, "1") => format!("{name} {value}{sd}"),
                    (_, unit) => format!("{name} {}{sd} {unit}", rounded(value)),
                })
            })
            .collect();
        let values = match parts.is_empty() {
            true => "no quantities".to_owned(),
            false => parts.join(", "),
        };
        let reason = match &frame.reason {
            Some(reason) => format!("; not known: {reason}"),
            None => String::new(),
        };
        format!("frame {sequence}  {}: {values}{reason}", region.name)
    }
}
