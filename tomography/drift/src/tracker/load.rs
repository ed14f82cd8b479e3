//! Load state of the sheet: a ledger with the innovation before each load came, and rules for the release of loads.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use super::bits;
use crate::disc::Disc;

/// Share of a load's largest signal below which the remaining signal is attributed to compression set, creep and
/// ageing, not to a load.
pub(crate) const REST: f64 = 0.02;

/// The loads on the sheet.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Ledger {
    /// The innovation before each present load came; the first entry is that of the empty sheet. No entries without a
    /// load.
    entries: Vec<Entry>,
    /// Innovation of the largest load since the sheet was empty.
    #[serde(with = "bits")]
    peak: Vec<f64>,
    /// Whether the present load came by a step, not gradually.
    pub(crate) by_event: bool,
    /// Whether all loads were removed and only their remaining signal is left.
    pub(crate) rest: bool,
    /// Whether a load came with the previous frame and is not confirmed as a disc: it may have come during that frame,
    /// so that the rest of its change appears in this frame.
    #[serde(default)]
    pub(crate) comes: bool,
    /// Whether a user declared the sheet loaded: only a user's order releases it.
    #[serde(default)]
    pub(crate) held: bool,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Entry {
    #[serde(with = "bits")]
    before: Vec<f64>,
    /// Position of the load; `None` if the load came gradually.
    place: Option<Disc>,
}

impl Ledger {
    /// Whether all entries have this number of rows.
    pub(super) fn fits(&self, rows: usize) -> bool {
        let entries = self.entries.iter().all(|entry| entry.before.len() == rows);
        entries && [0, rows].contains(&self.peak.len())
    }

    /// Whether the sheet is loaded.
    pub(crate) fn loaded(&self) -> bool {
        !self.entries.is_empty()
    }

    /// Number of loads on the sheet.
    pub(crate) fn loads(&self) -> usize {
        self.entries.len()
    }

    /// The sheet was empty and is now loaded.
    pub(crate) fn begin(&mut self, rows: usize, by_event: bool) {
        self.entries = vec![Entry {
            before: vec![0.0; rows],
            place: None,
        }];
        self.peak = Vec::new();
        (self.by_event, self.rest, self.comes) = (by_event, false, false);
    }

    /// Innovation before the load that came last; `None` if the sheet was empty.
    pub(crate) fn before_last(&self) -> Option<DVector<f64>> {
        let last = self.entries.last().filter(|_| self.entries.len() > 1)?;
        Some(DVector::from_column_slice(&last.before))
    }

    /// Sets the position of the load that came last.
    pub(crate) fn lies_at(&mut self, place: Disc) {
        if let Some(last) = self.entries.last_mut() {
            last.place = Some(place);
        }
    }

    /// Conductance was lost at this position: if a load is there, it grew or moved (foam creeps under a load), and its
    /// position is updated. False if no load is there.
    pub(crate) fn grew(&mut self, at: Disc) -> bool {
        let own = self.entries.iter_mut().find_map(|entry| {
            let place = entry.place.as_mut()?;
            let away = (place.centre[0] - at.centre[0]).hypot(place.centre[1] - at.centre[1]);
            (away < 0.5 * place.diameter).then_some(place)
        });
        match own {
            Some(place) => {
                place.centre = at.centre;
                true
            }
            None => false,
        }
    }

    /// Another load came; `before` is the innovation of the frame before.
    pub(crate) fn came(&mut self, before: &DVector<f64>, place: Disc) {
        self.entries.push(Entry {
            before: before.as_slice().to_vec(),
            place: Some(place),
        });
        (self.by_event, self.rest) = (true, false);
    }

    /// A load was removed: drops the entries from the one nearest to the present innovation on, but keeps the first.
    /// True if the nearest entry is that of the empty sheet.
    pub(crate) fn went(
        &mut self,
        now: &DVector<f64>,
        distance: impl Fn(&DVector<f64>) -> f64,
    ) -> bool {
        let nearest = self
            .entries
            .iter()
            .enumerate()
            .map(|(k, entry)| {
                (
                    k,
                    distance(&(now - DVector::from_column_slice(&entry.before))),
                )
            })
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map_or(0, |(k, _)| k);
        // the present state is that before load `nearest` came: the earlier loads remain to be released
        self.entries.truncate(nearest.max(1));
        nearest == 0
    }

    /// Updates the innovation of the largest load.
    pub(crate) fn follow(&mut self, now: &DVector<f64>) {
        let size: f64 = self.peak.iter().map(|value| value * value).sum();
        if now.norm_squared() > size {
            self.peak = now.as_slice().to_vec();
        }
    }

    /// Innovation of the largest load.
    pub(crate) fn peak(&self) -> DVector<f64> {
        DVector::from_column_slice(&self.peak)
    }

    /// The sheet is empty.
    pub(crate) fn release(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_load_goes_and_the_first_remains() {
        let mut ledger = Ledger::default();
        let vector = |value: f64| DVector::from_element(3, value);
        let distance = |off: &DVector<f64>| off.norm_squared();
        let disc = |x: f64| Disc {
            centre: [x, 0.1],
            diameter: 0.04,
            loss: 0.5,
        };
        ledger.begin(3, true);
        ledger.lies_at(disc(0.05));
        assert!(
            ledger.grew(disc(0.06)) && ledger.grew(disc(0.075)),
            "it creeps, and moves"
        );
        assert!(!ledger.grew(disc(0.15)));
        ledger.came(&vector(1.0), disc(0.15)); // a weight was on the sheet when this load came
        assert_eq!(ledger.loads(), 2);
        assert!(!ledger.went(&vector(1.1), distance));
        assert_eq!(ledger.loads(), 1);
        assert!(ledger.went(&vector(0.01), distance));
        assert!(
            ledger.loaded(),
            "released by its own rule, not by the step alone"
        );
        ledger.release();
        assert!(!ledger.loaded());
    }
}
