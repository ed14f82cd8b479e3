//! Memory aligned for vectors.

use crate::linear_algebra::sparse::SparseError;
use crate::linear_algebra::sparse::analysis::LANES;

/// Doubles that begin at a cache line, so that no vector crosses two.
pub(super) struct Aligned {
    storage: Vec<f64>,
    start: usize,
    length: usize,
}

impl Aligned {
    pub(super) fn new(length: usize) -> Result<Self, SparseError> {
        let mut storage = Vec::new();
        storage
            .try_reserve_exact(length + LANES)
            .map_err(|_| SparseError::Memory)?;
        storage.resize(length + LANES, 0.0);
        let start = storage.as_ptr().align_offset(64).min(LANES);
        Ok(Self {
            storage,
            start,
            length,
        })
    }

    #[inline(always)]
    pub(super) fn values(&self) -> &[f64] {
        &self.storage[self.start..][..self.length]
    }

    #[inline(always)]
    pub(super) fn values_mut(&mut self) -> &mut [f64] {
        &mut self.storage[self.start..][..self.length]
    }
}

impl Clone for Aligned {
    fn clone(&self) -> Self {
        let mut storage = vec![0.0; self.length + LANES];
        let start = storage.as_ptr().align_offset(64).min(LANES);
        storage[start..][..self.length].copy_from_slice(self.values());
        Self {
            storage,
            start,
            length: self.length,
        }
    }
}
