//! A total-variation problem and the objective of a map.

use nalgebra::{DMatrix, DVector};

use crate::inverse::graph::Graph;

/// A total-variation problem.
pub(crate) struct Problem<'a> {
    /// J, a column per unknown.
    pub(crate) sensitivity: &'a DMatrix<f64>,
    pub(crate) data: DVector<f64>,
    pub(crate) graph: &'a Graph,
    /// W of each edge of the graph.
    pub(crate) weights: &'a [f64],
    pub(crate) bounds: [f64; 2],
    /// Constant part of the objective: |d|^2 / 2 of the dropped data.
    pub(crate) constant: f64,
}

impl Problem<'_> {
    /// The objective of a map.
    pub(crate) fn objective(&self, x: &[f64]) -> f64 {
        let residual = self.sensitivity * DVector::from_column_slice(x) - &self.data;
        0.5 * residual.norm_squared() + self.variation(x) + self.constant
    }

    pub(crate) fn variation(&self, x: &[f64]) -> f64 {
        self.graph
            .edges
            .iter()
            .zip(self.weights)
            .map(|(&[a, b], weight)| weight * (x[a] - x[b]).abs())
            .sum()
    }
}
