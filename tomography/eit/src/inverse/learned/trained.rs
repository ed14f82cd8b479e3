//! Functions shared by the reconstructors of trained networks.

use std::sync::Arc;

use survey::{Doubt, Map, MapQuality, Protocol, Reading};

use crate::inverse::reconstructor::Difference;
use crate::{Mesh, ReconstructError};

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

    /// Refuses an input too far from the training inputs; `novelty` and `limit` in the same unit.
    pub(crate) fn refuse_far(&self, novelty: f64, limit: f64) -> Result<(), ReconstructError> {
        if novelty > limit || novelty.is_nan() {
            return Err(ReconstructError::OutsideModel { novelty, limit });
        }
        Ok(())
    }

    /// A network's output for the triangles of the region as a map.
    pub(crate) fn map(&self, values: Vec<f64>, masked: usize) -> Map {
        Map {
            masked,
            ..Map::relative(self.mesh.hash(), values, &self.method)
        }
    }

    /// Like [`Self::map`], but the map is doubtful if its input is farther from the training inputs (`novelty`) than
    /// 99.9 % of these are (`familiar`). A `familiar` of 0 disables the check: every training input is then a neuron,
    /// and the distances of other inputs are unknown.
    pub(crate) fn judged_map(
        &self,
        values: Vec<f64>,
        masked: usize,
        novelty: f64,
        familiar: f64,
    ) -> Map {
        let ratio = novelty / familiar;
        // `familiar` is NaN if the file does not state that distance
        let doubt =
            (familiar > 0.0 && ratio > 1.0).then(|| MapQuality::of(&[Doubt::Novelty { ratio }]));
        Map {
            quality: doubt,
            ..self.map(values, masked)
        }
    }
}
