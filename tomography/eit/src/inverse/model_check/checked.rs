//! Maps of another method with their quality.

use std::sync::Arc;

use survey::{Map, MapQuality, Protocol, Reading};

use super::{ModelCheck, impossible};
use crate::{Mesh, Novelty, ReconstructError, Reconstructor};

/// Wraps another reconstructor and adds to each map how far it can be believed.
pub struct Checked {
    inner: Arc<dyn Reconstructor>,
    check: Arc<ModelCheck>,
    areas: Vec<f64>,
}

impl Checked {
    /// `check` is for the sheet and protocol of `inner`.
    pub fn new(inner: Arc<dyn Reconstructor>, check: Arc<ModelCheck>) -> Self {
        Self {
            areas: inner.mesh().region_areas(),
            inner,
            check,
        }
    }
}

impl Reconstructor for Checked {
    fn method(&self) -> &str {
        self.inner.method()
    }

    fn protocol(&self) -> &Protocol {
        self.inner.protocol()
    }

    fn mesh(&self) -> &Arc<Mesh> {
        self.inner.mesh()
    }

    fn assumptions(&self) -> Vec<String> {
        self.inner.assumptions()
    }

    fn noise_figure(&self) -> Option<f64> {
        self.inner.noise_figure()
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
        let map = self.inner.reconstruct(baseline, frame)?;
        let mut doubts = self.check.of(baseline, frame);
        doubts.extend(impossible(&map.values, &self.areas));
        Ok(Map {
            quality: Some(MapQuality::of(&doubts)),
            ..map
        })
    }
}
