//! Resistors between unknowns: what flows out of each.

use super::analysis::LANES;
use super::kernel::{MulAdd, Task, widest};
use super::sweep::Block;

/// Resistors between unknowns, listed at both ends.
pub(crate) struct Network {
    starts: Vec<u32>,
    /// The other end, and which resistor.
    links: Vec<[u32; 2]>,
}

impl Network {
    /// From the ends of each resistor.
    pub(crate) fn new(size: usize, ends: &[[u32; 2]]) -> Self {
        let mut at = vec![Vec::new(); size];
        for (index, &[a, b]) in ends.iter().enumerate() {
            let index = u32::try_from(index).expect("a mesh has fewer than 2^32 edges");
            at[a as usize].push([b, index]);
            at[b as usize].push([a, index]);
        }
        let mut starts = vec![0];
        let mut links = Vec::new();
        for list in at {
            links.extend(list);
            starts.push(links.len() as u32);
        }
        Self { starts, links }
    }

    /// Resistors at an unknown: the other end, and which.
    pub(crate) fn at(&self, unknown: usize) -> &[[u32; 2]] {
        &self.links[self.starts[unknown] as usize..self.starts[unknown + 1] as usize]
    }

    /// rest -= the currents that leave each unknown at these potentials; `weights`: conductance of each resistor.
    pub(crate) fn subtract(&self, weights: &[f64], x: &Block, rest: &mut Block) {
        widest(Subtract {
            network: self,
            weights,
            x,
            rest,
        });
    }
}

struct Subtract<'a> {
    network: &'a Network,
    weights: &'a [f64],
    x: &'a Block,
    rest: &'a mut Block,
}

impl Task for Subtract<'_> {
    type Output = ();

    #[inline(always)]
    fn run<M: MulAdd>(self) {
        let Self {
            network,
            weights,
            x,
            rest,
        } = self;
        let width = x.width;
        let mut first = 0;
        while first < width {
            if width - first >= 4 * LANES {
                columns::<M, { 4 * LANES }>(network, weights, x, rest, first);
                first += 4 * LANES;
            } else if width - first >= 2 * LANES {
                columns::<M, { 2 * LANES }>(network, weights, x, rest, first);
                first += 2 * LANES;
            } else {
                columns::<M, LANES>(network, weights, x, rest, first);
                first += LANES;
            }
        }
    }
}

#[inline(always)]
fn columns<M: MulAdd, const C: usize>(
    network: &Network,
    weights: &[f64],
    x: &Block,
    rest: &mut Block,
    first: usize,
) {
    let width = x.width;
    let row = |unknown: usize| -> &[f64; C] {
        x.values[unknown * width + first..][..C]
            .try_into()
            .expect("the slice has this length")
    };
    for (unknown, into) in rest.values.chunks_exact_mut(width).enumerate() {
        let own = *row(unknown);
        let into = &mut into[first..first + C];
        let mut sum: [f64; C] = std::array::from_fn(|i| into[i]);
        for &[other, index] in network.at(unknown) {
            let (weight, other) = (weights[index as usize], row(other as usize));
            for i in 0..C {
                sum[i] = M::mul_add(-weight, own[i] - other[i], sum[i]);
            }
        }
        into.copy_from_slice(&sum);
    }
}
