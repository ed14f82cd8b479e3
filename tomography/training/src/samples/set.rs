//! A training set in memory.

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::{Noise, Progress, Sample, SampleError, Samples, Sparse, Stage, TrainError};

/// Cases without jitter, in memory.
pub struct TrainingSet {
    /// Readings of the baseline at 1 A.
    pub baseline: Vec<f64>,
    /// Number of triangles of the region.
    outputs: usize,
    /// Normalised inputs (Eq. 6), one row per case.
    pub(crate) inputs: Vec<f32>,
    /// Relative changes of the region's triangles.
    pub(crate) targets: Vec<Sparse>,
}

impl TrainingSet {
    /// Reads a whole set into memory.
    ///
    /// # Errors
    /// A sample that cannot be read.
    pub fn read(samples: &dyn Samples, progress: Progress<'_>) -> Result<Self, TrainError> {
        let done = AtomicUsize::new(0);
        let read = (0..samples.len())
            .into_par_iter()
            .map(|case| {
                let sample = samples.sample(case)?;
                sample.check("the training set", case)?;
                let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                progress(Stage::Cases, done, samples.len());
                Ok(sample)
            })
            .collect::<Result<Vec<_>, SampleError>>()?;
        let mut inputs = Vec::with_capacity(samples.len() * samples.inputs());
        let mut targets = Vec::with_capacity(samples.len());
        for Sample { input, target } in read {
            inputs.extend(input);
            targets.push(target);
        }
        Ok(Self {
            baseline: samples.baseline().to_vec(),
            outputs: samples.outputs(),
            inputs,
            targets,
        })
    }

    /// Eq. 8: `repeats` copies of the inputs, one after another, each with its own noise.
    pub(crate) fn jittered(&self, repeats: usize, noise: &Noise) -> Vec<f32> {
        let (width, cases) = (self.baseline.len(), self.targets.len());
        let mut inputs = self.inputs.repeat(repeats);
        inputs
            .par_chunks_mut(width)
            .enumerate()
            .for_each(|(sample, row)| noise.add(row, sample / cases, sample % cases, cases));
        inputs
    }
}

impl Samples for TrainingSet {
    fn len(&self) -> usize {
        self.targets.len()
    }

    fn outputs(&self) -> usize {
        self.outputs
    }

    fn baseline(&self) -> &[f64] {
        &self.baseline
    }

    fn sample(&self, case: usize) -> Result<Sample, SampleError> {
        let width = self.baseline.len();
        Ok(Sample {
            input: self.inputs[case * width..(case + 1) * width].to_vec(),
            target: self.targets[case].clone(),
        })
    }
}
