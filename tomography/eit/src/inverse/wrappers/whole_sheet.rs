//! Maps of the region from a method that solves for the conductance of the whole sheet.

use std::sync::Arc;

use survey::{Map, Protocol, Reading};

use crate::inverse::one_step::CLIPPED;
use crate::{Mesh, Novelty, ReconstructError, Reconstructor};

/// Suffix of the method's name.
const WHOLE_SHEET: &str = ", whole sheet";

/// A reconstructor whose unknowns are all triangles of the sheet, and whose maps show those of the region.
///
/// A method that solves for the region alone assumes that the conductance outside of it is known. A load near the edge,
/// or a change of the whole sheet, is then attributed to the region, and the map shows losses that do not exist.
pub struct WholeSheet {
    inner: Box<dyn Reconstructor>,
    shown: Arc<Mesh>,
    method: String,
}

impl WholeSheet {
    /// Wraps `inner`, which was made for [`Mesh::whole`] of the mesh `shown`; the maps show the region of `shown`.
    ///
    /// # Panics
    /// `inner` covers another mesh.
    pub fn new(inner: Box<dyn Reconstructor>, shown: Arc<Mesh>) -> Self {
        assert_eq!(
            inner.mesh().region().len(),
            shown.triangles().len(),
            "the inner method covers every triangle of the mesh"
        );
        Self {
            method: format!("{}{WHOLE_SHEET}", inner.method()),
            inner,
            shown,
        }
    }
}

impl Reconstructor for WholeSheet {
    fn method(&self) -> &str {
        &self.method
    }

    fn protocol(&self) -> &Protocol {
        self.inner.protocol()
    }

    fn mesh(&self) -> &Arc<Mesh> {
        &self.shown
    }

    fn assumptions(&self) -> Vec<String> {
        let mut notes = self.inner.assumptions();
        notes.push(format!(
            "the conductance of the whole sheet is unknown ({} triangles); the map shows the {} of the region",
            self.shown.triangles().len(),
            self.shown.region().len()
        ));
        notes
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
        let whole = self.inner.reconstruct(baseline, frame)?;
        let region = self.shown.region();
        let values = region.iter().map(|&triangle| whole.values[triangle]);
        let method = match whole.method.strip_suffix(CLIPPED) {
            Some(method) => format!("{method}{WHOLE_SHEET}{CLIPPED}"),
            None => format!("{}{WHOLE_SHEET}", whole.method),
        };
        Ok(Map {
            mesh_hash: self.shown.hash().to_owned(),
            values: values.collect(),
            method,
            ..whole
        })
    }
}
