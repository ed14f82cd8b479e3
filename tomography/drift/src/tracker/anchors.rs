//! Baselines kept from a day, a week and a month ago: what changed too slowly for the tracked baseline shows against them.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use super::bits;
use crate::basis::Basis;
use crate::model::DriftModel;
use crate::whitened::LOADED;

/// Ages of the anchors that are compared, days.
const AGES: [f64; 3] = [1.0, 7.0, 30.0];
/// Age of the one that tells a load from age, days: over a week a crack changes as much as a load.
const LOAD_AGE: f64 = 1.0;
/// Age beyond which it tells nothing any more, days: while a load lies there, no later baseline is kept.
const LOAD_OLDEST: f64 = 2.0;
/// Age at which an anchor is dropped, days.
const OLDEST: f64 = 31.0;
/// Pace of ageing, in units of the pace that the sheet has, that a slow loss must exceed to be a load.
const LOAD_PACE: f64 = 3.0;
const DAY_S: f64 = 86_400.0;

/// A place that changed slowly: a load or age, which readings cannot tell apart.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AnchorAlarm {
    /// Age of the baseline that shows it, days.
    pub age_days: f64,
    /// Centre of the best disc of 20 or 50 mm, m.
    pub centre: [f64; 2],
    /// Its diameter, m.
    pub diameter: f64,
    /// Change of ln conductance in it.
    pub change: f64,
    /// Improvement of chi squared.
    pub score: f64,
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
    /// Whether they are of data of this many rows.
    pub(super) fn fits(&self, rows: usize) -> bool {
        self.kept.iter().all(|anchor| anchor.baseline.len() == rows)
    }

    /// Keeps a baseline once a day.
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

    /// The clock was set back to this time: baselines that were kept later are of this time at the latest.
    pub(super) fn set_back(&mut self, at_s: f64) {
        for anchor in &mut self.kept {
            anchor.at_s = anchor.at_s.min(at_s);
        }
    }

    /// The strongest alarm of a frame without known load.
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

    /// A loss since one of the baselines that would be a load even if the sheet aged [`LOAD_PACE`] times as fast as it does: the
    /// baseline and its time, s. Later ones hold a part of the load and are dropped.
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
