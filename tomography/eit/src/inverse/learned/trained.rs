//! The reconstructor of trained networks of every kind.

use std::sync::Arc;

use survey::{Doubt, Map, MapQuality, Protocol, Reading};

use crate::inverse::reconstructor::Difference;
use crate::{Mesh, Novelty, ReconstructError, Reconstructor};

/// Data of a trained reconstructor besides its network.
#[derive(Debug, Clone)]
pub(crate) struct Trained {
    pub(crate) mesh: Arc<Mesh>,
    pub(crate) protocol: Protocol,
    /// The reciprocal twin of each reading.
    pub(crate) twins: Vec<Option<usize>>,
    pub(crate) method: String,
    pub(crate) assumptions: Vec<String>,
    pub(crate) noise_figure: Option<f64>,
}

impl Trained {
    /// The normalised change (a network's input), the missing readings whose twins are missing too, and the number of
    /// readings that were missing at first.
    pub(crate) fn change(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<(Vec<f64>, Vec<usize>, usize), ReconstructError> {
        let difference = Difference::new(baseline, frame, &self.twins, None, &self.method)?;
        let masked = difference.missing.len();
        let (change, left) = difference.normalised(&self.twins);
        Ok((change, left, masked))
    }
}

/// The network of a trained reconstructor.
pub(crate) trait Respond: Send + Sync {
    type Input;

    /// The input of a normalised change (Eq. 6); `left`: missing readings whose twins are missing too.
    fn input(&self, change: Vec<f64>, left: &[usize]) -> Self::Input;

    /// The distance of an input from the training inputs, with the distance within which 99.9 % of these lie as its
    /// limit, and the distance above which a frame is refused.
    fn novelty(&self, input: &Self::Input) -> Option<(Novelty, f64)>;

    /// One value per triangle of the region.
    fn respond(&self, input: Self::Input) -> Result<Vec<f64>, String>;
}

/// A network with the geometry and survey that it was trained for: normalises by Eq. 6, refuses inputs far from its
/// training.
pub(crate) struct TrainedReconstructor<N> {
    /// Has one input per reading of the protocol and one output per triangle of the region.
    pub(crate) network: N,
    pub(crate) trained: Trained,
}

impl<N: Respond> TrainedReconstructor<N> {
    /// The network's input and the number of missing readings.
    fn input(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<(N::Input, usize), ReconstructError> {
        let (change, left, masked) = self.trained.change(baseline, frame)?;
        Ok((self.network.input(change, &left), masked))
    }

    fn values(&self, input: N::Input) -> Result<Vec<f64>, String> {
        let values = self.network.respond(input)?;
        if values.len() != self.trained.mesh.region().len() {
            return Err(format!("it gave {} numbers", values.len()));
        }
        match values.iter().position(|value| !value.is_finite()) {
            Some(triangle) => Err(format!(
                "its value for triangle {triangle} is {}",
                values[triangle]
            )),
            None => Ok(values),
        }
    }
}

impl<N: Respond> Reconstructor for TrainedReconstructor<N> {
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
        let novelty = self.network.novelty(&input).map(|(novelty, _)| novelty);
        Ok(novelty.filter(is_known))
    }

    fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let (input, masked) = self.input(baseline, frame)?;
        let mut doubt = None;
        if let Some((novelty, limit)) = self.network.novelty(&input) {
            let Novelty { value, .. } = novelty;
            if value > limit || value.is_nan() {
                return Err(ReconstructError::OutsideModel {
                    novelty: value,
                    limit,
                });
            }
            let ratio = value / novelty.limit;
            doubt = (is_known(&novelty) && ratio > 1.0).then_some(Doubt::Novelty { ratio });
        }
        let method = &self.trained.method;
        let values = self
            .values(input)
            .map_err(|cause| ReconstructError::Numerical {
                method: method.clone(),
                cause,
            })?;
        Ok(Map {
            masked,
            quality: doubt.map(|doubt| MapQuality::of(&[doubt])),
            ..Map::relative(self.trained.mesh.hash(), values, method)
        })
    }
}

/// Whether the distance within which nearly all training inputs lie is known. It is NaN if the file does not state it,
/// and 0 if every training input is a neuron: the distances of other inputs are then unknown.
fn is_known(novelty: &Novelty) -> bool {
    novelty.limit > 0.0
}
