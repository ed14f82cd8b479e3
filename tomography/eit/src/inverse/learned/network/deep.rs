//! The deep network in a reconstructor.

use crate::Novelty;
use crate::inverse::learned::network::{DeepNetwork, TrainingDistribution};
use crate::inverse::learned::trained::Respond;

/// Novelty of the familiar inputs: [`TrainingDistribution`] counts in multiples of their distance.
const FAMILIAR: f64 = 1.0;
/// Novelty above which a deep network refuses a frame.
const NOVELTY_LIMIT: f64 = 10.0;

/// A network and the distribution of its training inputs.
pub(crate) struct FamiliarDeep {
    pub(crate) network: DeepNetwork,
    pub(crate) familiar: TrainingDistribution,
}

impl Respond for FamiliarDeep {
    type Input = Vec<f32>;

    /// A reading that is missing like its reciprocal twin is replaced by its mean in training.
    fn input(&self, change: Vec<f64>, left: &[usize]) -> Vec<f32> {
        let mut input: Vec<f32> = change.iter().map(|value| *value as f32).collect();
        for &reading in left {
            input[reading] = self.familiar.usual(reading);
        }
        input
    }

    fn novelty(&self, input: &Vec<f32>) -> Option<(Novelty, f64)> {
        let novelty = Novelty {
            value: self.familiar.novelty(input),
            limit: FAMILIAR,
            measure: "Mahalanobis distance from the training inputs, divided by the distance within which 99.9 % of them lie",
        };
        Some((novelty, NOVELTY_LIMIT))
    }

    fn respond(&self, input: Vec<f32>) -> Result<Vec<f64>, String> {
        let values = self.network.predict(&input);
        Ok(values.into_iter().map(f64::from).collect())
    }
}
