//! Hard cases 19 to 24: radial basis functions that are almost parallel, and samples that are duplicated, heavy-tailed,
//! many, close together, or far from every neuron.

use eit::{Jitter, RbfNetwork, ReconstructError, TrainingReport, TrainingSettings};
use nalgebra::{DMatrix, DVector, SVD};
use training::rbf::train_rbf_on;
use training::samples::{Sample, SampleError, Samples, TrainError};

use crate::evaluation::mean_and_deviation;
use crate::failure::Failure;
use crate::readings::measured;
use crate::stability::outcome::{Check, Naive, Outcome, naive, worst};
use crate::stability::solvers::tank::Tank;
use training::rbf::SPREAD_RULED;

/// A training set with given samples.
pub(crate) struct Made {
    pub(crate) inputs: Vec<Vec<f32>>,
    pub(crate) targets: Vec<Vec<f32>>,
    pub(crate) baseline: Vec<f64>,
}

impl Made {
    pub(crate) fn new(inputs: Vec<Vec<f32>>, targets: Vec<Vec<f32>>) -> Self {
        Self {
            baseline: vec![1.0; inputs[0].len()],
            inputs,
            targets,
        }
    }

    pub(crate) fn settings(&self, neurons: usize) -> TrainingSettings {
        TrainingSettings {
            cases: self.inputs.len(),
            repeats: 1,
            neurons,
            // jitter that is negligible compared with any input
            jitter: Jitter::Matched {
                noise_v: 1e-30,
                current_a: 1.0,
            },
            ..TrainingSettings::default()
        }
    }

    fn train(
        &self,
        neurons: usize,
        spread_times: f64,
    ) -> Result<(RbfNetwork, TrainingReport), TrainError> {
        let settings = TrainingSettings {
            spread_times,
            ..self.settings(neurons)
        };
        train_rbf_on(self, &settings, &|_, _, _| {})
    }
}

impl Samples for Made {
    fn len(&self) -> usize {
        self.inputs.len()
    }

    fn outputs(&self) -> usize {
        self.targets[0].len()
    }

    fn baseline(&self) -> &[f64] {
        &self.baseline
    }

    fn sample(&self, case: usize) -> Result<Sample, SampleError> {
        let changes = self.targets[case].iter().enumerate();
        Ok(Sample {
            input: self.inputs[case].clone(),
            target: changes
                .map(|(unknown, change)| (unknown as u32, *change))
                .collect(),
        })
    }
}

/// A point on a curve in twelve dimensions, and its target.
fn curve(at: f64) -> (Vec<f32>, Vec<f32>) {
    let along = |k: usize| ((0.4 + 0.13 * k as f64) * at + k as f64).sin();
    let input = (0..12).map(|k| (0.5 + 1e-2 * along(k)) as f32).collect();
    let target = (0..4)
        .map(|k| -((0.3 * at + k as f64).sin().powi(2)) as f32)
        .collect();
    (input, target)
}

fn on_curve(count: usize) -> Made {
    let (inputs, targets) = (0..count)
        .map(|i| curve(6.0 * i as f64 / count as f64))
        .unzip();
    Made::new(inputs, targets)
}

fn untrained(fault: TrainError) -> Failure {
    Failure::of("the training", &fault)
}

fn squared(a: &[f32], b: &[f32]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
        .sum()
}

/// 19: neurons much wider than their distances.
pub(crate) fn flat_limit() -> Result<Outcome, Failure> {
    const SAMPLES: usize = 60;
    let set = on_curve(SAMPLES);
    // one neuron per sample, so that the centres are known
    let (network, report) = set.train(SAMPLES, 20.0).map_err(untrained)?;
    let spread = network.spread();
    let phi = |a: &[f32], b: &[f32]| (-0.5 * squared(a, b) / (spread * spread)).exp();
    let matrix = DMatrix::from_fn(SAMPLES, SAMPLES, |i, j| phi(&set.inputs[i], &set.inputs[j]));
    let targets = DMatrix::from_fn(SAMPLES, 4, |i, k| f64::from(set.targets[i][k]));
    let svd = SVD::new(matrix.clone(), true, true);
    let cut = 1e-10 * svd.singular_values.max();
    let by_svd = svd
        .solve(&targets, cut)
        .map_err(|fault| Failure::because(fault.to_owned()))?;
    let gram = matrix.tr_mul(&matrix);
    let right = matrix.tr_mul(&targets);
    let normal = gram.clone().lu().solve(&right);
    let narrow = gram.map(|value| value as f32).cholesky();
    let (mut ours, mut garbage) = (0.0, 0.0);
    for i in 0..SAMPLES - 1 {
        let (input, _) = curve(6.0 * (i as f64 + 0.5) / SAMPLES as f64);
        let row = DVector::from_fn(SAMPLES, |j, _| phi(&input, &set.inputs[j]));
        let exact = by_svd.tr_mul(&row);
        let wide: Vec<f64> = input.iter().map(|x| f64::from(*x)).collect();
        let found = DVector::from_vec(network.predict(&wide));
        ours = worst(ours, (found - &exact).amax());
        let hasty = match &normal {
            Some(weights) => (weights.tr_mul(&row) - &exact).amax(),
            None => f64::INFINITY,
        };
        garbage = worst(garbage, hasty);
    }
    let unreported = !(report.largest_weight.is_finite() && report.condition.is_finite());
    Ok(Outcome::of([
        Check::at_most(
            "prediction against the singular values of Phi, of the targets",
            naive(garbage, "Phi'Phi has no inverse"),
            ours,
            1e-6,
        ),
        Check::at_most(
            "weights that are not finite, or not reported",
            Naive::Error(f64::from(u8::from(narrow.is_none()))),
            f64::from(u8::from(unreported)),
            0.0,
        ),
    ])
    .noted(format!(
        "condition of Phi {:.0e}, {} of {SAMPLES} directions kept, largest weight {:.0e}",
        report.condition, report.rank, report.largest_weight
    )))
}

/// 20: many copies of one sample.
pub(crate) fn duplicates() -> Result<Outcome, Failure> {
    const NEURONS: usize = 10;
    let few = on_curve(6);
    let copies =
        |count: usize| -> Vec<usize> { (0..count).map(|_| 0).chain(1..few.inputs.len()).collect() };
    let of = |which: &[usize]| {
        Made::new(
            which.iter().map(|&i| few.inputs[i].clone()).collect(),
            which.iter().map(|&i| few.targets[i].clone()).collect(),
        )
    };
    let set = of(&copies(100));
    let (network, report) = set.train(NEURONS, 1.0).map_err(untrained)?;
    let wide: Vec<f64> = set.inputs[3].iter().map(|x| f64::from(*x)).collect();
    let predicted = network.predict(&wide);
    let bad = predicted.iter().filter(|x| !x.is_finite()).count();
    let centroids = lloyd(&set.inputs, NEURONS);
    let alike = of(&[0; 100]).train(NEURONS, 1.0);
    let accepted = !matches!(alike, Err(TrainError::Alike));
    let same = of(&[0; 100]);
    let exponent = squared(&same.inputs[0], &same.inputs[1]).sqrt() / spread_of(&same, 100);
    let divided = (-exponent * exponent).exp();
    Ok(Outcome::of([
        Check::at_most(
            "numbers that are none, of centroids or predictions",
            Naive::Error(centroids.iter().flatten().filter(|x| x.is_nan()).count() as f64),
            bad as f64,
            0.0,
        ),
        Check::at_most(
            "rank reported of ten neurons on six different samples",
            Naive::Absent("the paper's training counts neurons, not independent ones".into()),
            report.rank as f64,
            6.0,
        ),
        Check::at_most(
            "a set of 100 copies of one sample, accepted",
            naive(divided, "Eq. 13 gives a spread of 0, and 0/0 in the exponent"),
            f64::from(u8::from(accepted)),
            0.0,
        ),
    ])
    .noted(
        "copies of one sample have no spread (Eq. 13 gives 0): an error names this. Naive: Lloyd's iterations that divide by the size of an empty cluster",
    ))
}

/// A naive Lloyd iteration that starts from the first samples.
fn lloyd(rows: &[Vec<f32>], count: usize) -> Vec<Vec<f64>> {
    let wide = |row: &[f32]| -> Vec<f64> { row.iter().map(|x| f64::from(*x)).collect() };
    let mut centres: Vec<Vec<f64>> = rows[..count].iter().map(|row| wide(row)).collect();
    for _ in 0..5 {
        let mut sums = vec![vec![0.0; rows[0].len()]; count];
        let mut sizes = vec![0.0; count];
        for row in rows {
            let apart = |centre: &[f64]| -> f64 {
                centre
                    .iter()
                    .zip(row)
                    .map(|(c, x)| (c - f64::from(*x)).powi(2))
                    .sum()
            };
            let mut nearest = 0;
            for k in 1..count {
                if apart(&centres[k]) < apart(&centres[nearest]) {
                    nearest = k;
                }
            }
            sizes[nearest] += 1.0;
            sums[nearest]
                .iter_mut()
                .zip(row)
                .for_each(|(s, x)| *s += f64::from(*x));
        }
        for ((centre, sum), size) in centres.iter_mut().zip(sums).zip(&sizes) {
            *centre = sum.into_iter().map(|sum| sum / size).collect();
        }
    }
    centres
}

/// 21: a few samples near electrodes dominate the spread.
pub(crate) fn heavy_tails() -> Result<Outcome, Failure> {
    let plain = on_curve(200);
    let mut heavy = on_curve(200);
    for i in [17, 90] {
        heavy.inputs[i].iter_mut().for_each(|x| *x += 20.0);
    }
    let ratio = |set: &Made| -> Result<f64, Failure> {
        Ok(set.train(8, 1.0).map_err(untrained)?.1.spread_over_median)
    };
    let (light, ruled) = (ratio(&plain)?, ratio(&heavy)?);
    Ok(Outcome::of([
        Check::at_least(
            "b over the median distance, two samples of 200 far out",
            Naive::Absent("Eq. 13 gives b without a value to compare it with".into()),
            ruled,
            SPREAD_RULED,
        ),
        Check::at_most(
            "the same without them",
            Naive::Absent("Eq. 13 gives b without a value to compare it with".into()),
            light,
            SPREAD_RULED,
        ),
    ])
    .noted(format!(
        "Eq. 13 is used unchanged; above {SPREAD_RULED} `tactus-lab train rbf` warns that a few cases determine the spread"
    )))
}

/// 22: more pairs than fit in memory.
pub(crate) fn many_pairs() -> Result<Outcome, Failure> {
    const SAMPLES: usize = 2000;
    let set = on_curve(SAMPLES);
    let (network, _) = set.train(2, 1.0).map_err(untrained)?;
    let all = spread_of(&set, SAMPLES);
    Ok(Outcome::of([Check::at_most(
        "b of a million pairs against all pairs of 2,000 samples, less 1",
        Naive::Error((spread_of(&set, 200) / all - 1.0).abs()),
        (network.spread() / all - 1.0).abs(),
        0.01,
    )])
    .noted(
        "all pairs of 75,000 samples are 2.8e9 distances, 22 GB. Naive: the pairs of the first samples only; ours draws pairs \
         from all of them",
    ))
}

/// Eq. 13 over all pairs of the first samples.
fn spread_of(set: &Made, count: usize) -> f64 {
    let mut distances = Vec::with_capacity(count * (count - 1) / 2);
    for a in 0..count {
        for b in a + 1..count {
            distances.push(squared(&set.inputs[a], &set.inputs[b]).sqrt());
        }
    }
    let (mean, deviation) = mean_and_deviation(&distances);
    mean + deviation
}

/// 23: the distance of a sample from itself.
pub(crate) fn near_duplicates() -> Result<Outcome, Failure> {
    let set = on_curve(40);
    let (network, _) = set.train(40, 1.0).map_err(untrained)?;
    let (mut ours, mut negative) = (0.0, 0);
    for input in &set.inputs {
        let wide: Vec<f64> = input.iter().map(|x| f64::from(*x)).collect();
        ours = worst(ours, network.novelty(&wide));
        // a copy of the input that differs by one unit in the last place in some components
        let other: Vec<f32> = input
            .iter()
            .enumerate()
            .map(|(k, x)| f32::from_bits(x.to_bits() + (k % 3) as u32))
            .collect();
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).fold(0.0_f32, |s, (a, b)| s + a * b);
        let square = dot(input, input) - 2.0 * dot(input, &other) + dot(&other, &other);
        negative += u32::from(square < 0.0 || (square == 0.0 && input != &other));
    }
    Ok(Outcome::of([Check::at_most(
        "distance of a sample from its own centre; pairs with none",
        Naive::Error(f64::from(negative)),
        ours,
        0.0,
    )])
    .noted("naive: |a|^2 - 2ab + |b|^2 in f32 of samples that differ by one ulp; counted are those where it is negative or 0"))
}

/// 24: an input far from every neuron.
pub(crate) fn far_input() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let (network, model) = tank.trained(80)?;
    let volts = tank.ours(&tank.contact, &tank.sigma)?;
    let far: Vec<f64> = volts.iter().map(|v| 5.0 * v).collect();
    let largest = volts.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
    let change: Vec<f64> = volts.iter().map(|v| 4.0 * v / largest).collect();
    let silent = network.predict(&change);
    let silent = silent.iter().fold(0.0_f64, |top, x| top.max(x.abs()));
    let answer = model
        .into_reconstructor()
        .reconstruct(&measured(&volts), &measured(&far));
    let answered = !matches!(answer, Err(ReconstructError::OutsideModel { .. }));
    Ok(Outcome::of([Check::at_most(
        "inputs far outside that are answered by 'no load'",
        Naive::Error(f64::from(u8::from(silent < 1e-2))),
        f64::from(u8::from(answered)),
        0.0,
    )])
    .noted(format!(
        "five times the voltages: all phi underflow, the largest change of the map is {silent:.0e}"
    )))
}
