//! Settings and results of a deep training, as stored in a model file.

use serde::{Deserialize, Serialize};

use crate::inverse::learned::network::Precision;

/// Settings of a deep training; the defaults are the paper's (section 5.3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DeepSettings {
    /// Hidden layers. Section 4.2 of the paper says three, section 5.3 four; four gives its 21 million weights.
    pub hidden_layers: usize,
    /// Neurons of each.
    pub width: usize,
    /// Batch normalisation of the input: by mean and variance of each batch while training, of all samples afterwards.
    pub batch_normalisation: bool,
    /// Offset added to the variance of each (normalised) reading in the batch normalisation; the paper does not state
    /// it, 1e-5 is the default of its tool. Readings whose standard deviation is below the square root of the offset
    /// are amplified less: with little noise, a smaller value makes smaller loads visible.
    pub normalisation_epsilon: f64,
    /// Passes over the training set.
    pub epochs: usize,
    /// Samples per step.
    pub batch: usize,
    /// Adam's initial learning rate.
    pub learning_rate: f64,
    /// Epochs between drops of the learning rate; 0: never.
    pub drop_every: usize,
    /// Factor of each drop.
    pub drop_factor: f64,
    /// Decay of Adam's mean of the gradient.
    pub beta1: f64,
    /// Decay of Adam's mean of the squared gradient; the paper does not state it, 0.999 is Adam's default.
    pub beta2: f64,
    /// Adam's denominator offset.
    pub epsilon: f64,
    /// Cases held out of training: each epoch is evaluated on them, and the weights of the best epoch are kept.
    pub held_out: usize,
    /// Training ends after this many epochs without a better held-out loss; 0: never.
    pub patience: usize,
}

impl Default for DeepSettings {
    fn default() -> Self {
        Self {
            hidden_layers: 4,
            width: 2048,
            batch_normalisation: true,
            normalisation_epsilon: 1e-5,
            epochs: 30,
            batch: 128,
            learning_rate: 1e-3,
            drop_every: 10,
            drop_factor: 0.1,
            beta1: 0.9,
            beta2: 0.999,
            epsilon: 1e-8,
            held_out: 500,
            patience: 0,
        }
    }
}

impl DeepSettings {
    /// The learning rate of an epoch, from 0.
    pub fn rate(&self, epoch: usize) -> f64 {
        let drops = epoch.checked_div(self.drop_every).unwrap_or_default();
        self.learning_rate * self.drop_factor.powi(drops.try_into().unwrap_or(i32::MAX))
    }

    /// Widths from input to output.
    pub fn widths(&self, inputs: usize, outputs: usize) -> Vec<usize> {
        let hidden = std::iter::repeat_n(self.width, self.hidden_layers);
        [inputs]
            .into_iter()
            .chain(hidden)
            .chain([outputs])
            .collect()
    }

    /// The first invalid setting: its name, and what it must be.
    pub fn fault(&self) -> Option<(&'static str, &'static str)> {
        let whole = |value: usize| value > 0;
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let share = |value: f64| (0.0..1.0).contains(&value);
        [
            ("hidden_layers", whole(self.hidden_layers), "1 or more"),
            ("width", whole(self.width), "1 or more"),
            ("epochs", whole(self.epochs), "1 or more"),
            ("batch", self.batch > 1, "2 or more"),
            (
                "learning_rate",
                positive(self.learning_rate),
                "a positive number",
            ),
            (
                "drop_factor",
                positive(self.drop_factor),
                "a positive number",
            ),
            ("beta1", share(self.beta1), "from 0 to below 1"),
            ("beta2", share(self.beta2), "from 0 to below 1"),
            ("epsilon", positive(self.epsilon), "a positive number"),
            (
                "normalisation_epsilon",
                positive(self.normalisation_epsilon),
                "a positive number",
            ),
            ("held_out", whole(self.held_out), "1 or more"),
        ]
        .into_iter()
        .find(|(_, sound, _)| !sound)
        .map(|(name, _, must)| (name, must))
    }
}

/// Results of a deep training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DeepReport {
    /// How it was trained.
    pub settings: DeepSettings,
    /// Number of weights and biases.
    pub parameters: usize,
    /// Samples of one epoch.
    pub samples: usize,
    /// Epochs that were run.
    pub epochs: usize,
    /// The epoch whose weights were kept, from 1.
    pub best_epoch: usize,
    /// Mean of that epoch's training loss: half the squared error of a map, summed over its triangles.
    pub training_loss: f64,
    /// The same on held-out cases, each with one draw of the jitter.
    pub held_out_loss: f64,
    /// The same for empty maps: the loss of a network that always returns zero.
    pub empty_loss: f64,
    /// The precision of the stored weights, and its cost.
    pub kept: Rounding,
}

/// The cost of rounding the weights, on the held-out cases.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rounding {
    /// Precision of the stored weights.
    pub precision: Precision,
    /// Root mean square change of the maps by rounding, over that of the maps.
    pub map_change: f64,
    /// Loss on held-out cases with the rounded weights.
    pub held_out_loss: f64,
}

impl DeepReport {
    /// User-readable results, one sentence each.
    pub(crate) fn sentences(&self) -> Vec<String> {
        let mut sentences = vec![format!(
            "loss on held-out cases {:.3}, {:.0} % of an empty map's, at epoch {} of {}",
            self.held_out_loss,
            100.0 * self.held_out_loss / self.empty_loss,
            self.best_epoch,
            self.epochs
        )];
        if self.kept.precision != Precision::F32 {
            sentences.push(format!(
                "weights are kept in {}, which changes maps by {:.1e} of their root mean square and the held-out loss to {:.3}",
                self.kept.precision.name(),
                self.kept.map_change,
                self.kept.held_out_loss
            ));
        }
        sentences
    }
}
