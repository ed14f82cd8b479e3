//! Forward and backward substitution for all right sides together.
#![allow(clippy::needless_range_loop)] // registers are addressed by index

use crate::linear_algebra::sparse::analysis::{Analysis, Front, GROUP, LANES};
use crate::linear_algebra::sparse::factor::Factor;
use crate::linear_algebra::sparse::kernel::{MulAdd, Task, widest};

/// Right sides that fit into the registers together.
const MOST: usize = 4 * LANES;

/// Rows of unknowns, columns of right sides (padded to [`LANES`]), row by row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Block {
    pub(crate) values: Vec<f64>,
    /// Columns with the padding.
    pub(crate) width: usize,
}

impl Block {
    /// Zeros.
    pub(crate) fn zeros(rows: usize, columns: usize) -> Self {
        let width = columns.div_ceil(LANES).max(1) * LANES;
        Self {
            values: vec![0.0; rows * width],
            width,
        }
    }

    #[inline(always)]
    pub(crate) fn row(&self, row: usize) -> &[f64] {
        &self.values[row * self.width..][..self.width]
    }

    #[inline(always)]
    pub(crate) fn row_mut(&mut self, row: usize) -> &mut [f64] {
        &mut self.values[row * self.width..][..self.width]
    }
}

/// The factor of A = L Lᵀ to divide by.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Direction {
    /// L
    Down,
    /// Lᵀ
    Up,
}

impl Factor {
    /// x = A⁻¹ x; `base` is the factor that this one is based on.
    pub(crate) fn solve(&self, analysis: &Analysis, base: Option<&Self>, block: &mut Block) {
        self.halve(analysis, base, block);
        self.sweep(analysis, base, block, Direction::Up);
    }

    /// x = L⁻¹ x. Fronts with zero right sides are skipped.
    pub(crate) fn halve(&self, analysis: &Analysis, base: Option<&Self>, block: &mut Block) {
        self.sweep(analysis, base, block, Direction::Down);
    }

    /// x = L⁻ᵀ x.
    pub(crate) fn halve_back(&self, analysis: &Analysis, base: Option<&Self>, block: &mut Block) {
        self.sweep(analysis, base, block, Direction::Up);
    }

    fn sweep(
        &self,
        analysis: &Analysis,
        base: Option<&Self>,
        block: &mut Block,
        direction: Direction,
    ) {
        widest(Sweep {
            analysis,
            factor: self,
            base,
            block,
            direction,
        });
    }

    /// Columns of a front.
    #[inline(always)]
    fn front<'a>(&'a self, base: Option<&'a Self>, index: usize, front: &Front) -> &'a [f64] {
        let columns = match base {
            Some(base) if !self.own[index] => base.columns.values(),
            _ => self.columns.values(),
        };
        &columns[front.at..front.at + front.leading * front.columns()]
    }
}

struct Sweep<'a> {
    analysis: &'a Analysis,
    factor: &'a Factor,
    base: Option<&'a Factor>,
    block: &'a mut Block,
    direction: Direction,
}

impl Task for Sweep<'_> {
    type Output = ();

    #[inline(always)]
    fn run<M: MulAdd>(mut self) {
        let width = self.block.width;
        for first in (0..width).step_by(MOST) {
            match (width - first).min(MOST) / LANES {
                1 => self.columns::<M, 1>(first),
                2 => self.columns::<M, 2>(first),
                3 => self.columns::<M, 3>(first),
                _ => self.columns::<M, 4>(first),
            }
        }
    }
}

/// Some right sides of one unknown, in V registers.
pub(super) type Row<const V: usize> = [[f64; LANES]; V];

#[inline(always)]
pub(super) fn load<const V: usize>(from: &[f64]) -> Row<V> {
    let from = &from[..V * LANES];
    std::array::from_fn(|v| std::array::from_fn(|i| from[v * LANES + i]))
}

#[inline(always)]
pub(super) fn store<const V: usize>(row: &Row<V>, into: &mut [f64]) {
    let into = &mut into[..V * LANES];
    for v in 0..V {
        into[v * LANES..][..LANES].copy_from_slice(&row[v]);
    }
}

/// from + factor row
#[inline(always)]
pub(super) fn add<M: MulAdd, const V: usize>(
    mut from: Row<V>,
    factor: f64,
    row: &Row<V>,
) -> Row<V> {
    for v in 0..V {
        for i in 0..LANES {
            from[v][i] = M::mul_add(factor, row[v][i], from[v][i]);
        }
    }
    from
}

#[inline(always)]
fn times<const V: usize>(mut row: Row<V>, factor: f64) -> Row<V> {
    for v in 0..V {
        for i in 0..LANES {
            row[v][i] *= factor;
        }
    }
    row
}

impl Sweep<'_> {
    #[inline(always)]
    fn columns<M: MulAdd, const V: usize>(&mut self, first: usize) {
        let analysis = self.analysis;
        let longest = analysis.fronts.iter().map(Front::columns).max();
        let mut pivots: Vec<Row<V>> = vec![[[0.0; LANES]; V]; longest.unwrap_or(0)];
        let width = self.block.width;
        let x = &mut self.block.values[..];
        if self.direction == Direction::Down {
            for (index, front) in analysis.fronts.iter().enumerate() {
                let mut own = front.first..front.first + front.pivots;
                if own.all(|u| {
                    x[u * width + first..][..V * LANES]
                        .iter()
                        .all(|x| *x == 0.0)
                }) {
                    continue;
                }
                let panel = self.factor.front(self.base, index, front);
                down::<M, V>(front, panel, x, width, first, &mut pivots);
            }
        } else {
            for (index, front) in analysis.fronts.iter().enumerate().rev() {
                let panel = self.factor.front(self.base, index, front);
                up::<M, V>(front, panel, x, width, first, &mut pivots);
            }
        }
    }
}

/// Copies a front's pivots to a buffer; the padding is zero.
#[inline(always)]
fn gather<const V: usize>(
    front: &Front,
    x: &[f64],
    width: usize,
    first: usize,
    pivots: &mut [Row<V>],
) {
    for (k, row) in pivots[..front.columns()].iter_mut().enumerate() {
        *row = if k < front.pivots {
            load(&x[(front.first + k) * width + first..])
        } else {
            [[0.0; LANES]; V]
        };
    }
}

#[inline(always)]
fn scatter<const V: usize>(
    front: &Front,
    x: &mut [f64],
    width: usize,
    first: usize,
    pivots: &[Row<V>],
) {
    for (k, row) in pivots[..front.pivots].iter().enumerate() {
        store(row, &mut x[(front.first + k) * width + first..]);
    }
}

#[inline(always)]
fn down<M: MulAdd, const V: usize>(
    front: &Front,
    panel: &[f64],
    x: &mut [f64],
    width: usize,
    first: usize,
    pivots: &mut [Row<V>],
) {
    gather(front, x, width, first, pivots);
    let leading = front.leading;
    for group in (0..front.columns()).step_by(GROUP) {
        let (done, own) = pivots.split_at_mut(group);
        let mut sums: [Row<V>; GROUP] = std::array::from_fn(|c| own[c]);
        for (column, y) in panel.chunks_exact(leading).zip(done.iter()) {
            let factors = &column[group..][..GROUP];
            for c in 0..GROUP {
                sums[c] = add::<M, V>(sums[c], -factors[c], y);
            }
        }
        for c in 0..GROUP {
            let column = &panel[(group + c) * leading..][..leading];
            let y = times(sums[c], 1.0 / column[group + c]);
            own[c] = y;
            for j in c + 1..GROUP {
                sums[j] = add::<M, V>(sums[j], -column[group + j], &y);
            }
        }
    }
    scatter(front, x, width, first, pivots);
    let edge = front.edge();
    for at in (0..front.border.len()).step_by(GROUP) {
        let mut sums = [[[0.0; LANES]; V]; GROUP];
        // rows beyond the border are zero in the factor
        for (column, y) in panel.chunks_exact(leading).zip(pivots.iter()) {
            let factors = &column[edge + at..][..GROUP];
            for c in 0..GROUP {
                sums[c] = add::<M, V>(sums[c], -factors[c], y);
            }
        }
        for (sum, unknown) in sums.iter().zip(&front.border[at..]) {
            let row = &mut x[unknown * width + first..][..V * LANES];
            for v in 0..V {
                for i in 0..LANES {
                    row[v * LANES + i] += sum[v][i];
                }
            }
        }
    }
}

#[inline(always)]
fn up<M: MulAdd, const V: usize>(
    front: &Front,
    panel: &[f64],
    x: &mut [f64],
    width: usize,
    first: usize,
    pivots: &mut [Row<V>],
) {
    gather(front, x, width, first, pivots);
    let (leading, edge, columns) = (front.leading, front.edge(), front.columns());
    let border = &front.border[..];
    for group in (0..columns).step_by(GROUP).rev() {
        let four: [&[f64]; GROUP] =
            std::array::from_fn(|c| &panel[(group + c) * leading..][..leading]);
        let mut sums: [Row<V>; GROUP] = std::array::from_fn(|c| pivots[group + c]);
        let below: [&[f64]; GROUP] = std::array::from_fn(|c| &four[c][edge..][..border.len()]);
        for i in 0..border.len() {
            let row: Row<V> = load(&x[border[i] * width + first..]);
            for c in 0..GROUP {
                sums[c] = add::<M, V>(sums[c], -below[c][i], &row);
            }
        }
        for k in group + GROUP..columns {
            let row = pivots[k];
            for c in 0..GROUP {
                sums[c] = add::<M, V>(sums[c], -four[c][k], &row);
            }
        }
        for c in (0..GROUP).rev() {
            for j in c + 1..GROUP {
                let row = sums[j];
                sums[c] = add::<M, V>(sums[c], -four[c][group + j], &row);
            }
            sums[c] = times(sums[c], 1.0 / four[c][group + c]);
        }
        pivots[group..][..GROUP].copy_from_slice(&sums);
    }
    scatter(front, x, width, first, pivots);
}
