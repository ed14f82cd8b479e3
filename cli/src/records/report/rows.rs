//! The quantities of a session in spans of time: the stored ones, or those of a selection of its frames.

use std::path::Path;

use imaging::quantities::{FrameQuantities, Quantity, QuantityRow, Rows, SHEET, STORED_S, joined};
use imaging::recorded::{Origin, Recording};

use crate::args::Report;
use crate::failure::Failure;
use crate::maps::compared::Compared;
use crate::maps::follower::Follower;
use crate::maps::quantities::{self, usable};
use crate::maps::reconstruction::Reconstruction;
use crate::output::progress::progress;

/// Most spans in a chart.
const SPANS: u32 = 480;
/// Most maps that are made for a session without stored quantities.
const MAPS: usize = 1500;

/// Rows of all regions and quantities.
pub(super) struct SessionRows {
    pub(super) rows: Vec<QuantityRow>,
    /// Length of a span, s.
    pub(super) span_s: u32,
    /// The source of the rows, as a sentence.
    pub(super) origin: String,
    /// Why no frame has a usable map; `None` if one has.
    pub(super) no_map: Option<String>,
}

impl SessionRows {
    pub(super) fn of(
        path: &Path,
        recording: &Recording,
        reconstruction: &Reconstruction,
        requested: &Report,
        on_terminal: bool,
    ) -> Result<Self, Failure> {
        if let (Origin::Session(header), false) = (&recording.origin, requested.asked.differ()) {
            let folder = logbook::folder_of(path);
            if let Some((rows, lost)) = quantities::stored_in_one_unit(folder, header.session())?
                && !rows.is_empty()
            {
                let begins = rows.iter().map(|row| row.begin_s);
                let ends = begins.clone().min().zip(begins.max());
                let span_s = span_s(ends.map_or(0, |(first, last)| last - first) as f64);
                return Ok(Self {
                    no_map: usable::none_stored(header.session(), &rows, &lost),
                    rows: joined(&rows, span_s),
                    span_s,
                    origin: format!(
                        "Quantities of every frame, stored by the daemon while it recorded{lost}."
                    ),
                });
            }
        }
        Self::computed(recording, reconstruction, requested, on_terminal)
    }

    fn computed(
        recording: &Recording,
        reconstruction: &Reconstruction,
        requested: &Report,
        on_terminal: bool,
    ) -> Result<Self, Failure> {
        let frames = recording.len()?;
        let every = frames.div_ceil(MAPS).max(1);
        let times = || {
            recording
                .frames()
                .filter_map(Result::ok)
                .filter_map(|frame| frame.wall)
        };
        let first = times().next();
        let last = times().last();
        let whole = first.zip(last).map_or(0.0, |(first, last)| {
            (last - first).as_seconds_f64().max(0.0)
        });
        // so that each span has a frame
        let span_s =
            span_s(whole.max(f64::from(STORED_S) * (every as f64 * whole / frames.max(1) as f64)));
        let mut follower = Follower::of(reconstruction, &requested.asked.tracked, recording)?;
        let mut quantifier = reconstruction.quantifier(recording)?;
        let mut collected = Rows::new(span_s);
        let mut rows = Vec::new();
        let bar = progress(Some(frames as u64), on_terminal);
        let (mut used, mut without) = (0, 0);
        let mut usable = usable::UsableMaps::default();
        for (index, frame) in recording.frames().filter_map(Result::ok).enumerate() {
            bar.inc(1);
            if !index.is_multiple_of(every) {
                if let Some(follower) = &mut follower {
                    follower.pass(&frame)?;
                }
                continue;
            }
            let at_s = frame.time_s(None);
            let followed = follower.as_mut().map(|follower| follower.follow(&frame));
            let computed = followed.transpose().and_then(|followed| {
                let compared = Compared::new(recording, &frame, followed.as_ref());
                compared.quantities(reconstruction, &mut quantifier, at_s)
            });
            let (quantities, map) = match computed {
                Ok(computed) => computed,
                // a frame that cannot be tracked, or whose map the calibration does not fit; a frame without a map is
                // `Ok` with `None`
                Err(Failure::Failed(why)) => {
                    let without = FrameQuantities {
                        reason: Some(why),
                        ..quantifier.take(at_s, None)
                    };
                    (without, None)
                }
                Err(other) => return Err(other),
            };
            usable.take(&frame, &quantities);
            let ended = at_s.map(|at_s| collected.take(at_s, &quantities));
            rows.extend(ended.unwrap_or_default());
            match map {
                Some(_) => used += 1,
                None => without += 1,
            }
        }
        rows.extend(collected.end());
        bar.finish_and_clear();
        let lost = match without {
            0 => String::new(),
            _ => format!(" {without} more have no map."),
        };
        Ok(Self {
            no_map: usable.none(&recording.name),
            rows,
            span_s,
            origin: format!(
                "The session has no stored quantities of this method; they were computed for this report from {used} of {frames} \
                 frames, evenly spaced: shorter events between these are not shown.{lost}"
            ),
        })
    }

    /// The rows of a quantity in a region.
    pub(super) fn of_region(
        &self,
        quantity: Quantity,
        region: &str,
    ) -> impl Iterator<Item = &QuantityRow> {
        self.rows
            .iter()
            .filter(move |row| row.quantity == quantity && row.region == region)
    }

    /// Number of frames that have a value of a quantity.
    pub(super) fn frames(&self, quantity: Quantity) -> u64 {
        let rows = self.of_region(quantity, SHEET);
        rows.map(|row| row.frames).sum()
    }

    /// The span of the whole sheet with the largest value of a quantity; `None` if no value is above zero.
    pub(super) fn worst(&self, quantity: Quantity) -> Option<&QuantityRow> {
        self.of_region(quantity, SHEET)
            .filter(|row| row.max > 0.0)
            .max_by(|a, b| a.max.total_cmp(&b.max))
    }

    /// The names of the regions, in the order of the rows.
    pub(super) fn regions(&self) -> Vec<&str> {
        quantities::regions(&self.rows)
    }
}

/// Length of the spans of a session, s: whole minutes, so that there are at most [`SPANS`].
fn span_s(whole_s: f64) -> u32 {
    let minutes = (whole_s / f64::from(SPANS * STORED_S)).ceil().max(1.0);
    STORED_S.saturating_mul(minutes as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_whole_minutes() {
        assert_eq!(span_s(0.0), 60);
        assert_eq!(span_s(8.0 * 3600.0), 60);
        assert_eq!(span_s(24.0 * 3600.0), 180);
        assert_eq!(span_s(30.0 * 86_400.0) % 60, 0);
    }
}
