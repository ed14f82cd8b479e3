//! The training loop: epochs in random order, the held-out loss after each, and the weights of the best epoch.

use std::path::Path;

use eit::inverse::learned::network::{Layer, Rounding, TrainingDistribution, Weights};
use eit::{DeepNetwork, DeepReport, DeepSettings, Precision};
use rayon::prelude::*;

use super::batch::{InputStatistics, JitteredSet};
use super::checkpoint::{self, CheckpointFault, TrainingState};
use super::descent::{Batch, Descent};
use crate::samples::{Noise, SampleError, Samples};

/// Number of held-out cases with which the error by rounding the weights is measured.
const ROUNDED: usize = 100;

/// Inputs of a deep training.
pub struct Recipe<'a> {
    /// The set; its last `settings.held_out` cases are held out.
    pub samples: &'a dyn Samples,
    /// Noise added to each copy of a case.
    pub noise: &'a Noise,
    /// Number of jittered copies of each case.
    pub repeats: usize,
    /// Layers, batch, rate, epochs.
    pub settings: DeepSettings,
    /// Seed of the initial weights and of the order of samples.
    pub seed: u64,
    /// Precision of the stored weights.
    pub precision: Precision,
    /// File of the checkpoint that is written after each epoch and from which a run resumes; and a hash of everything
    /// that determines the bits of the result.
    pub checkpoint: Option<(&'a Path, String)>,
}

/// Progress of a training.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrainingEvent {
    /// Resumed from a checkpoint.
    Resumed {
        /// Completed epochs.
        epochs: usize,
    },
    /// A step is complete.
    Step {
        /// The epoch, from 1.
        epoch: usize,
        /// Completed steps of this epoch.
        step: usize,
        /// Number of steps of an epoch.
        of: usize,
    },
    /// An epoch is complete.
    Epoch {
        /// The epoch, from 1.
        epoch: usize,
        /// Mean loss of the training samples.
        training: f64,
        /// Mean loss of the held-out cases.
        held_out: f64,
        /// Whether `held_out` is the smallest loss so far.
        best: bool,
    },
}

/// Errors of a deep training.
#[derive(Debug, thiserror::Error)]
pub enum DeepFault {
    /// An invalid setting.
    #[error("setting {setting} of the deep network must be {must}")]
    Setting {
        /// Its name.
        setting: &'static str,
        /// What it must be.
        must: &'static str,
    },
    /// Fewer samples than a batch.
    #[error(
        "{cases} cases with {repeats} copies ({held_out} more are held out) are fewer samples than a batch of {batch}: more cases or a smaller batch are needed"
    )]
    Few {
        /// Number of cases that are not held out.
        cases: usize,
        /// Number of copies of each case.
        repeats: usize,
        /// Number of samples of a batch.
        batch: usize,
        /// Number of held-out cases.
        held_out: usize,
    },
    /// All samples are equal.
    #[error("all samples of the training set are alike: more cases or larger loads are needed")]
    Alike,
    /// A sample of the set cannot be read.
    #[error("the training set")]
    Sample(#[from] SampleError),
    /// The loss diverged.
    #[error(
        "the loss is {loss} at step {step} of epoch {epoch}: the training diverged; give a smaller learning_rate"
    )]
    RanAway {
        /// Loss of the batch, or of the held-out cases after the last step.
        loss: f64,
        /// Step of the epoch.
        step: usize,
        /// The epoch, from 1.
        epoch: usize,
    },
    /// The checkpoint cannot be written or read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointFault),
    /// The weights do not form a valid network.
    #[error("the trained network: {0}")]
    Network(String),
}

/// Trains a network. Equal inputs give equal bits, on any number of threads, in one run or several.
///
/// # Errors
/// See [`DeepFault`].
pub fn train(
    recipe: &Recipe<'_>,
    progress: &dyn Fn(TrainingEvent),
) -> Result<(DeepNetwork, TrainingDistribution, DeepReport), DeepFault> {
    let Recipe {
        samples, settings, ..
    } = recipe;
    if let Some((setting, must)) = settings.fault() {
        return Err(DeepFault::Setting { setting, must });
    }
    let feed = JitteredSet {
        samples: *samples,
        noise: recipe.noise,
        repeats: recipe.repeats,
        held_out: settings.held_out.min(samples.len()),
    };
    let batches = feed.len() / settings.batch;
    if recipe.repeats < recipe.noise.levels() {
        return Err(DeepFault::Setting {
            setting: "repeats",
            must: "as many as there are levels of noise, or more",
        });
    }
    if batches == 0 {
        return Err(DeepFault::Few {
            cases: feed.cases(),
            repeats: recipe.repeats,
            batch: settings.batch,
            held_out: settings.held_out,
        });
    }
    let epsilon = settings.normalisation_epsilon;
    let InputStatistics {
        statistics,
        familiar,
    } = feed.describe(epsilon)?.ok_or(DeepFault::Alike)?;
    let mut descent = Descent::new(settings, samples.inputs(), samples.outputs(), recipe.seed);
    let mut best: Vec<Vec<f32>> = descent.trained().map(|part| part.values.clone()).collect();
    let mut course = TrainingState {
        fingerprint: String::new(),
        epochs: 0,
        steps: 0,
        best: None,
    };
    if let Some((path, fingerprint)) = &recipe.checkpoint {
        if let Some(kept) = checkpoint::read(path, &mut descent, &mut best, fingerprint)? {
            progress(TrainingEvent::Resumed {
                epochs: kept.epochs,
            });
            course = kept;
        }
        course.fingerprint.clone_from(fingerprint);
    }
    let mut batch = Batch::default();
    let empty = empty_loss(&feed)?;
    while course.epochs < settings.epochs && !tired(&course, settings) {
        let epoch = course.epochs + 1;
        let order = feed.order(recipe.seed, epoch);
        let mut sum = 0.0;
        // the samples of the last, incomplete batch are skipped in this epoch
        for (step, which) in order.chunks_exact(settings.batch).enumerate() {
            feed.fill(&mut batch, which.par_iter().copied())?;
            let loss = descent.step(&batch, settings.rate(epoch - 1), epsilon);
            if !loss.is_finite() {
                return Err(DeepFault::RanAway {
                    loss,
                    step: step + 1,
                    epoch,
                });
            }
            sum += loss;
            progress(TrainingEvent::Step {
                epoch,
                step: step + 1,
                of: batches,
            });
        }
        let training = sum / batches as f64;
        let held_out = held_out_loss(&mut descent, &feed, settings, &statistics)?;
        if !held_out.is_finite() {
            if course.best.is_some() {
                // the checkpoint stays at the last good epoch, so that a resumed run ends here too
                progress(TrainingEvent::Epoch {
                    epoch,
                    training,
                    held_out,
                    best: false,
                });
                break;
            }
            return Err(DeepFault::RanAway {
                loss: held_out,
                step: batches,
                epoch,
            });
        }
        let better = course.best.is_none_or(|(_, _, least)| held_out < least);
        if better {
            course.best = Some((epoch, training, held_out));
            for (best, part) in best.iter_mut().zip(descent.trained()) {
                best.clone_from(&part.values);
            }
        }
        course.epochs = epoch;
        course.steps = descent.steps;
        if let Some((path, _)) = &recipe.checkpoint {
            checkpoint::write(path, &descent, &best, &course)?;
        }
        progress(TrainingEvent::Epoch {
            epoch,
            training,
            held_out,
            best: better,
        });
    }
    for (part, best) in descent.trained_mut().zip(&best) {
        part.values.clone_from(best);
    }
    let exact = network(&descent, &statistics)?;
    let kept = exact.with_precision(recipe.precision);
    let (best_epoch, training_loss, held_out_loss) = course.best.unwrap_or((0, f64::NAN, f64::NAN));
    let report = DeepReport {
        settings: settings.clone(),
        parameters: descent.parameters(),
        samples: feed.len(),
        epochs: course.epochs,
        best_epoch,
        training_loss,
        held_out_loss,
        empty_loss: empty,
        kept: rounding(&exact, &kept, &feed)?,
    };
    Ok((kept, familiar, report))
}

/// Whether the held-out loss has not improved for `patience` epochs.
fn tired(course: &TrainingState, settings: &DeepSettings) -> bool {
    let since = course.best.map_or(0, |(best, ..)| course.epochs - best);
    settings.patience > 0 && since >= settings.patience
}

fn held_out_loss(
    descent: &mut Descent,
    feed: &JitteredSet<'_>,
    settings: &DeepSettings,
    statistics: &[Vec<f32>; 2],
) -> Result<f64, SampleError> {
    let mut batch = Batch::default();
    let mut sum = 0.0;
    let kept_back = feed.kept_back();
    for which in kept_back.chunks(settings.batch) {
        feed.fill(&mut batch, which.par_iter().copied())?;
        let loss = descent.loss(&batch, Some(statistics), settings.normalisation_epsilon);
        sum += loss * which.len() as f64;
    }
    Ok(sum / kept_back.len() as f64)
}

/// The mean loss of empty maps for the held-out cases.
fn empty_loss(feed: &JitteredSet<'_>) -> Result<f64, SampleError> {
    let mut sum = 0.0;
    let kept_back = feed.kept_back();
    for (_, case) in &kept_back {
        let target = feed.samples.sample(*case)?.target;
        sum += 0.5
            * target
                .iter()
                .map(|(_, change)| f64::from(*change).powi(2))
                .sum::<f64>();
    }
    Ok(sum / kept_back.len() as f64)
}

/// The network for inference, with the normalisation of the input combined to one mean, gain and shift for each
/// reading.
fn network(descent: &Descent, statistics: &[Vec<f32>; 2]) -> Result<DeepNetwork, DeepFault> {
    let [mean, inverse] = statistics.clone();
    let count = mean.len();
    let (mean, gain, shift) = match &descent.normalisation {
        Some([scale, shift]) => (
            mean,
            inverse
                .iter()
                .zip(&scale.values)
                .map(|(a, b)| a * b)
                .collect(),
            shift.values.clone(),
        ),
        None => (vec![0.0; count], vec![1.0; count], vec![0.0; count]),
    };
    let layers = descent
        .layers
        .iter()
        .map(|layer| {
            let (weights, bias) = layer.plain();
            Layer {
                weights: Weights::F32(weights),
                bias,
            }
        })
        .collect();
    DeepNetwork::new(mean, gain, shift, layers).map_err(DeepFault::Network)
}

/// Measures the error caused by the lower precision of the stored weights.
fn rounding(
    exact: &DeepNetwork,
    kept: &DeepNetwork,
    feed: &JitteredSet<'_>,
) -> Result<Rounding, SampleError> {
    let (mut changed, mut all, mut loss) = (0.0, 0.0, 0.0);
    let kept_back = feed.kept_back();
    let judged = &kept_back[..kept_back.len().min(ROUNDED)];
    let mut batch = Batch::default();
    for which in judged {
        feed.fill(&mut batch, rayon::iter::repeat_n(*which, 1))?;
        let [mut a, b] = [exact, kept].map(|network| network.predict(&batch.inputs));
        for (a, b) in a.iter().zip(&b) {
            changed += f64::from(a - b).powi(2);
            all += f64::from(*a).powi(2);
        }
        a.clone_from(&b);
        for &(triangle, _, change) in &batch.targets {
            a[triangle as usize] -= change;
        }
        loss += 0.5 * a.iter().map(|e| f64::from(*e).powi(2)).sum::<f64>();
    }
    Ok(Rounding {
        precision: kept.precision(),
        map_change: if all > 0.0 {
            (changed / all).sqrt()
        } else {
            0.0
        },
        held_out_loss: loss / judged.len() as f64,
    })
}

#[cfg(test)]
mod tests;
