//! Memory for vectors.

use crate::linear_algebra::sparse::SparseError;
use crate::linear_algebra::sparse::analysis::LANES;

/// Doubles that begin at a cache line, so that no vector lies across two.
pub(super) struct Aligned {
    room: Vec<f64>,
    start: usize,
    length: usize,
}

impl Aligned {
    pub(super) fn new(length: usize) -> Result<Self, SparseError> {
        let mut room = Vec::new();
        room.try_reserve_exact(length + LANES)
            .map_err(|_| SparseError::Memory)?;
        room.resize(length + LANES, 0.0);
        let start = room.as_ptr().align_offset(64).min(LANES);
        Ok(Self {
            room,
            start,
            length,
        })
    }

    #[inline(always)]
    pub(super) fn values(&self) -> &[f64] {
        &self.room[self.start..][..self.length]
    }

    #[inline(always)]
    pub(super) fn values_mut(&mut self) -> &mut [f64] {
        &mut self.room[self.start..][..self.length]
    }
}

impl Clone for Aligned {
    fn clone(&self) -> Self {
        let mut room = vec![0.0; self.length + LANES];
        let start = room.as_ptr().align_offset(64).min(LANES);
        room[start..][..self.length].copy_from_slice(self.values());
        Self {
            room,
            start,
            length: self.length,
        }
    }
}
