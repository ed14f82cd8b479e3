//! Whether a recording has a map whose quantities are known.

use imaging::quantities::{FrameQuantities, Quantity, QuantityRow};
use imaging::recorded::RecordedFrame;

/// Why the map of a frame cannot be used, or why it has none; `None` if its quantities are known.
pub(crate) fn unusable(quantities: &FrameQuantities) -> Option<String> {
    let sheet = quantities.regions.first();
    let has_values = sheet.is_some_and(|sheet| sheet.values.get(Quantity::Load).is_some());
    (!has_values).then(|| quantities.reason.clone().unwrap_or_default())
}

/// Why no row that is stored with a session has a value, and what to do; `None` if one has. `left_out`: text on the
/// omitted rows.
pub(crate) fn none_stored(session: &str, rows: &[QuantityRow], left_out: &str) -> Option<String> {
    let has_values = rows.iter().any(|row| row.quantity != Quantity::Known);
    (!has_values).then(|| {
        format!(
            "no stored minute of {session} has a map that could be used{left_out}; `tactus quantities {session} --recompute` \
             computes them from the frames, or prints why it cannot"
        )
    })
}

/// Finds out whether a recording has a usable map.
#[derive(Debug, Default)]
pub(crate) struct UsableMaps {
    found: bool,
    /// The first frame without a usable map, and why it has none.
    without: Option<String>,
}

impl UsableMaps {
    /// Checks the next frame.
    pub(crate) fn take(&mut self, recorded: &RecordedFrame, quantities: &FrameQuantities) {
        match unusable(quantities) {
            None => self.found = true,
            Some(why) => {
                let frame = || format!("frame {}: {why}", recorded.label);
                self.without.get_or_insert_with(frame);
            }
        }
    }

    /// Why no frame of the recording has a usable map, and what to do; `None` if one has.
    pub(crate) fn none(&self, recording: &str) -> Option<String> {
        if self.found {
            return None;
        }
        Some(match &self.without {
            Some(first) => format!(
                "no frame of {recording} has a map that can be used; {first}; `tactus replay` gives the reason for each frame"
            ),
            None => format!("{recording} has no readable frame"),
        })
    }
}
