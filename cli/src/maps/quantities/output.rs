//! The lines of `tactus quantities`: as JSON, as CSV, and as text.

use std::io::Write;

use chrono::{DateTime, Utc};
use imaging::quantities::{FrameQuantities, LoadUnit, Quantity, QuantityRow, Rows};
use imaging::recorded::{RecordedFrame, table_time};
use imaging::tracking::seconds;
use serde::Serialize;

use crate::args::Quantities;
use crate::failure::Failure;
use crate::output::Printer;
use crate::output::time::utc;

/// A line of `quantities --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct SpanLine<'a> {
    /// `None` for frames without times.
    begin: Option<String>,
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

/// Prints rows of spans, or frames, as they are computed.
pub(crate) struct Output<'a> {
    requested: &'a Quantities,
    rows: Rows,
    /// Whether frames have times. Without them all frames are one span with an unknown begin.
    has_times: bool,
    /// Whether the heading of the CSV was printed.
    begun: bool,
    /// The unit in the last heading of the text output; a calibration that began during the session changes it.
    headed: Option<LoadUnit>,
    /// The last frame, for the summary.
    last: Option<FrameQuantities>,
}

impl<'a> Output<'a> {
    pub(crate) fn new(requested: &'a Quantities, has_times: bool) -> Self {
        Self {
            requested,
            has_times,
            rows: Rows::new(requested.span_s()),
            begun: false,
            headed: None,
            last: None,
        }
    }

    pub(crate) fn take(
        &mut self,
        recorded: &RecordedFrame,
        frame: FrameQuantities,
        printer: &mut Printer<impl Write>,
    ) -> Result<(), Failure> {
        if self.requested.each_frame {
            self.frame(recorded, &frame, printer)?;
        } else {
            let at_s = recorded.wall.map_or(0.0, seconds);
            let ended = self.rows.take(at_s, &frame);
            self.spans(&ended, printer)?;
        }
        self.last = Some(frame);
        Ok(())
    }

    pub(crate) fn finish(mut self, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
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
    pub(crate) fn spans(
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
        let has_times = self.has_times;
        let begin_of = |row: &QuantityRow| {
            let begin = DateTime::<Utc>::from_timestamp(row.begin_s, 0);
            begin.filter(|_| has_times)
        };
        for row in &chosen {
            let convert = |value| requested.convert(row.quantity, row.of, value);
            let begin = begin_of(row);
            let line = SpanLine {
                begin: begin.map(utc),
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
                    begin.map(table_time).unwrap_or_default(),
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
        if let Some(first) = chosen.first()
            && self.headed.replace(first.of) != Some(first.of)
        {
            printer.raw(requested.table_heading(first.of).as_bytes())?;
        }
        for of_region in chosen.chunk_by(|a, b| a.region == b.region) {
            let begin = of_region.first().and_then(|row| begin_of(row));
            printer.text(&requested.table_row(begin, of_region))?;
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
