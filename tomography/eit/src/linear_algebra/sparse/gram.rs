//! Products of two blocks.
#![allow(clippy::needless_range_loop)] // registers are addressed by index

use crate::linear_algebra::sparse::analysis::{GROUP, LANES};
use crate::linear_algebra::sparse::kernel::{MulAdd, Task, widest};
use crate::linear_algebra::sparse::sweep::Block;

/// aᵀ b of the first columns of two blocks with equal numbers of rows: `count` x `count`, column by column (b's
/// columns).
pub(crate) fn gram(a: &Block, b: &Block, count: usize) -> Vec<f64> {
    widest(Gram { a, b, count })
}

struct Gram<'a> {
    a: &'a Block,
    b: &'a Block,
    count: usize,
}

/// Rows of both blocks that fit in the first-level cache.
const ROWS: usize = 64;

impl Task for Gram<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run<M: MulAdd>(self) -> Vec<f64> {
        let Self { a, b, count } = self;
        let (wide, columns) = (a.width, b.width);
        let mut sums = vec![[0.0; LANES]; columns * wide / LANES];
        let per = wide / LANES;
        let (rows_a, rows_b) = (
            a.values.chunks(ROWS * wide),
            b.values.chunks(ROWS * columns),
        );
        for (a, b) in rows_a.zip(rows_b) {
            for column in (0..columns).step_by(GROUP) {
                for vector in 0..per {
                    let mut four: [[f64; LANES]; GROUP] =
                        std::array::from_fn(|c| sums[(column + c) * per + vector]);
                    for (a, b) in a.chunks_exact(wide).zip(b.chunks_exact(columns)) {
                        let a = &a[vector * LANES..][..LANES];
                        let b = &b[column..][..GROUP];
                        for c in 0..GROUP {
                            for i in 0..LANES {
                                four[c][i] = M::mul_add(b[c], a[i], four[c][i]);
                            }
                        }
                    }
                    for c in 0..GROUP {
                        sums[(column + c) * per + vector] = four[c];
                    }
                }
            }
        }
        (0..count)
            .flat_map(|column| {
                let row = &sums[column * per..][..per];
                (0..count).map(move |i| row[i / LANES][i % LANES])
            })
            .collect()
    }
}
