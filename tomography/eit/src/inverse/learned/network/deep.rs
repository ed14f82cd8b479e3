//! The deep network as a reconstructor: normalises by Eq. 6, refuses inputs far from its training.

use std::sync::Arc;

use survey::{Map, Protocol, Reading};

use crate::inverse::learned::network::{DeepNetwork, TrainingDistribution};
use crate::inverse::learned::trained::Trained;
use crate::{Mesh, Novelty, ReconstructError, Reconstructor};

/// Novelty of the familiar inputs: [`TrainingDistribution`] counts in multiples of their distance.
const FAMILIAR: f64 = 1.0;
/// Novelty above which a deep network refuses a frame.
const NOVELTY_LIMIT: f64 = 10.0;

/// A deep network with the geometry and survey that it was trained for.
#[derive(Debug, Clone)]
pub struct DeepReconstructor {
    network: DeepNetwork,
    familiar: TrainingDistribution,
    trained: Trained,
}

impl DeepReconstructor {
    /// `network` must have one input per reading of the protocol and one output per triangle of the region; a loaded
    /// model has.
    pub(crate) fn new(
        network: DeepNetwork,
        familiar: TrainingDistribution,
        trained: Trained,
    ) -> Self {
        Self {
            network,
            familiar,
            trained,
        }
    }

    /// The network.
    pub fn network(&self) -> &DeepNetwork {
        &self.network
    }

    /// The normalised input and the number of missing readings. A missing reading is replaced by its reciprocal twin,
    /// or by its mean in training if the twin is missing too.
    fn input(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<(Vec<f32>, usize), ReconstructError> {
        let (change, left, masked) = self.trained.change(baseline, frame)?;
        let mut input: Vec<f32> = change.iter().map(|value| *value as f32).collect();
        for reading in left {
            input[reading] = self.familiar.usual(reading);
        }
        Ok((input, masked))
    }
}

impl Reconstructor for DeepReconstructor {
    fn method(&self) -> &str {
        &self.trained.method
    }

    fn protocol(&self) -> &Protocol {
        &self.trained.protocol
    }

    fn mesh(&self) -> &Arc<Mesh> {
        &self.trained.mesh
    }

    fn assumptions(&self) -> Vec<String> {
        self.trained.assumptions.clone()
    }

    fn noise_figure(&self) -> Option<f64> {
        self.trained.noise_figure
    }

    fn novelty(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Option<Novelty>, ReconstructError> {
        let (input, _) = self.input(baseline, frame)?;
        Ok(Some(Novelty {
            value: self.familiar.novelty(&input),
            limit: FAMILIAR,
            measure: "Mahalanobis distance from the training inputs, divided by the distance within which 99.9 % of them lie",
        }))
    }

    fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let (input, masked) = self.input(baseline, frame)?;
        let novelty = self.familiar.novelty(&input);
        self.trained.refuse_far(novelty, NOVELTY_LIMIT)?;
        let values = self.network.predict(&input);
        if let Some(triangle) = values.iter().position(|value| !value.is_finite()) {
            return Err(ReconstructError::Numerical {
                method: self.trained.method.clone(),
                cause: format!("its value for triangle {triangle} is {}", values[triangle]),
            });
        }
        let values = values.into_iter().map(f64::from).collect();
        Ok(self.trained.judged_map(values, masked, novelty, FAMILIAR))
    }
}
