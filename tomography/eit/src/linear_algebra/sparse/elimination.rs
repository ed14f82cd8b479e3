//! Elimination within one front: four columns at a time, on vectors of rows, with sums in registers.
#![allow(clippy::needless_range_loop)] // registers are addressed by index

use crate::linear_algebra::sparse::SparseError;
use crate::linear_algebra::sparse::analysis::{Front, GROUP, LANES};
use crate::linear_algebra::sparse::kernel::MulAdd;

/// Replaces the columns of a front by those of its factor, four at a time, from left to right.
#[inline(always)]
pub(super) fn eliminate<M: MulAdd>(
    panel: &mut [f64],
    leading: usize,
    columns: usize,
) -> Result<(), SparseError> {
    for first in (0..columns).step_by(GROUP) {
        let (done, rest) = panel.split_at_mut(first * leading);
        let group = &mut rest[..GROUP * leading];
        let mut row = first / LANES * LANES;
        // the rows of the pivots themselves
        subtract::<M, 1>(done, group, leading, first, row);
        let corner = corner(group, leading, first)?;
        scale::<M, 1>(group, leading, &corner, row);
        row += LANES;
        while row + 3 * LANES <= leading {
            subtract::<M, 3>(done, group, leading, first, row);
            scale::<M, 3>(group, leading, &corner, row);
            row += 3 * LANES;
        }
        while row < leading {
            subtract::<M, 1>(done, group, leading, first, row);
            scale::<M, 1>(group, leading, &corner, row);
            row += LANES;
        }
    }
    Ok(())
}

type Lanes = [f64; LANES];

#[inline(always)]
fn lanes(from: &[f64]) -> Lanes {
    std::array::from_fn(|i| from[i])
}

/// group -= done doneᵀ on R vectors of rows.
#[inline(always)]
fn subtract<M: MulAdd, const R: usize>(
    done: &[f64],
    group: &mut [f64],
    leading: usize,
    first: usize,
    row: usize,
) {
    let mut sums = [[[0.0; LANES]; R]; GROUP];
    for (c, sums) in sums.iter_mut().enumerate() {
        let from = &group[c * leading + row..][..R * LANES];
        for (r, sum) in sums.iter_mut().enumerate() {
            *sum = lanes(&from[r * LANES..]);
        }
    }
    accumulate::<M, R>(&mut sums, done, leading, row, first);
    for (c, sums) in sums.iter().enumerate() {
        let into = &mut group[c * leading + row..][..R * LANES];
        for (r, sum) in sums.iter().enumerate() {
            into[r * LANES..][..LANES].copy_from_slice(sum);
        }
    }
}

/// sums -= columns\[row..\] columns\[four..four + 4\]ᵀ over all columns.
#[inline(always)]
fn accumulate<M: MulAdd, const R: usize>(
    sums: &mut [[Lanes; R]; GROUP],
    columns: &[f64],
    leading: usize,
    row: usize,
    four: usize,
) {
    for column in columns.chunks_exact(leading) {
        let factors: [f64; GROUP] = std::array::from_fn({
            let four = &column[four..][..GROUP];
            move |c| -four[c]
        });
        let rows = &column[row..][..R * LANES];
        for r in 0..R {
            let values = lanes(&rows[r * LANES..]);
            for c in 0..GROUP {
                for i in 0..LANES {
                    sums[c][r][i] = M::mul_add(values[i], factors[c], sums[c][r][i]);
                }
            }
        }
    }
}

/// The factor of a group's own four rows.
struct Corner {
    inverse: [f64; GROUP],
    below: [[f64; GROUP]; GROUP],
}

#[inline(always)]
fn corner(group: &[f64], leading: usize, first: usize) -> Result<Corner, SparseError> {
    let mut below: [[f64; GROUP]; GROUP] =
        std::array::from_fn(|c| std::array::from_fn(|i| group[c * leading + first + i]));
    let mut inverse = [0.0; GROUP];
    for c in 0..GROUP {
        let pivot = below[c][c];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return Err(SparseError::NotDefinite);
        }
        inverse[c] = 1.0 / pivot.sqrt();
        for i in c..GROUP {
            below[c][i] *= inverse[c];
        }
        for j in c + 1..GROUP {
            for i in j..GROUP {
                below[j][i] -= below[c][i] * below[c][j];
            }
        }
    }
    Ok(Corner { inverse, below })
}

/// Divides R vectors of rows of a group by its corner.
#[inline(always)]
fn scale<M: MulAdd, const R: usize>(
    group: &mut [f64],
    leading: usize,
    corner: &Corner,
    row: usize,
) {
    for r in 0..R {
        let row = row + r * LANES;
        let mut sums: [Lanes; GROUP] =
            std::array::from_fn(|c| lanes(&group[c * leading + row..][..LANES]));
        for c in 0..GROUP {
            for i in 0..LANES {
                sums[c][i] *= corner.inverse[c];
            }
            for j in c + 1..GROUP {
                let factor = -corner.below[c][j];
                for i in 0..LANES {
                    sums[j][i] = M::mul_add(sums[c][i], factor, sums[j][i]);
                }
            }
        }
        for (c, sum) in sums.iter().enumerate() {
            group[c * leading + row..][..LANES].copy_from_slice(sum);
        }
    }
}

/// remainder = - L Lᵀ over the border; only its lower triangle is valid.
#[inline(always)]
pub(super) fn product<M: MulAdd>(panel: &[f64], front: &Front, remainder: &mut [f64]) {
    let (edge, leading) = (front.edge(), front.remainder_leading());
    for (group, four) in remainder
        .chunks_exact_mut(GROUP * leading)
        .zip((0..).step_by(GROUP))
    {
        let mut row = four / LANES * LANES;
        while row + 3 * LANES <= leading {
            tile::<M, 3>(panel, front.leading, edge, group, leading, row, four);
            row += 3 * LANES;
        }
        while row < leading {
            tile::<M, 1>(panel, front.leading, edge, group, leading, row, four);
            row += LANES;
        }
    }
}

#[inline(always)]
fn tile<M: MulAdd, const R: usize>(
    panel: &[f64],
    panel_leading: usize,
    edge: usize,
    group: &mut [f64],
    leading: usize,
    row: usize,
    four: usize,
) {
    let mut sums = [[[0.0; LANES]; R]; GROUP];
    accumulate::<M, R>(&mut sums, panel, panel_leading, edge + row, edge + four);
    for (c, sums) in sums.iter().enumerate() {
        let into = &mut group[c * leading + row..][..R * LANES];
        for (r, sum) in sums.iter().enumerate() {
            into[r * LANES..][..LANES].copy_from_slice(sum);
        }
    }
}
