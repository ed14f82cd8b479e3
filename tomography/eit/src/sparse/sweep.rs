//! Right sides: down and up the fronts, all at once.
#![allow(clippy::needless_range_loop)] // registers are named by their index

use super::analysis::{Analysis, Front, GROUP, LANES};
use super::factor::Factor;
use super::kernel::{MulAdd, Task, widest};

/// Right sides that fit into the registers at once.
const MOST: usize = 4 * LANES;

/// Rows of unknowns, columns of right sides (padded to [`LANES`]), row after row.
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

/// What of A = L Lᵀ is divided by.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Direction {
    /// L
    Down,
    /// Lᵀ
    Up,
}

impl Factor {
    /// x = A⁻¹ x; `base` is the factor that this one was based on.
    pub(crate) fn solve(&self, analysis: &Analysis, base: Option<&Self>, block: &mut Block) {
        self.halve(analysis, base, block);
        self.sweep(analysis, base, block, Direction::Up);
    }

    /// x = L⁻¹ x. Fronts without anything on their right side cost nothing.
    pub(crate) fn halve(&self, analysis: &Analysis, base: Option<&Self>, block: &mut Block) {
        self.sweep(analysis, base, block, Direction::Down);
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
                1 => self.columns::<M, LANES>(first),
                2 => self.columns::<M, { 2 * LANES }>(first),
                3 => self.columns::<M, { 3 * LANES }>(first),
                _ => self.columns::<M, MOST>(first),
            }
        }
    }
}

impl Sweep<'_> {
    #[inline(always)]
    fn columns<M: MulAdd, const C: usize>(&mut self, first: usize) {
        let analysis = self.analysis;
        let longest = analysis.fronts.iter().map(Front::columns).max();
        let mut pivots = vec![[0.0; C]; longest.unwrap_or(0)];
        let width = self.block.width;
        let x = &mut self.block.values[..];
        if self.direction == Direction::Down {
            for (index, front) in analysis.fronts.iter().enumerate() {
                let own = front.first..front.first + front.pivots;
                if own
                    .clone()
                    .all(|u| x[u * width + first..][..C].iter().all(|x| *x == 0.0))
                {
                    continue;
                }
                let panel = self.factor.front(self.base, index, front);
                down::<M, C>(front, panel, x, width, first, &mut pivots);
            }
        } else {
            for (index, front) in analysis.fronts.iter().enumerate().rev() {
                let panel = self.factor.front(self.base, index, front);
                up::<M, C>(front, panel, x, width, first, &mut pivots);
            }
        }
    }
}

/// Copies a front's pivots out; the padding is zero.
#[inline(always)]
fn gather<const C: usize>(
    front: &Front,
    x: &[f64],
    width: usize,
    first: usize,
    pivots: &mut [[f64; C]],
) {
    for (k, row) in pivots[..front.columns()].iter_mut().enumerate() {
        if k < front.pivots {
            row.copy_from_slice(&x[(front.first + k) * width + first..][..C]);
        } else {
            *row = [0.0; C];
        }
    }
}

#[inline(always)]
fn scatter<const C: usize>(
    front: &Front,
    x: &mut [f64],
    width: usize,
    first: usize,
    pivots: &[[f64; C]],
) {
    for (k, row) in pivots[..front.pivots].iter().enumerate() {
        x[(front.first + k) * width + first..][..C].copy_from_slice(row);
    }
}

#[inline(always)]
fn subtract<M: MulAdd, const C: usize>(from: &mut [f64; C], factor: f64, row: &[f64; C]) {
    for (from, value) in from.iter_mut().zip(row) {
        *from = M::mul_add(-factor, *value, *from);
    }
}

#[inline(always)]
fn down<M: MulAdd, const C: usize>(
    front: &Front,
    panel: &[f64],
    x: &mut [f64],
    width: usize,
    first: usize,
    pivots: &mut [[f64; C]],
) {
    gather(front, x, width, first, pivots);
    let leading = front.leading;
    for group in (0..front.columns()).step_by(GROUP) {
        let (done, own) = pivots.split_at_mut(group);
        let mut sums: [[f64; C]; GROUP] = std::array::from_fn(|c| own[c]);
        for (column, y) in panel.chunks_exact(leading).zip(done.iter()) {
            let factors = &column[group..][..GROUP];
            for c in 0..GROUP {
                subtract::<M, C>(&mut sums[c], factors[c], y);
            }
        }
        for c in 0..GROUP {
            let column = &panel[(group + c) * leading..][..leading];
            let inverse = 1.0 / column[group + c];
            sums[c].iter_mut().for_each(|x| *x *= inverse);
            let y = sums[c];
            for j in c + 1..GROUP {
                subtract::<M, C>(&mut sums[j], column[group + j], &y);
            }
            own[c] = y;
        }
    }
    scatter(front, x, width, first, pivots);
    let edge = front.edge();
    let mut at = 0;
    while at < front.border.len() {
        let rows = (front.border.len() - at).min(GROUP);
        // rows beyond the border repeat the last: their factors are zero
        let place: [usize; GROUP] =
            std::array::from_fn(|c| front.border[at + c.min(rows - 1)] * width + first);
        let mut sums = [[0.0; C]; GROUP];
        for (column, y) in panel.chunks_exact(leading).zip(pivots.iter()) {
            let factors = &column[edge + at..][..GROUP];
            for c in 0..GROUP {
                subtract::<M, C>(&mut sums[c], factors[c], y);
            }
        }
        for c in 0..rows {
            let row = &mut x[place[c]..][..C];
            for (x, sum) in row.iter_mut().zip(&sums[c]) {
                *x += sum;
            }
        }
        at += GROUP;
    }
}

#[inline(always)]
fn up<M: MulAdd, const C: usize>(
    front: &Front,
    panel: &[f64],
    x: &mut [f64],
    width: usize,
    first: usize,
    pivots: &mut [[f64; C]],
) {
    gather(front, x, width, first, pivots);
    let (leading, edge, columns) = (front.leading, front.edge(), front.columns());
    for group in (0..columns).step_by(GROUP).rev() {
        let four: [&[f64]; GROUP] =
            std::array::from_fn(|c| &panel[(group + c) * leading..][..leading]);
        let mut sums: [[f64; C]; GROUP] = std::array::from_fn(|c| pivots[group + c]);
        let below: [&[f64]; GROUP] =
            std::array::from_fn(|c| &four[c][edge..][..front.border.len()]);
        for (i, &unknown) in front.border.iter().enumerate() {
            let row: &[f64; C] = x[unknown * width + first..][..C]
                .try_into()
                .expect("the slice has this length");
            for c in 0..GROUP {
                subtract::<M, C>(&mut sums[c], below[c][i], row);
            }
        }
        for k in group + GROUP..columns {
            let row = pivots[k];
            for c in 0..GROUP {
                subtract::<M, C>(&mut sums[c], four[c][k], &row);
            }
        }
        for c in (0..GROUP).rev() {
            for j in c + 1..GROUP {
                let row = pivots[group + j];
                subtract::<M, C>(&mut sums[c], four[c][group + j], &row);
            }
            let inverse = 1.0 / four[c][group + c];
            sums[c].iter_mut().for_each(|x| *x *= inverse);
            pivots[group + c] = sums[c];
        }
    }
    scatter(front, x, width, first, pivots);
}
