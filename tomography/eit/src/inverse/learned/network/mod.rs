//! The deep network of the paper (section 4.2): fully connected layers, exponential linear units, one output per
//! triangle.
//!
//! x_0 = (dv - mean) gain + shift (batch normalisation of the input), x_l = elu(W_l x_{l-1} + b_l) (Eq. 10), the last
//! layer without elu. A frame reads every weight once, so memory bandwidth determines its time: weights may be stored
//! as f16 or int8; products and sums are always in f32. Training is in the crate `training`.
//!
//! Symbols: `inputs` readings, `outputs` triangles of the region; a layer's weights are row-major, a row per output.

mod deep;
mod elu;
mod history;
mod kernel;
mod onnx;
mod training_distribution;
mod weights;

use rayon::prelude::*;

pub(crate) use crate::inverse::learned::network::deep::FamiliarDeep;
pub use crate::inverse::learned::network::elu::{elu, elu_slope};
pub use crate::inverse::learned::network::history::{DeepReport, DeepSettings, Rounding};
pub use crate::inverse::learned::network::onnx::{OnnxError, is_onnx, load_onnx};
pub use crate::inverse::learned::network::training_distribution::{
    FAMILIAR_SHARE, TrainingDistribution,
};
pub use crate::inverse::learned::network::weights::{Precision, Weights};

/// `output[r] = sum_i rows[r][i] input[i]`, at memory bandwidth; the last bits depend on the processor's instructions.
pub(crate) fn rows_times(rows: &[f32], input: &[f32], output: &mut [f32]) {
    kernel::multiply(weights::Rows::F32(rows), input, output);
}

/// Rows of a layer that one task multiplies: the same partition on any number of threads.
const ROWS: usize = 64;

/// One fully connected layer.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Weights: a row per output, an entry per input.
    pub weights: Weights,
    /// One entry per output.
    pub bias: Vec<f32>,
}

impl Layer {
    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.weights.len() / self.bias.len().max(1)
    }

    /// W x + b, followed by elu if `activated`.
    fn respond(&self, input: &[f32], activated: bool) -> Vec<f32> {
        let mut output = vec![0.0; self.outputs()];
        output
            .par_chunks_mut(ROWS)
            .enumerate()
            .for_each(|(task, output)| {
                let first = task * ROWS;
                kernel::multiply(
                    self.weights.rows(first, output.len(), input.len()),
                    input,
                    output,
                );
                for (value, bias) in output.iter_mut().zip(&self.bias[first..]) {
                    *value += bias;
                }
                if activated {
                    elu(output);
                }
            });
        output
    }
}

/// A trained deep network.
#[derive(Debug, Clone, PartialEq)]
pub struct DeepNetwork {
    /// Mean of each input, subtracted first.
    mean: Vec<f32>,
    /// Factor applied after that.
    gain: Vec<f32>,
    /// Offset added last.
    shift: Vec<f32>,
    layers: Vec<Layer>,
}

impl DeepNetwork {
    /// Combines a normalisation of the input, one entry per reading, with layers from input to output.
    ///
    /// # Errors
    /// Layers that do not fit each other, or numbers that are not finite, in words.
    pub fn new(
        mean: Vec<f32>,
        gain: Vec<f32>,
        shift: Vec<f32>,
        layers: Vec<Layer>,
    ) -> Result<Self, String> {
        if gain.len() != mean.len() || shift.len() != mean.len() {
            return Err("its normalisation has parts of different lengths".to_owned());
        }
        let mut width = mean.len();
        for (index, layer) in layers.iter().enumerate() {
            if layer.outputs() == 0 || layer.weights.len() != layer.outputs() * width {
                return Err(format!(
                    "layer {} has {} weights and {} biases, it takes {width} numbers",
                    index + 1,
                    layer.weights.len(),
                    layer.outputs()
                ));
            }
            if let Weights::Int8 { scales, .. } = &layer.weights
                && scales.len() != layer.outputs()
            {
                return Err(format!(
                    "layer {} has {} scales and {} outputs",
                    index + 1,
                    scales.len(),
                    layer.outputs()
                ));
            }
            width = layer.outputs();
        }
        if layers.is_empty() || mean.is_empty() {
            return Err("it has no layers or no inputs".to_owned());
        }
        let network = Self {
            mean,
            gain,
            shift,
            layers,
        };
        let finite = |values: &[f32]| values.iter().all(|value| value.is_finite());
        let sound = finite(&network.mean)
            && finite(&network.gain)
            && finite(&network.shift)
            && network
                .layers
                .iter()
                .all(|layer| finite(&layer.bias) && layer.weights.is_finite());
        if sound {
            Ok(network)
        } else {
            Err("it has numbers that are not finite".to_owned())
        }
    }

    /// Number of inputs (readings).
    pub fn inputs(&self) -> usize {
        self.mean.len()
    }

    /// Number of outputs (triangles).
    pub fn outputs(&self) -> usize {
        self.layers.last().map_or(0, Layer::outputs)
    }

    /// The layers, from input to output.
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// Mean, gain and shift of the input's normalisation.
    pub fn normalisation(&self) -> [&[f32]; 3] {
        [&self.mean, &self.gain, &self.shift]
    }

    /// Precision of the stored weights.
    pub fn precision(&self) -> Precision {
        self.layers
            .first()
            .map_or(Precision::F32, |layer| layer.weights.precision())
    }

    /// Bytes of weights that one frame reads.
    pub fn weight_bytes(&self) -> usize {
        self.layers.iter().map(|layer| layer.weights.bytes()).sum()
    }

    /// The same network with its weights in another precision, rounded to the nearest from f32.
    pub fn with_precision(&self, precision: Precision) -> Self {
        let mut network = self.clone();
        for layer in &mut network.layers {
            let inputs = layer.inputs();
            layer.weights = layer.weights.rounded(precision, inputs);
        }
        network
    }

    /// The map of a normalised input (Eq. 6), one entry per reading. The same bits on any number of threads.
    pub fn predict(&self, input: &[f32]) -> Vec<f32> {
        let mut values: Vec<f32> = input
            .iter()
            .zip(&self.mean)
            .zip(self.gain.iter().zip(&self.shift))
            .map(|((value, mean), (gain, shift))| (value - mean) * gain + shift)
            .collect();
        for (index, layer) in self.layers.iter().enumerate() {
            values = layer.respond(&values, index + 1 < self.layers.len());
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use crate::inverse::learned::network::*;

    /// A network of these widths with weights like those of a trained one.
    fn network(widths: &[usize]) -> DeepNetwork {
        let wave = |count: usize, step: f32, size: f32| -> Vec<f32> {
            (0..count).map(|i| (i as f32 * step).sin() * size).collect()
        };
        let layers = widths
            .windows(2)
            .map(|pair| Layer {
                weights: Weights::F32(wave(
                    pair[0] * pair[1],
                    0.731,
                    (3.0 / pair[0] as f32).sqrt(),
                )),
                bias: wave(pair[1], 0.37, 0.1),
            })
            .collect();
        DeepNetwork::new(
            wave(widths[0], 0.21, 0.1),
            vec![1.5; widths[0]],
            vec![0.01; widths[0]],
            layers,
        )
        .unwrap()
    }

    /// Direct evaluation of the formula, in f64.
    fn by_formula(network: &DeepNetwork, input: &[f32]) -> Vec<f64> {
        let [mean, gain, shift] = network.normalisation();
        let mut values: Vec<f64> = (0..input.len())
            .map(|i| f64::from((input[i] - mean[i]) * gain[i] + shift[i]))
            .collect();
        for (index, layer) in network.layers().iter().enumerate() {
            let Weights::F32(weights) = &layer.weights else {
                unreachable!("the test's network is of f32")
            };
            values = (0..layer.outputs())
                .map(|row| {
                    let sum: f64 = weights[row * values.len()..]
                        .iter()
                        .zip(&values)
                        .map(|(w, x)| f64::from(*w) * x)
                        .sum();
                    let sum = sum + f64::from(layer.bias[row]);
                    let last = index + 1 == network.layers().len();
                    if last || sum > 0.0 { sum } else { sum.exp_m1() }
                })
                .collect();
        }
        values
    }

    #[test]
    fn a_map_follows_the_formula_in_every_precision() {
        // widths that are not multiples of any vector length
        let network = network(&[59, 131, 77, 201]);
        let input: Vec<f32> = (0..59).map(|i| (i as f32 * 0.9).cos()).collect();
        let exact = by_formula(&network, &input);
        let largest = exact.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
        for (precision, tolerance) in [
            (Precision::F32, 4e-6),
            (Precision::F16, 4e-3),
            (Precision::Int8, 4e-2),
        ] {
            let kept = network.with_precision(precision);
            assert_eq!(kept.precision(), precision);
            let map = kept.predict(&input);
            let worst = map
                .iter()
                .zip(&exact)
                .map(|(a, b)| (f64::from(*a) - b).abs())
                .fold(0.0, f64::max);
            assert!(
                worst < tolerance * largest,
                "{precision:?}: {:e} of the largest",
                worst / largest
            );
        }
    }

    #[test]
    fn one_thread_and_three_give_the_same_bits() {
        let network = network(&[60, 300, 500]);
        let input: Vec<f32> = (0..60).map(|i| (i as f32 * 0.9).cos()).collect();
        let bits = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let map = pool.install(|| network.predict(&input));
            map.iter().map(|value| value.to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(bits(1), bits(3));
    }

    #[test]
    fn layers_that_do_not_fit_are_refused() {
        let good = network(&[6, 8, 4]);
        let [mean, gain, shift] = good.normalisation().map(<[f32]>::to_vec);
        let mut layers = good.layers().to_vec();
        layers.swap(0, 1);
        assert!(DeepNetwork::new(mean.clone(), gain.clone(), shift.clone(), layers).is_err());
        let mut layers = good.layers().to_vec();
        layers[1].bias[2] = f32::NAN;
        assert!(DeepNetwork::new(mean.clone(), gain.clone(), shift.clone(), layers).is_err());
        assert!(DeepNetwork::new(mean, gain[1..].to_vec(), shift, good.layers().to_vec()).is_err());
    }
}
