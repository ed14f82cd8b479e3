//! Anchors: baselines kept from a day, a week and a month ago. They show changes that are too slow to show against the
//! tracked baseline.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use super::bits;
use crate::basis::Basis;
use crate::disc::loss_of;
use crate::model::DriftModel;
use crate::whitened::LOADED;

/// Ages of the anchors that a frame is compared with, days.
const AGES: [f64; 3] = [1.0, 7.0, 30.0];
/// Age of the anchor used to distinguish a load from ageing, days: over a week a crack changes as much as a load.
const LOAD_AGE: f64 = 1.0;
/// Largest age at which that anchor is used, days: while the sheet is loaded, no later baseline is kept.
const LOAD_OLDEST: f64 = 2.0;
/// Age at which an anchor is dropped, days.
const OLDEST: f64 = 31.0;
/// A slow loss counts as a load if it exceeds the drift at this multiple of the sheet's pace of ageing.
const LOAD_PACE: f64 = 3.0;
const DAY_S: f64 = 86_400.0;

/// A slow change at a position: a load or ageing, which readings cannot distinguish.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AnchorAlarm {
    /// Age of the anchor that shows the change, days.
    pub age_days: f64,
    /// Centre of the best disc of 20 or 50 mm, m.
    pub centre: [f64; 2],
    /// Diameter of the disc, m.
    pub diameter: f64,
    /// Linear change of conductance in the disc, negative for a loss; it is below -1 for a loss of more than 2/3.
    pub change: f64,
    /// Improvement of chi squared.
    pub score: f64,
}

impl AnchorAlarm {
    /// Share of the conductance that the disc lost, at most 1; negative for a gain, minus infinity for a perfect
    /// conductor.
    pub fn loss(&self) -> f64 {
        loss_of(self.change)
    }
}

/// The kept baselines, oldest first.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Anchors {
    kept: Vec<Anchor>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Anchor {
    #[serde(with = "bits::number")]
    at_s: f64,
    #[serde(with = "bits")]
    baseline: Vec<f64>,
}

impl Anchors {
    /// Whether all anchors have this number of rows.
    pub(super) fn fits(&self, rows: usize) -> bool {
        self.kept.iter().all(|anchor| anchor.baseline.len() == rows)
    }

    /// Keeps a baseline as an anchor, at most once a day.
    pub(crate) fn keep(&mut self, baseline: &DVector<f64>, at_s: f64) {
        if self
            .kept
            .last()
            .is_some_and(|last| at_s - last.at_s < DAY_S)
        {
            return;
        }
        self.kept.push(Anchor {
            at_s,
            baseline: baseline.as_slice().to_vec(),
        });
        self.kept
            .retain(|anchor| at_s - anchor.at_s <= OLDEST * DAY_S);
    }

    /// The clock was set back to this time: the times of later anchors are limited to it.
    pub(super) fn set_back(&mut self, at_s: f64) {
        for anchor in &mut self.kept {
            anchor.at_s = anchor.at_s.min(at_s);
        }
    }

    /// The strongest alarm of a frame without a known load.
    pub(crate) fn alarm(
        &self,
        model: &DriftModel,
        basis: &Basis,
        data: &DVector<f64>,
        pace: f64,
        at_s: f64,
    ) -> Option<AnchorAlarm> {
        let strongest = self.strongest(&AGES, model, basis, data, pace, at_s);
        strongest.map(|(_, alarm)| alarm)
    }

    /// A loss since an anchor that would be a load even if the sheet aged [`LOAD_PACE`] times as fast as it does.
    /// Returns the anchor's baseline and its time, s. Later anchors contain a part of the load and are dropped.
    pub(crate) fn load(
        &mut self,
        model: &DriftModel,
        basis: &Basis,
        data: &DVector<f64>,
        pace: f64,
        at_s: f64,
    ) -> Option<(DVector<f64>, f64)> {
        let (anchor, alarm) =
            self.strongest(&[LOAD_AGE], model, basis, data, LOAD_PACE * pace, at_s)?;
        if alarm.change >= 0.0 || alarm.age_days > LOAD_OLDEST {
            return None;
        }
        let (baseline, kept_s) = (DVector::from_column_slice(&anchor.baseline), anchor.at_s);
        self.kept.retain(|anchor| anchor.at_s <= kept_s);
        Some((baseline, kept_s))
    }

    fn strongest(
        &self,
        ages: &[f64],
        model: &DriftModel,
        basis: &Basis,
        data: &DVector<f64>,
        pace: f64,
        at_s: f64,
    ) -> Option<(&Anchor, AnchorAlarm)> {
        let mut worst: Option<(&Anchor, AnchorAlarm)> = None;
        for &age in ages {
            let old = self
                .kept
                .iter()
                .rev()
                .find(|anchor| at_s - anchor.at_s >= age * DAY_S);
            let Some(anchor) = old else {
                continue;
            };
            let days = (at_s - anchor.at_s) / DAY_S;
            let since = data - DVector::from_column_slice(&anchor.baseline);
            let variances = basis.growth.map(|growth| 2.0 + pace * pace * growth * days);
            let squares = basis.squares(&variances);
            let found = basis.load_tests(model, &basis.of(&since), &variances, &squares, 1);
            let Some(test) = found.first().filter(|test| test.score > LOADED) else {
                continue;
            };
            if worst.is_none_or(|(_, alarm)| test.score > alarm.score) {
                let alarm = AnchorAlarm {
                    age_days: days,
                    centre: test.place.centre,
                    diameter: test.place.diameter,
                    change: test.change,
                    score: test.score,
                };
                worst = Some((anchor, alarm));
            }
        }
        worst
    }
}
