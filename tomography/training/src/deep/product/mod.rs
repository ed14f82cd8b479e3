//! The three products of a fully connected layer and its step of Adam. Numbers are stored in the order in which the
//! products read them.
//!
//! - values of a batch: tiles of [`TILE`] neurons; within a tile, strips of [`STRIP`] samples; within a strip, a row
//!   per neuron
//! - weights: panels of [`PANEL`] outputs; within a panel, a row per input
//!
//! Neurons are padded to whole tiles and samples to whole strips with zeros, which remain zero because their gradients
//! are zero.

mod kernel;

pub(super) use kernel::{adam, backward, forward, gradient};

/// Neurons of a tile.
pub(super) const TILE: usize = 64;
/// Samples of a strip.
pub(super) const STRIP: usize = 32;
/// Outputs of a panel of weights.
pub(super) const PANEL: usize = 16;

/// The number of neurons rounded up to whole tiles.
pub(super) fn tiled(neurons: usize) -> usize {
    neurons.next_multiple_of(TILE)
}

/// Index of the value of a neuron for a sample, in a batch with this number of strips.
pub(super) fn place(neuron: usize, sample: usize, strips: usize) -> usize {
    (neuron / TILE * strips + sample / STRIP) * TILE * STRIP
        + neuron % TILE * STRIP
        + sample % STRIP
}

/// Converts row-major weights, a row of `inputs` per output, to panels.
pub(super) fn in_panels(plain: &[f32], inputs: usize) -> Vec<f32> {
    let outputs = plain.len() / inputs;
    let mut weights = vec![0.0; tiled(outputs) * tiled(inputs)];
    for (output, row) in plain.chunks_exact(inputs).enumerate() {
        let panel = &mut weights[output / PANEL * tiled(inputs) * PANEL..];
        for (input, weight) in row.iter().enumerate() {
            panel[input * PANEL + output % PANEL] = *weight;
        }
    }
    weights
}

/// Converts panels to row-major weights.
pub(super) fn in_rows(weights: &[f32], inputs: usize, outputs: usize) -> Vec<f32> {
    let panel = tiled(inputs) * PANEL;
    (0..outputs)
        .flat_map(|output| {
            let panel = &weights[output / PANEL * panel..];
            (0..inputs).map(move |input| panel[input * PANEL + output % PANEL])
        })
        .collect()
}

/// The slopes of a pair of panels transposed to one row per sample, and the sum of each slope over the samples.
pub(super) fn turn(
    slopes: &[f32],
    pair: usize,
    strips: usize,
    turned: &mut Vec<f32>,
) -> [f32; 2 * PANEL] {
    const PAIR: usize = 2 * PANEL;
    turned.resize(strips * STRIP * PAIR, 0.0);
    let mut sums = [0.0; PAIR];
    for sample in 0..strips * STRIP {
        let row = &mut turned[sample * PAIR..][..PAIR];
        for (o, (value, sum)) in row.iter_mut().zip(&mut sums).enumerate() {
            *value = slopes[place(pair * PAIR + o, sample, strips)];
            *sum += *value;
        }
    }
    sums
}
