//! Maps of another method, clipped to losses: for methods without a bounded problem.

use std::sync::Arc;

use survey::{Map, Protocol, Reading};

use crate::{Mesh, Novelty, ReconstructError, Reconstructor};

/// Wraps another reconstructor and projects its maps on -1 <= x <= 0, triangle by triangle.
///
/// If loads only reduce conductance, the true map lies within these bounds, so clipping moves no triangle away from the
/// truth, whatever the method. The result is not the best map within the bounds: the remaining triangles do not
/// compensate for the clipped values. [`crate::OneStep`] and [`crate::Tv`] solve the bounded problem instead.
pub struct LossOnly {
    inner: Box<dyn Reconstructor>,
    method: String,
}

impl LossOnly {
    /// Wraps a method.
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
            "loads only reduce conductance: values beyond -1 <= dsigma/sigma0 <= 0 are clipped"
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
