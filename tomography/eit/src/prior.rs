//! What is believed of a map before a reading is taken: the matrix R of x'Rx, and how to apply its inverse.

use faer::Side;
use faer::linalg::solvers::Solve;
use faer::sparse::{SparseColMat, Triplet};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::Mesh;
use crate::one_step::OneStepError;
use crate::tv::Graph;

/// The prior of a one-step reconstruction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Prior {
    /// R = I.
    Tikhonov,
    /// R = diag(J'J)^p: p = 0.5 evens the sensitivity out half way, p = 1 altogether.
    Noser {
        /// The exponent p.
        p: f64,
    },
    /// R = twice the graph Laplacian of the triangles that share an edge (the scale of EIDORS). Its null space, the
    /// constant of each connected part, is left unpenalised exactly.
    Laplace,
    /// R = L'L with L the difference across each border times its length (m): the paper's Eq. 5 inside the square of its
    /// Eq. 4, as printed, so not total variation. Its null space is the constant.
    Variation,
}

impl Default for Prior {
    fn default() -> Self {
        Self::Noser { p: 0.5 }
    }
}

impl Prior {
    /// NOSER as a person asked for it: the exponent given; else 0.5 where the prior was named, as in the literature;
    /// else, where nothing was said, the prior of [`crate::OneStepOptions::default`].
    pub fn noser(named: bool, exponent: Option<f64>) -> Self {
        match exponent {
            Some(p) => Self::Noser { p },
            None if named => Self::default(),
            None => crate::OneStepOptions::default().prior,
        }
    }

    /// As a person names it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tikhonov => "tikhonov",
            Self::Noser { .. } => "noser",
            Self::Laplace => "laplace",
            Self::Variation => "quadratic variation",
        }
    }
}

/// R of one prior on one mesh.
#[derive(Debug, Clone)]
pub(crate) enum Penalty {
    /// R is diagonal: its entries, all positive.
    Diagonal(Vec<f64>),
    /// R is the weighted graph Laplacian of some edges; parts are its connected components.
    Laplacian {
        /// Pairs of unknowns that share an edge.
        edges: Vec<[usize; 2]>,
        /// What each edge adds to both diagonals.
        weights: Vec<f64>,
        /// Which connected part each unknown is in.
        part: Vec<usize>,
        /// How many unknowns there are in each part.
        size: Vec<usize>,
    },
}

/// EIDORS' scale of the Laplace prior: each shared edge adds 2 to both diagonals.
const LAPLACE_WEIGHT: f64 = 2.0;

impl Penalty {
    /// R = I.
    pub(crate) fn identity(unknowns: usize) -> Self {
        Self::Diagonal(vec![1.0; unknowns])
    }

    /// R = diag(J'J)^p. Triangles that no reading sees keep 1e-12 of the largest entry, so that R stays invertible.
    pub(crate) fn noser(sensitivity: &DMatrix<f64>, p: f64) -> Self {
        let squares: Vec<f64> = sensitivity
            .column_iter()
            .map(|column| column.norm_squared())
            .collect();
        let largest = squares.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        Self::Diagonal(
            squares
                .into_iter()
                .map(|square| square.max(1e-12 * largest).powf(p))
                .collect(),
        )
    }

    /// Twice the graph Laplacian of the mesh's region.
    pub(crate) fn laplacian(mesh: &Mesh) -> Self {
        let region = mesh.region();
        let mut edges = Vec::new();
        let mut open = std::collections::HashMap::new();
        for (unknown, &triangle) in region.iter().enumerate() {
            let [a, b, c] = mesh.triangles()[triangle];
            for (p, q) in [(a, b), (b, c), (c, a)] {
                if let Some(other) = open.insert((p.min(q), p.max(q)), unknown) {
                    edges.push([other, unknown]);
                }
            }
        }
        let weights = vec![LAPLACE_WEIGHT; edges.len()];
        Self::from_edges(region.len(), edges, weights)
    }

    /// The squared differences across the borders of a region's triangles, each times its squared length (m2).
    pub(crate) fn variation(mesh: &Mesh) -> Self {
        let graph = Graph::of_region(mesh);
        let weights = graph.lengths.iter().map(|length| length * length).collect();
        Self::from_edges(graph.unknowns, graph.edges, weights)
    }

    /// The weighted graph Laplacian of `edges` between `unknowns` unknowns.
    pub(crate) fn from_edges(unknowns: usize, edges: Vec<[usize; 2]>, weights: Vec<f64>) -> Self {
        let mut neighbours = vec![Vec::new(); unknowns];
        for &[a, b] in &edges {
            neighbours[a].push(b);
            neighbours[b].push(a);
        }
        let mut part = vec![usize::MAX; unknowns];
        let mut size = Vec::new();
        for seed in 0..unknowns {
            if part[seed] != usize::MAX {
                continue;
            }
            let name = size.len();
            size.push(0);
            let mut frontier = vec![seed];
            part[seed] = name;
            while let Some(unknown) = frontier.pop() {
                size[name] += 1;
                for &next in &neighbours[unknown] {
                    if part[next] == usize::MAX {
                        part[next] = name;
                        frontier.push(next);
                    }
                }
            }
        }
        Self::Laplacian {
            edges,
            weights,
            part,
            size,
        }
    }

    /// The columns of R's null space, one a connected part; none for a diagonal R.
    pub(crate) fn null_space(&self) -> Option<DMatrix<f64>> {
        match self {
            Self::Diagonal(_) => None,
            Self::Laplacian { part, size, .. } => {
                Some(DMatrix::from_fn(part.len(), size.len(), |unknown, name| {
                    f64::from(u8::from(part[unknown] == name))
                }))
            }
        }
    }

    /// R^-1 J', or, where R is singular, R^+ J' with the pseudo-inverse: the caller adds the null space itself.
    pub(crate) fn inverse_times_transposed(
        &self,
        sensitivity: &DMatrix<f64>,
    ) -> Option<DMatrix<f64>> {
        let mut spread = sensitivity.transpose();
        match self {
            Self::Diagonal(entries) => {
                for mut column in spread.column_iter_mut() {
                    for (value, entry) in column.iter_mut().zip(entries) {
                        *value /= entry;
                    }
                }
            }
            Self::Laplacian {
                edges,
                weights,
                part,
                size,
            } => {
                remove_means(&mut spread, part, size);
                grounded_solve(edges, weights, part, size, &mut spread)?;
                remove_means(&mut spread, part, size);
            }
        }
        Some(spread)
    }

    /// The factor g for which the prior N(0, g^2 R^-1) has the root mean square `change` over the unknowns; directions
    /// of the null space do not count.
    pub(crate) fn amplitude(&self, change: f64) -> Result<f64, OneStepError> {
        let unknowns = match self {
            Self::Diagonal(entries) => entries.len(),
            Self::Laplacian { part, .. } => part.len(),
        };
        let trace = match self {
            Self::Diagonal(entries) => entries.iter().map(|entry| 1.0 / entry).sum::<f64>(),
            Self::Laplacian { .. } => self
                .inverse_times_transposed(&DMatrix::identity(unknowns, unknowns))
                .ok_or(OneStepError::Prior)?
                .trace(),
        };
        Ok(change / (trace / unknowns as f64).sqrt())
    }
}

/// Subtracts from each column the mean of each connected part: what is left is orthogonal to the null space.
fn remove_means(columns: &mut DMatrix<f64>, part: &[usize], size: &[usize]) {
    for mut column in columns.column_iter_mut() {
        let mut mean = vec![0.0; size.len()];
        for (value, &name) in column.iter().zip(part) {
            mean[name] += value;
        }
        for (mean, &size) in mean.iter_mut().zip(size) {
            *mean /= size as f64;
        }
        for (value, &name) in column.iter_mut().zip(part) {
            *value -= mean[name];
        }
    }
}

/// Solves R x = b in place for right-hand sides without mean, with the first unknown of each part held at zero: the
/// solution of a consistent singular system, one constant a part apart.
fn grounded_solve(
    edges: &[[usize; 2]],
    weights: &[f64],
    part: &[usize],
    size: &[usize],
    columns: &mut DMatrix<f64>,
) -> Option<()> {
    let n = part.len();
    let mut ground = vec![true; size.len()];
    let grounded: Vec<bool> = part
        .iter()
        .map(|&name| std::mem::replace(&mut ground[name], false))
        .collect();
    let mut diagonal = vec![0.0; n];
    let mut triplets = Vec::with_capacity(n + 2 * edges.len());
    for (&[a, b], &weight) in edges.iter().zip(weights) {
        diagonal[a] += weight;
        diagonal[b] += weight;
        if !grounded[a] && !grounded[b] {
            triplets.push(Triplet::new(a, b, -weight));
            triplets.push(Triplet::new(b, a, -weight));
        }
    }
    for unknown in 0..n {
        let entry = if grounded[unknown] {
            // of the others' size
            weights.first().copied().unwrap_or(1.0)
        } else {
            diagonal[unknown]
        };
        triplets.push(Triplet::new(unknown, unknown, entry));
    }
    for mut column in columns.column_iter_mut() {
        for (value, &grounded) in column.iter_mut().zip(&grounded) {
            if grounded {
                *value = 0.0;
            }
        }
    }
    let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(n, n, &triplets).ok()?;
    let factor = matrix.sp_cholesky(Side::Lower).ok()?;
    let (rows, count) = (columns.nrows(), columns.ncols());
    let into = faer::MatMut::from_column_major_slice_mut(columns.as_mut_slice(), rows, count);
    factor.solve_in_place(into);
    Some(())
}
