//! Values of the last ten minutes, for strip charts.

use std::collections::VecDeque;

use imaging::quantities::{FrameQuantities, LoadUnit, Quantity};

/// Time that charts show, ms.
pub(crate) const SPAN_MS: i64 = 600_000;
/// Quantities of the whole sheet with a chart.
pub(crate) const CHARTED: [Quantity; 3] = [Quantity::Load, Quantity::Contact, Quantity::Peak];

/// The values of a frame; `None` for an unknown one.
#[derive(Debug, Clone, Copy)]
struct Sample {
    wall_ms: i64,
    values: [Option<f64>; CHARTED.len()],
}

/// The values of the frames of the last ten minutes.
#[derive(Debug, Clone, Default)]
pub(crate) struct History {
    samples: VecDeque<Sample>,
    unit: Option<LoadUnit>,
}

impl History {
    /// Adds a frame. If its unit differs from that of the earlier values, these are dropped, because a chart has one
    /// unit.
    pub(crate) fn add(&mut self, wall_ms: i64, quantities: Option<&FrameQuantities>) {
        let unit = quantities.map(|quantities| quantities.unit);
        if unit.is_some() && self.unit != unit {
            self.samples.clear();
            self.unit = unit;
        }
        let sheet = quantities.and_then(|quantities| quantities.regions.first());
        let values = CHARTED.map(|quantity| sheet?.values.get(quantity));
        self.samples.push_back(Sample { wall_ms, values });
        while self
            .samples
            .front()
            .is_some_and(|first| first.wall_ms < wall_ms - SPAN_MS)
        {
            self.samples.pop_front();
        }
    }

    /// Unit of the values; `None` before the first.
    pub(crate) fn unit(&self) -> Option<LoadUnit> {
        self.unit
    }

    /// The largest value in each of `columns` equal spans of the ten minutes before `now_ms`, the oldest first; `None`
    /// for a span without a known value. A frame that is later than now, because of another clock, counts as now.
    pub(crate) fn columns(&self, chart: usize, columns: usize, now_ms: i64) -> Vec<Option<f64>> {
        let mut largest = vec![None; columns];
        let columns = columns as i64;
        for sample in &self.samples {
            let age_ms = (now_ms - sample.wall_ms).max(0);
            let back = age_ms * columns / SPAN_MS;
            let (Some(value), true) = (sample.values[chart], back < columns) else {
                continue;
            };
            let column = &mut largest[(columns - 1 - back) as usize];
            *column = Some(column.map_or(value, |before: f64| before.max(value)));
        }
        largest
    }
}
