//! The three products of a fully connected layer and its step of Adam, on numbers laid out so that each product reads them
//! in the order in which they lie.
//!
//! - values of a batch: tiles of [`TILE`] neurons; in a tile, strips of [`STRIP`] samples; in a strip a row a neuron
//! - weights: panels of [`PANEL`] outputs; in a panel a row an input
//!
//! Neurons are filled up to whole tiles and samples to whole strips, with zeros that stay zeros: their gradients are.

mod kernel;

pub(super) use kernel::{adam, backward, forward, gradient};

/// Neurons of a tile.
pub(super) const TILE: usize = 64;
/// Samples of a strip.
pub(super) const STRIP: usize = 32;
/// Outputs of a panel of weights.
pub(super) const PANEL: usize = 16;

/// So many neurons in whole tiles.
pub(super) fn tiled(neurons: usize) -> usize {
    neurons.next_multiple_of(TILE)
}

/// Where the value of a neuron for a sample lies, of a batch of so many strips.
pub(super) fn place(neuron: usize, sample: usize, strips: usize) -> usize {
    (neuron / TILE * strips + sample / STRIP) * TILE * STRIP
        + neuron % TILE * STRIP
        + sample % STRIP
}

/// Row-major weights, a row of `inputs` an output, in panels.
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

/// The way back.
pub(super) fn in_rows(weights: &[f32], inputs: usize, outputs: usize) -> Vec<f32> {
    let panel = tiled(inputs) * PANEL;
    (0..outputs)
        .flat_map(|output| {
            let panel = &weights[output / PANEL * panel..];
            (0..inputs).map(move |input| panel[input * PANEL + output % PANEL])
        })
        .collect()
}

/// The slopes of a pair of panels, a row a sample; and the sum of each over the samples.
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
