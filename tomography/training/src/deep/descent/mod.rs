//! The state of a network in training (weights, Adam's moments, activations of a batch), and the training step.

#[cfg(test)]
mod tests;

use eit::DeepSettings;
use eit::inverse::learned::network::{elu, elu_slope};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::adam::Step;
use super::product::{self, PANEL, STRIP, TILE, place, tiled};

/// Random stream of the initial weights, separate from those of cases and jitter.
const INITIAL: u64 = 200 << 48;

/// Trained parameters with Adam's two moments.
#[derive(Debug, Clone)]
pub(super) struct Trained {
    pub(super) values: Vec<f32>,
    pub(super) first: Vec<f32>,
    pub(super) second: Vec<f32>,
}

impl Trained {
    fn new(values: Vec<f32>) -> Self {
        Self {
            first: vec![0.0; values.len()],
            second: vec![0.0; values.len()],
            values,
        }
    }

    fn step(&mut self, step: Step, gradient: &[f32]) {
        step.take(
            &mut self.values,
            [&mut self.first, &mut self.second],
            gradient,
        );
    }
}

/// One layer.
#[derive(Debug, Clone)]
pub(super) struct Layer {
    inputs: usize,
    outputs: usize,
    /// Weights, in panels.
    weights: Trained,
    bias: Trained,
}

impl Layer {
    /// Row-major weights, one row per output and one column per input; and biases.
    pub(super) fn plain(&self) -> (Vec<f32>, Vec<f32>) {
        (
            product::in_rows(&self.weights.values, self.inputs, self.outputs),
            self.bias.values[..self.outputs].to_vec(),
        )
    }
}

/// A batch: `inputs` has a row per reading and a column per sample, `targets` are (triangle, sample, relative change).
#[derive(Debug, Clone, Default)]
pub(super) struct Batch {
    pub(super) samples: usize,
    pub(super) inputs: Vec<f32>,
    pub(super) targets: Vec<(u32, u32, f32)>,
}

/// The network, and buffers for one batch.
pub(super) struct Descent {
    /// Scale and shift after the normalisation of the input, if any.
    pub(super) normalisation: Option<[Trained; 2]>,
    pub(super) layers: Vec<Layer>,
    /// Steps taken.
    pub(super) steps: u64,
    betas: [f64; 2],
    epsilon: f64,
    /// Normalised inputs before scale and shift, a row per reading and a column per sample.
    centred: Vec<f32>,
    /// Inputs of each layer, and outputs of the last, in tiles.
    values: Vec<Vec<f32>>,
    /// Derivatives of the loss with respect to the output of each layer before its activation (ELU).
    slopes: Vec<Vec<f32>>,
}

impl Descent {
    /// Weights uniform within sqrt(6 / (inputs + outputs)) (Glorot), biases 0, drawn from the seed.
    pub(super) fn new(settings: &DeepSettings, inputs: usize, outputs: usize, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(INITIAL);
        let widths = settings.widths(inputs, outputs);
        let layers = widths
            .windows(2)
            .map(|pair| {
                let limit = (6.0 / (pair[0] + pair[1]) as f32).sqrt();
                let weights: Vec<f32> = (0..pair[0] * pair[1])
                    .map(|_| (2.0 * random.random::<f32>() - 1.0) * limit)
                    .collect();
                Layer {
                    inputs: pair[0],
                    outputs: pair[1],
                    weights: Trained::new(product::in_panels(&weights, pair[0])),
                    bias: Trained::new(vec![0.0; tiled(pair[1])]),
                }
            })
            .collect();
        Self {
            normalisation: settings
                .batch_normalisation
                .then(|| [vec![1.0; inputs], vec![0.0; inputs]].map(Trained::new)),
            layers,
            steps: 0,
            betas: [settings.beta1, settings.beta2],
            epsilon: settings.epsilon,
            centred: Vec::new(),
            slopes: vec![Vec::new(); widths.len() - 1],
            values: vec![Vec::new(); widths.len()],
        }
    }

    /// All trained parameters, in a fixed order.
    pub(super) fn trained(&self) -> impl Iterator<Item = &Trained> {
        let layers = self
            .layers
            .iter()
            .flat_map(|layer| [&layer.weights, &layer.bias]);
        self.normalisation.iter().flatten().chain(layers)
    }

    /// All trained parameters in the order of [`Self::trained`], mutable.
    pub(super) fn trained_mut(&mut self) -> impl Iterator<Item = &mut Trained> {
        let layers = self
            .layers
            .iter_mut()
            .flat_map(|layer| [&mut layer.weights, &mut layer.bias]);
        self.normalisation.iter_mut().flatten().chain(layers)
    }

    /// Number of trained parameters.
    pub(super) fn parameters(&self) -> usize {
        let normalisation = self.normalisation.iter().flatten();
        let layers = self.layers.iter();
        normalisation.map(|part| part.values.len()).sum::<usize>()
            + layers
                .map(|layer| (layer.inputs + 1) * layer.outputs)
                .sum::<usize>()
    }

    /// Mean loss of a batch (half the squared error of a map, summed over its triangles). Stores the derivatives with
    /// respect to the output in the last entry of `slopes`. `statistics` (mean and 1 / standard deviation of each
    /// reading) normalise the input; if `None`, the statistics of the batch are used.
    pub(super) fn loss(
        &mut self,
        batch: &Batch,
        statistics: Option<&[Vec<f32>; 2]>,
        epsilon: f64,
    ) -> f64 {
        let b = batch.samples;
        let strips = b.div_ceil(STRIP);
        self.centred.clone_from(&batch.inputs);
        if self.normalisation.is_some() {
            normalise(&mut self.centred, b, statistics, epsilon);
        }
        let inputs = &mut self.values[0];
        inputs.clear();
        inputs.resize(tiled(self.centred.len() / b) * strips * STRIP, 0.0);
        for (reading, row) in self.centred.chunks_exact(b).enumerate() {
            let (scale, shift) = match &self.normalisation {
                Some([scale, shift]) => (scale.values[reading], shift.values[reading]),
                None => (1.0, 0.0),
            };
            for (sample, value) in row.iter().enumerate() {
                inputs[place(reading, sample, strips)] = value * scale + shift;
            }
        }
        let last = self.layers.len() - 1;
        for (index, layer) in self.layers.iter().enumerate() {
            let (before, after) = self.values.split_at_mut(index + 1);
            let (inputs, outputs) = (&before[index], &mut after[0]);
            outputs.resize(tiled(layer.outputs) * strips * STRIP, 0.0);
            outputs
                .par_chunks_mut(TILE * strips * STRIP)
                .zip(layer.weights.values.par_chunks(TILE * tiled(layer.inputs)))
                .zip(layer.bias.values.par_chunks(TILE))
                .for_each(|((outputs, weights), bias)| {
                    for strip in outputs.chunks_exact_mut(TILE * STRIP) {
                        for (row, bias) in strip.chunks_exact_mut(STRIP).zip(bias) {
                            row.fill(*bias);
                        }
                    }
                    product::forward(weights, inputs, outputs);
                    if index < last {
                        elu(outputs);
                    }
                });
        }
        let errors = &mut self.slopes[last];
        errors.clone_from(&self.values[last + 1]);
        for &(triangle, sample, change) in &batch.targets {
            errors[place(triangle as usize, sample as usize, strips)] -= change;
        }
        // samples that only pad the last strip have no error
        for (block, rows) in errors.chunks_exact_mut(TILE * STRIP).enumerate() {
            if block % strips == strips - 1 {
                for row in rows.chunks_exact_mut(STRIP) {
                    row[b - (strips - 1) * STRIP..].fill(0.0);
                }
            }
        }
        let sums: Vec<f64> = errors
            .par_chunks_mut(TILE * strips * STRIP)
            .map(|errors| {
                let sum = errors.iter().map(|e| f64::from(e * e)).sum::<f64>();
                for error in errors {
                    *error /= b as f32;
                }
                sum
            })
            .collect();
        0.5 * sums.iter().sum::<f64>() / b as f64
    }

    /// One step of Adam on a batch; returns its loss before the step.
    pub(super) fn step(&mut self, batch: &Batch, rate: f64, epsilon: f64) -> f64 {
        let loss = self.loss(batch, None, epsilon);
        let b = batch.samples;
        let strips = b.div_ceil(STRIP);
        self.steps += 1;
        let step = Step::new(rate, self.betas[0], self.betas[1], self.epsilon, self.steps);
        for index in (0..self.layers.len()).rev() {
            let (before, after) = self.slopes.split_at_mut(index);
            let slopes = &after[0];
            let inputs = &self.values[index];
            let layer = &mut self.layers[index];
            let back = |tile: usize, below: &mut [f32]| {
                below.fill(0.0);
                product::backward(&layer.weights.values, slopes, tile, below);
            };
            // the derivatives of lower layers are computed with the weights before the step
            if let Some(below) = before.last_mut() {
                below.resize(inputs.len(), 0.0);
                below
                    .par_chunks_mut(TILE * strips * STRIP)
                    .zip(inputs.par_chunks(TILE * strips * STRIP))
                    .enumerate()
                    .for_each(|(tile, (below, inputs))| {
                        back(tile, below);
                        for (slope, value) in below.iter_mut().zip(inputs) {
                            *slope *= elu_slope(*value);
                        }
                    });
            } else if let Some([scale, shift]) = &mut self.normalisation {
                let mut below = vec![0.0; inputs.len()];
                below
                    .par_chunks_mut(TILE * strips * STRIP)
                    .enumerate()
                    .for_each(|(tile, below)| back(tile, below));
                let along = |row: usize, factor: &dyn Fn(usize) -> f32| -> f32 {
                    (0..b)
                        .map(|s| below[place(row, s, strips)] * factor(s))
                        .sum()
                };
                let centred: Vec<&[f32]> = self.centred.chunks_exact(b).collect();
                let rows = 0..centred.len();
                let scales: Vec<f32> = rows
                    .clone()
                    .map(|row| along(row, &|s| centred[row][s]))
                    .collect();
                let shifts: Vec<f32> = rows.map(|row| along(row, &|_| 1.0)).collect();
                scale.step(step, &scales);
                shift.step(step, &shifts);
            }
            let Layer { weights, bias, .. } = layer;
            let pair = 2 * PANEL * tiled(layer.inputs);
            let biases: Vec<[f32; 2 * PANEL]> = weights
                .values
                .par_chunks_mut(pair)
                .zip(weights.first.par_chunks_mut(pair))
                .zip(weights.second.par_chunks_mut(pair))
                .enumerate()
                .map_init(
                    || (Vec::new(), vec![0.0; 2 * PANEL * TILE]),
                    |(turned, gradient), (index, ((values, first), second))| {
                        let sums = product::turn(slopes, index, strips, turned);
                        for (tile, inputs) in inputs.chunks_exact(TILE * strips * STRIP).enumerate()
                        {
                            product::gradient(turned, inputs, gradient);
                            for (panel, gradient) in gradient.chunks_exact(TILE * PANEL).enumerate()
                            {
                                let from = panel * pair / 2 + tile * TILE * PANEL;
                                let range = from..from + TILE * PANEL;
                                let moments =
                                    [&mut first[range.clone()], &mut second[range.clone()]];
                                step.take(&mut values[range], moments, gradient);
                            }
                        }
                        sums
                    },
                )
                .collect();
            bias.step(step, biases.as_flattened());
        }
        loss
    }
}

/// Scales each row to mean 0 and standard deviation 1: with the given mean and 1 / standard deviation, or with the
/// row's own, `epsilon` being added to the variance.
fn normalise(rows: &mut [f32], b: usize, statistics: Option<&[Vec<f32>; 2]>, epsilon: f64) {
    for (index, row) in rows.chunks_exact_mut(b).enumerate() {
        let (mean, inverse) = match statistics {
            Some([mean, inverse]) => (mean[index], inverse[index]),
            None => {
                let mean = row.iter().map(|v| f64::from(*v)).sum::<f64>() / b as f64;
                let square: f64 = row.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum();
                (
                    mean as f32,
                    (square / b as f64 + epsilon).sqrt().recip() as f32,
                )
            }
        };
        for value in row {
            *value = (*value - mean) * inverse;
        }
    }
}
