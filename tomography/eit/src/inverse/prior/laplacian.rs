//! Weighted graph Laplacians: penalties on differences between neighbours. Constants on a connected part are not
//! penalised.

use nalgebra::DMatrix;

use crate::inverse::graph::Graph;
use crate::linear_algebra::sparse::{Analysis, Block, Factor, dissect};

/// R = sum w_e (x_i - x_j)^2 over edges.
#[derive(Debug, Clone)]
pub(crate) struct Laplacian {
    /// Pairs of unknowns that share an edge.
    pub(crate) edges: Vec<[usize; 2]>,
    /// The amount each edge adds to both diagonals.
    pub(crate) weights: Vec<f64>,
    /// Positions of the unknowns; used for the elimination order only.
    points: Vec<[f64; 2]>,
    /// The connected part of each unknown.
    part: Vec<usize>,
    /// The number of unknowns in each part.
    size: Vec<usize>,
}

/// The factor of R plus a diagonal, on the unknowns that are not held at zero.
#[derive(Clone)]
pub(crate) struct Half {
    analysis: Analysis,
    factor: Factor,
    /// The unknowns in elimination order.
    order: Vec<usize>,
}

impl Laplacian {
    pub(crate) fn new(points: Vec<[f64; 2]>, edges: Vec<[usize; 2]>, weights: Vec<f64>) -> Self {
        let graph = Graph::new(points.len(), edges, Vec::new());
        let (part, count) = graph.parts(|_, _| true);
        let mut size = vec![0; count];
        for &part in &part {
            size[part] += 1;
        }
        Self {
            edges: graph.edges,
            weights,
            points,
            part,
            size,
        }
    }

    pub(crate) fn unknowns(&self) -> usize {
        self.points.len()
    }

    /// The columns of the null space, one per connected part.
    pub(crate) fn null_space(&self) -> DMatrix<f64> {
        DMatrix::from_fn(self.part.len(), self.size.len(), |unknown, name| {
            f64::from(u8::from(self.part[unknown] == name))
        })
    }

    /// The factor with the first unknown of each part held at zero.
    pub(crate) fn grounded(&self) -> Option<Half> {
        let mut ground = vec![true; self.size.len()];
        let free: Vec<usize> = (0..self.unknowns())
            .filter(|&unknown| !std::mem::replace(&mut ground[self.part[unknown]], false))
            .collect();
        Half::new(self, free)?.factored(self, 1.0, |_| 0.0)
    }

    /// A pattern for `scale` R plus a positive diagonal; see [`Half::factored`].
    pub(crate) fn pattern(&self) -> Option<Half> {
        Half::new(self, (0..self.unknowns()).collect())
    }

    /// Subtracts from each right side the mean of each connected part: the result is orthogonal to the null space.
    pub(crate) fn remove_means(&self, block: &mut Block) {
        let mut mean = Block::zeros(self.size.len(), block.width);
        for (unknown, &name) in self.part.iter().enumerate() {
            for (sum, value) in mean.row_mut(name).iter_mut().zip(block.row(unknown)) {
                *sum += value / self.size[name] as f64;
            }
        }
        for (unknown, &name) in self.part.iter().enumerate() {
            for (value, mean) in block.row_mut(unknown).iter_mut().zip(mean.row(name)) {
                *value -= mean;
            }
        }
    }

    /// R x
    pub(crate) fn times(&self, x: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; x.len()];
        for (&[a, b], weight) in self.edges.iter().zip(&self.weights) {
            let pull = weight * (x[a] - x[b]);
            out[a] += pull;
            out[b] -= pull;
        }
        out
    }
}

impl Half {
    fn new(laplacian: &Laplacian, free: Vec<usize>) -> Option<Self> {
        let mut place = vec![usize::MAX; laplacian.unknowns()];
        for (k, &unknown) in free.iter().enumerate() {
            place[unknown] = k;
        }
        let edges: Vec<[usize; 2]> = laplacian
            .edges
            .iter()
            .map(|edge| edge.map(|unknown| place[unknown]))
            .filter(|edge| !edge.contains(&usize::MAX))
            .collect();
        let points: Vec<[f64; 2]> = free.iter().map(|&u| laplacian.points[u]).collect();
        let (order, parts) = dissect(&points, &neighbours(points.len(), &edges));
        let mut position = vec![0; order.len()];
        for (at, &k) in order.iter().enumerate() {
            position[k] = at;
        }
        let analysis =
            Analysis::new(&parts, edges.iter().map(|edge| edge.map(|k| position[k]))).ok()?;
        let factor = Factor::passing(&analysis).ok()?;
        Some(Self {
            analysis,
            factor,
            order: order.into_iter().map(|k| free[k]).collect(),
        })
    }

    /// Factors `scale` R plus the diagonal; `None` if that is not definite.
    pub(crate) fn factored(
        mut self,
        laplacian: &Laplacian,
        scale: f64,
        diagonal: impl Fn(usize) -> f64,
    ) -> Option<Self> {
        self.factor_again(laplacian, scale, diagonal)?;
        Some(self)
    }

    /// Repeats the factorisation in place, for another scale or diagonal.
    pub(crate) fn factor_again(
        &mut self,
        laplacian: &Laplacian,
        scale: f64,
        diagonal: impl Fn(usize) -> f64,
    ) -> Option<()> {
        let mut position = vec![usize::MAX; laplacian.unknowns()];
        for (at, &unknown) in self.order.iter().enumerate() {
            position[unknown] = at;
        }
        let mut values = vec![0.0; self.analysis.entries()];
        let mut add = |a: usize, b: usize, value: f64| {
            if let Some(entry) = self.analysis.entry(a, b) {
                values[entry] += value;
            }
        };
        for (at, &unknown) in self.order.iter().enumerate() {
            add(at, at, diagonal(unknown));
        }
        for (&[a, b], weight) in laplacian.edges.iter().zip(&laplacian.weights) {
            let (a, b) = (position[a], position[b]);
            for end in [a, b] {
                if end != usize::MAX {
                    add(end, end, scale * weight);
                }
            }
            if a != usize::MAX && b != usize::MAX {
                add(a.max(b), a.min(b), -scale * weight);
            }
        }
        self.factor.make(&self.analysis, &values).ok()
    }

    /// L^-1 x of a block with a row per unknown; rows of unknowns held at zero are removed, the others are in
    /// elimination order.
    pub(crate) fn down(&self, block: &Block) -> Block {
        let mut halved = Block {
            values: Vec::with_capacity(self.order.len() * block.width),
            width: block.width,
        };
        for &unknown in &self.order {
            halved.values.extend_from_slice(block.row(unknown));
        }
        self.factor.halve(&self.analysis, None, &mut halved);
        halved
    }

    /// L^-T z, again with a row per unknown.
    pub(crate) fn up(&self, mut halved: Block, unknowns: usize) -> Block {
        self.factor.halve_back(&self.analysis, None, &mut halved);
        let mut block = Block::zeros(unknowns, halved.width);
        for (at, &unknown) in self.order.iter().enumerate() {
            block.row_mut(unknown).copy_from_slice(halved.row(at));
        }
        block
    }
}

fn neighbours(unknowns: usize, edges: &[[usize; 2]]) -> Vec<Vec<usize>> {
    let mut neighbours = vec![Vec::new(); unknowns];
    for &[a, b] in edges {
        neighbours[a].push(b);
        neighbours[b].push(a);
    }
    neighbours
}

/// A row per unknown, from a matrix with a column per unknown.
pub(crate) fn block_of_columns(matrix: &DMatrix<f64>) -> Block {
    let mut block = Block::zeros(matrix.ncols(), matrix.nrows());
    for (unknown, column) in matrix.column_iter().enumerate() {
        for (into, value) in block.row_mut(unknown).iter_mut().zip(&column) {
            *into = *value;
        }
    }
    block
}

/// A row per unknown, from a matrix with a row per unknown.
pub(crate) fn block_of_rows(matrix: &DMatrix<f64>) -> Block {
    let mut block = Block::zeros(matrix.nrows(), matrix.ncols());
    for (right, column) in matrix.column_iter().enumerate() {
        for (unknown, value) in column.iter().enumerate() {
            block.row_mut(unknown)[right] = *value;
        }
    }
    block
}

/// The first `columns` right sides of a block.
pub(crate) fn matrix_of(block: &Block, columns: usize) -> DMatrix<f64> {
    let rows = block.values.len() / block.width;
    DMatrix::from_fn(rows, columns, |unknown, right| block.row(unknown)[right])
}
