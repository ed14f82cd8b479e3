//! Batches of samples with their jitter, and statistics of the inputs of a training set.

use eit::inverse::learned::network::TrainingDistribution;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::descent::Batch;
use crate::samples::{Noise, Sample, SampleError, Samples};

/// Random stream for the order of an epoch.
const ORDER: u64 = 201 << 48;
/// Maximum number of inputs for the statistics.
const STATISTICS_INPUTS: usize = 20_000;

/// A training set with its jitter: the last `held_out` cases are held out.
#[derive(Clone, Copy)]
pub(super) struct JitteredSet<'a> {
    pub(super) samples: &'a dyn Samples,
    pub(super) noise: &'a Noise,
    pub(super) repeats: usize,
    pub(super) held_out: usize,
}

/// Statistics of the inputs of a training set.
pub(super) struct InputStatistics {
    /// Mean and 1 / standard deviation of each reading.
    pub(super) statistics: [Vec<f32>; 2],
    pub(super) familiar: TrainingDistribution,
}

impl JitteredSet<'_> {
    /// Number of training cases.
    pub(super) fn cases(self) -> usize {
        self.samples.len() - self.held_out
    }

    /// Number of samples in an epoch.
    pub(super) fn len(self) -> usize {
        self.cases() * self.repeats
    }

    /// Case `case` with the jitter of one copy.
    fn jittered(self, copy: usize, case: usize) -> Result<Sample, SampleError> {
        let mut sample = self.samples.sample(case)?;
        // not every set checks its numbers, and one that is not finite would spoil every weight
        sample.check("the training set", case)?;
        self.noise
            .add(&mut sample.input, copy, case, self.samples.len());
        Ok(sample)
    }

    /// Fills a batch with the given (copy, case) pairs.
    pub(super) fn fill(
        self,
        batch: &mut Batch,
        which: impl IndexedParallelIterator<Item = (usize, usize)>,
    ) -> Result<(), SampleError> {
        let samples = which
            .map(|(copy, case)| self.jittered(copy, case))
            .collect::<Result<Vec<_>, _>>()?;
        batch.samples = samples.len();
        batch.inputs.clear();
        for reading in 0..self.samples.inputs() {
            batch
                .inputs
                .extend(samples.iter().map(|sample| sample.input[reading]));
        }
        batch.targets.clear();
        for (index, sample) in samples.iter().enumerate() {
            let entries = sample.target.iter();
            batch
                .targets
                .extend(entries.map(|&(triangle, change)| (triangle, index as u32, change)));
        }
        Ok(())
    }

    /// The order of an epoch: every sample once, (copy, case).
    pub(super) fn order(self, seed: u64, epoch: usize) -> Vec<(usize, usize)> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(ORDER | epoch as u64);
        let cases = self.cases();
        let mut order: Vec<(usize, usize)> = (0..self.len())
            .map(|sample| (sample / cases, sample % cases))
            .collect();
        for last in (1..order.len()).rev() {
            order.swap(last, random.random_range(0..=last));
        }
        order
    }

    /// The held-out cases as (copy, case), each with a copy of the jitter that the training never uses.
    pub(super) fn kept_back(self) -> Vec<(usize, usize)> {
        (self.cases()..self.samples.len())
            .map(|case| (self.repeats + case % self.noise.levels(), case))
            .collect()
    }

    /// Mean and 1 / standard deviation of each reading over the training inputs (`epsilon` added to the variance), and
    /// the distribution of the inputs.
    pub(super) fn describe(self, epsilon: f64) -> Result<Option<InputStatistics>, SampleError> {
        let rows = (0..self.cases().min(STATISTICS_INPUTS))
            .into_par_iter()
            .map(|case| {
                let copy = case % self.noise.levels();
                self.jittered(copy, case).map(|sample| sample.input)
            })
            .collect::<Result<Vec<_>, _>>()?;
        let (width, count) = (self.samples.inputs(), rows.len() as f64);
        let mut mean = vec![0.0; width];
        let mut square = vec![0.0; width];
        for row in &rows {
            for (mean, value) in mean.iter_mut().zip(row) {
                *mean += f64::from(*value) / count;
            }
        }
        for row in &rows {
            for ((square, mean), value) in square.iter_mut().zip(&mean).zip(row) {
                *square += (f64::from(*value) - mean).powi(2) / count;
            }
        }
        let inverse = square
            .iter()
            .map(|square| (square + epsilon).sqrt().recip() as f32)
            .collect();
        let mean = mean.into_iter().map(|value| value as f32).collect();
        let familiar = TrainingDistribution::learn(&rows.concat(), width);
        Ok(familiar.map(|familiar| InputStatistics {
            statistics: [mean, inverse],
            familiar,
        }))
    }
}
