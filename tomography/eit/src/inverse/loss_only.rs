//! Maps of another method, bounded to losses by cutting: for methods that have no problem of their own to bound.

use std::sync::Arc;

use survey::{Map, Protocol, Reading};

use crate::{Mesh, Novelty, ReconstructError, Reconstructor};

/// Another reconstructor whose maps are projected on -1 <= x <= 0, triangle by triangle.
///
/// Where loads only take conductance away the true map lies within these bounds, so no triangle is further from the truth
/// after this than before, whatever the method. It is not the best map within the bounds: what is cut away is not explained by
/// the triangles that are left. [`crate::OneStep`] and [`crate::Tv`] have bounds of their own, which do that.
pub struct LossOnly {
    inner: Box<dyn Reconstructor>,
    method: String,
}

impl LossOnly {
    /// Cuts the maps of this method from now on.
    pub fn new(inner: Box<dyn Reconstructor>) -> Self {
        Self {
            method: format!("{}, loss only", inner.method()),
            inner,
        }
    }
}

impl Reconstructor for LossOnly {
    fn method(&self) -> &str {
        &self.method
    }

    fn protocol(&self) -> &Protocol {
        self.inner.protocol()
    }

    fn mesh(&self) -> &Arc<Mesh> {
        self.inner.mesh()
    }

    fn assumptions(&self) -> Vec<String> {
        let mut notes = self.inner.assumptions();
        notes.push(
            "loads only take conductance away: what lies beyond -1 <= dsigma/sigma0 <= 0 is cut"
                .to_owned(),
        );
        notes
    }

    fn novelty(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Option<Novelty>, ReconstructError> {
        self.inner.novelty(baseline, frame)
    }

    fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let mut map = self.inner.reconstruct(baseline, frame)?;
        for value in &mut map.values {
            *value = value.clamp(-1.0, 0.0);
        }
        map.method.clone_from(&self.method);
        Ok(map)
    }
}
