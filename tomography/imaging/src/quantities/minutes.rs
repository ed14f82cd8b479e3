//! One row for each time span (a minute unless set otherwise), region and quantity: smallest, mean and largest value.

use serde::{Deserialize, Serialize};

use super::FrameQuantities;
use super::quantity::{LoadUnit, Quantity};

/// Summary of the values of a quantity in a time span.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct QuantityRow {
    /// Start of the span, s since the Unix epoch; a multiple of its length.
    pub begin_s: i64,
    /// Name of the region.
    pub region: String,
    /// The quantity.
    pub quantity: Quantity,
    /// Meaning of the map's values.
    pub of: LoadUnit,
    /// Smallest value.
    pub min: f64,
    /// Mean over the frames with a value.
    pub mean: f64,
    /// Largest value.
    pub max: f64,
    /// Number of frames with a value.
    pub frames: u64,
    /// Number of frames with a value whose map can be relied on.
    pub known: u64,
}

/// Summarises frames as rows.
#[derive(Debug, Clone)]
pub struct Rows {
    span_s: i64,
    begin_s: Option<i64>,
    rows: Vec<QuantityRow>,
}

impl Rows {
    /// Rows with spans of this length, s.
    pub fn new(span_s: u32) -> Self {
        Self {
            span_s: i64::from(span_s.max(1)),
            begin_s: None,
            rows: Vec::new(),
        }
    }

    /// Adds the next frame (time in s since the Unix epoch). If it begins another span, returns the rows of the span
    /// before, ordered by region. A quantity without a value in the span has no row.
    pub fn take(&mut self, at_s: f64, frame: &FrameQuantities) -> Vec<QuantityRow> {
        let begin_s = (at_s / self.span_s as f64).floor() as i64 * self.span_s;
        let ended = match self.begin_s.replace(begin_s) {
            Some(before) if before != begin_s => self.end(),
            _ => Vec::new(),
        };
        let mut at = 0;
        for region in &frame.regions {
            for quantity in Quantity::ALL {
                let Some(value) = region.values.get(quantity) else {
                    continue;
                };
                let same =
                    |row: &QuantityRow| row.quantity == quantity && row.region == region.name;
                // rows are sorted by region and quantity
                let found = self.rows[at..]
                    .iter()
                    .position(same)
                    .map(|after| at + after);
                let position = found.unwrap_or_else(|| {
                    self.rows.insert(
                        at,
                        QuantityRow {
                            begin_s,
                            region: region.name.clone(),
                            quantity,
                            of: frame.unit,
                            min: value,
                            mean: 0.0,
                            max: value,
                            frames: 0,
                            known: 0,
                        },
                    );
                    at
                });
                let row = &mut self.rows[position];
                row.min = row.min.min(value);
                row.max = row.max.max(value);
                row.frames += 1;
                row.known += u64::from(frame.known);
                row.mean += (value - row.mean) / row.frames as f64;
                at = position + 1;
            }
        }
        ended
    }

    /// Ends the current span and returns its rows.
    pub fn end(&mut self) -> Vec<QuantityRow> {
        std::mem::take(&mut self.rows)
    }
}
