//! What the reconstructors of trained networks share.

use std::sync::Arc;

use survey::{Map, MapUnit, Protocol, Reading};

use crate::inverse::reconstructor::Difference;
use crate::{Mesh, ReconstructError};

/// What every trained reconstructor carries beside its network.
#[derive(Debug, Clone)]
pub(crate) struct Trained {
    pub(crate) mesh: Arc<Mesh>,
    pub(crate) protocol: Protocol,
    /// The reading that reciprocity makes equal to each.
    pub(crate) twins: Vec<Option<usize>>,
    pub(crate) method: String,
    pub(crate) assumptions: Vec<String>,
    pub(crate) noise_figure: Option<f64>,
}

impl Trained {
    /// The normalised change that a network is asked about, the readings that even their twins do not give, and how many
    /// were missing at first.
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

    /// Refuses an input too far from what was trained on.
    pub(crate) fn refuse_far(&self, novelty: f64, limit: f64) -> Result<(), ReconstructError> {
        if novelty > limit || novelty.is_nan() {
            return Err(ReconstructError::OutsideModel { novelty, limit });
        }
        Ok(())
    }

    /// A network's answer for the triangles of the region as a map.
    pub(crate) fn map(&self, values: Vec<f64>, masked: usize) -> Map {
        Map {
            mesh_hash: self.mesh.hash().to_owned(),
            values,
            unit: MapUnit::RelativeConductance,
            method: self.method.clone(),
            masked,
        }
    }
}
