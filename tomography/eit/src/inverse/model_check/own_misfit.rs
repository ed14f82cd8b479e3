//! The misfit of a map: the difference between the measured change and the change predicted from the map's conductance.
//! The misfit of a learned map is compared with that of held-out cases, which were not used in training.
//!
//! The prediction is a full solution: a linear one leaves twice as much of strong loads unexplained. The misfit depends
//! on the size of the change: noise dominates in small changes, saturated outputs in large ones. Therefore each class
//! of sizes has its own limit. Loads outside of the region are judged in the same way: a learned method shows them
//! inside the region, where they are wrong.
//!
//! Sizes are those of the folded data: the rotated sum of each pair of reciprocal twins, (a + b) / sqrt 2 at equal
//! currents. An equal change of both twins is multiplied by sqrt 2 in the sum, their noise is not.

use serde::{Deserialize, Serialize};
use survey::{Doubt, Reading};

use super::{Change, ModelCheck};
use crate::inverse::learned::network::FAMILIAR_SHARE;

/// Ratio of the change of the readings to its noise (both rms) below which a map is not judged.
const ABOVE_NOISE: f64 = 3.0;
/// Ratio of the noise to that of the training above which a map is not judged: the map then shows noise that did not
/// occur in training.
const MORE_NOISE: f64 = 2.0;
/// Smallest conductance of a triangle as a share of the unloaded one: learned maps can show losses of 100 % and more.
const LEAST: f64 = 1e-3;
/// Largest number of classes of sizes, and smallest number of cases in a class.
const CLASSES: usize = 4;
const FEWEST: usize = 100;

/// Shares of the change that a learned method's maps leave unexplained, on held-out cases (not used in training). Stored in the
/// metadata of a model file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OwnMisfit {
    /// Noise of the change of one reading (rms), relative to the largest reading of the baseline: white noise, plus drift if the training
    /// included it.
    pub noise: f64,
    /// Classes of changes, smallest first; all classes have equally many cases.
    pub classes: Vec<MisfitClass>,
}

/// Held-out cases with changes of similar size.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MisfitClass {
    /// Smallest change of its cases, relative to the largest reading of the baseline. A change is the rms of the rotated sums of
    /// reciprocal twins: sqrt 2 times the rms change of the readings.
    pub above: f64,
    /// Number of cases.
    pub cases: usize,
    /// Median share of the change that their maps leave unexplained.
    pub median: f64,
    /// 99.9th percentile of that share; the largest share if there are fewer than a thousand cases.
    pub limit: f64,
}

/// The misfit of one map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leftover {
    /// The size of the change, as in [`MisfitClass::above`].
    pub change: f64,
    /// Share of the change that is unexplained (rms), after subtraction of the noise.
    pub share: f64,
}

impl OwnMisfit {
    /// Computes the classes from the maps of held-out cases; `None` if there are fewer than a hundred, or if a number
    /// is not finite.
    pub fn of(noise: f64, mut cases: Vec<Leftover>) -> Option<Self> {
        let count = (cases.len() / FEWEST).min(CLASSES);
        if count == 0 {
            return None;
        }
        cases.sort_unstable_by(|a, b| a.change.total_cmp(&b.change));
        let class = |index: usize| {
            let [first, last] = [index, index + 1].map(|k| cases.len() * k / count);
            let mut shares: Vec<f64> = cases[first..last].iter().map(|one| one.share).collect();
            shares.sort_unstable_by(f64::total_cmp);
            let most = (shares.len() as f64 * FAMILIAR_SHARE) as usize;
            MisfitClass {
                above: rounded(cases[first].change),
                cases: shares.len(),
                median: rounded(shares[shares.len() / 2]),
                limit: rounded(shares[most.min(shares.len() - 1)]),
            }
        };
        let misfit = Self {
            noise: rounded(noise),
            classes: (0..count).map(class).collect(),
        };
        misfit.is_sound().then_some(misfit)
    }

    /// Whether the numbers are plausible for held-out cases: finite, with a noise, and with classes from small to large
    /// changes.
    pub(crate) fn is_sound(&self) -> bool {
        self.noise > 0.0
            && self.noise.is_finite()
            && !self.classes.is_empty()
            && self.classes.is_sorted_by(|a, b| a.above <= b.above)
            && self.classes.iter().all(MisfitClass::is_sound)
    }

    /// The class of a change; `None` if the change is smaller than those of all cases.
    fn class(&self, change: f64) -> Option<&MisfitClass> {
        self.classes.iter().rfind(|class| class.above <= change)
    }
}

impl MisfitClass {
    fn is_sound(&self) -> bool {
        self.cases > 0
            && self.above >= 0.0
            && self.above.is_finite()
            && self.median >= 0.0
            && self.limit >= self.median
            && self.limit.is_finite()
    }
}

/// Rounds to four digits: these are restored exactly from text, while further digits would depend on the processor.
fn rounded(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

impl ModelCheck {
    /// The misfit of a map (relative change of conductance, one value per triangle of the region) to these readings.
    /// `None` if the change is not well above the noise or cannot be compared, or if the map is of another region.
    pub fn own_misfit(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
        map: &[f64],
    ) -> Option<Leftover> {
        self.left(&self.change(baseline, frame)?, map)
    }

    /// The doubt about a learned map whose misfit exceeds the limit from held-out cases.
    pub(super) fn own_doubt(
        &self,
        change: &Change,
        map: &[f64],
        usual: &OwnMisfit,
    ) -> Option<Doubt> {
        // a learned method gets no information about a reading that is missing together with its twin; the limits hold
        // for complete frames
        let complete = change.data.len() == self.linear.fold.rows();
        if !complete || change.noise > MORE_NOISE * usual.noise * self.largest {
            return None;
        }
        // before the forward solution, which takes milliseconds
        let class = usual.class(change.size / self.largest)?;
        let left = self.left(change, map)?;
        (left.share > class.limit).then_some(Doubt::OwnMisfit {
            share: left.share,
            limit: class.limit,
            cases: class.cases,
        })
    }

    fn left(&self, change: &Change, map: &[f64]) -> Option<Leftover> {
        if map.len() != self.region.len() || change.size <= ABOVE_NOISE * change.expected {
            return None;
        }
        let mut sigma = self.sigma0.clone();
        for (&triangle, value) in self.region.iter().zip(map) {
            sigma[triangle] *= (1.0 + value).max(LEAST);
        }
        let ohms = self.forward.readings(&sigma, &self.protocol).ok()?;
        let predicted = self.linear.change_to(ohms.as_slice());
        let fold = &self.linear.fold;
        let left = &change.data - fold.seen(&predicted, &change.prepared.missing).data;
        let error = (left.norm_squared() / left.len() as f64).sqrt();
        Some(Leftover {
            change: change.size / self.largest,
            share: change.share(error),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cases(count: usize) -> Vec<Leftover> {
        let case = |k: usize| Leftover {
            change: k as f64,
            share: 1e-3 * (k * 7 % count) as f64,
        };
        (0..count).map(case).collect()
    }

    #[test]
    fn too_few_cases_make_no_limit() {
        assert!(OwnMisfit::of(1.0, cases(FEWEST - 1)).is_none());
        assert_eq!(
            OwnMisfit::of(1.0, cases(FEWEST)).map(|one| one.classes.len()),
            Some(1)
        );
    }

    #[test]
    fn numbers_that_are_not_finite_make_no_limit() {
        assert!(OwnMisfit::of(f64::NAN, cases(FEWEST)).is_none());
        assert!(OwnMisfit::of(0.0, cases(FEWEST)).is_none());
        for wrong in [f64::NAN, f64::INFINITY] {
            let mut shares = cases(FEWEST);
            shares[7].share = wrong;
            assert!(OwnMisfit::of(1.0, shares).is_none(), "{wrong}");
        }
    }

    #[test]
    fn each_size_of_change_has_its_class() {
        let misfit = OwnMisfit::of(1.0, cases(403)).unwrap();
        let counts: Vec<usize> = misfit.classes.iter().map(|class| class.cases).collect();
        assert_eq!(counts, [100, 101, 101, 101]);
        assert_eq!(misfit.class(99.5).unwrap().above, 0.0);
        assert_eq!(misfit.class(100.0).unwrap().above, 100.0);
        assert_eq!(misfit.class(1e9).unwrap().above, 302.0);
        assert!(misfit.class(-1.0).is_none());
        // the largest share of each class
        let most = |class: &MisfitClass| {
            let first = class.above as usize;
            let of_class = &cases(403)[first..first + class.cases];
            of_class.iter().map(|one| one.share).fold(0.0, f64::max)
        };
        for class in &misfit.classes {
            assert!((class.limit - most(class)).abs() < 1e-9, "{class:?}");
        }
    }
}
