//! Resistor networks between unknowns: currents out of each unknown.
#![allow(clippy::needless_range_loop)] // registers are addressed by index

use crate::linear_algebra::sparse::analysis::LANES;
use crate::linear_algebra::sparse::kernel::{MulAdd, Task, widest};
use crate::linear_algebra::sparse::sweep::{Block, Row, add, load, store};

/// Resistors between unknowns, listed at both ends.
pub(crate) struct Network {
    starts: Vec<u32>,
    /// The other end, and the resistor's index.
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

    /// Resistors at an unknown: the other end and the index of each.
    pub(crate) fn at(&self, unknown: usize) -> &[[u32; 2]] {
        &self.links[self.starts[unknown] as usize..self.starts[unknown + 1] as usize]
    }

    /// rest -= the currents out of each unknown at these potentials; `weights`: conductance of each resistor.
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
        for first in (0..width).step_by(4 * LANES) {
            match (width - first).min(4 * LANES) / LANES {
                1 => columns::<M, 1>(network, weights, x, rest, first),
                2 => columns::<M, 2>(network, weights, x, rest, first),
                3 => columns::<M, 3>(network, weights, x, rest, first),
                _ => columns::<M, 4>(network, weights, x, rest, first),
            }
        }
    }
}

#[inline(always)]
fn columns<M: MulAdd, const V: usize>(
    network: &Network,
    weights: &[f64],
    x: &Block,
    rest: &mut Block,
    first: usize,
) {
    let width = x.width;
    let x = &x.values[..];
    for (unknown, into) in rest.values.chunks_exact_mut(width).enumerate() {
        let own: Row<V> = load(&x[unknown * width + first..]);
        let mut sum: Row<V> = load(&into[first..]);
        for &[other, index] in network.at(unknown) {
            let mut drop: Row<V> = load(&x[other as usize * width + first..]);
            for v in 0..V {
                for i in 0..LANES {
                    drop[v][i] = own[v][i] - drop[v][i];
                }
            }
            sum = add::<M, V>(sum, -weights[index as usize], &drop);
        }
        store(&sum, &mut into[first..]);
    }
}
