//! Hard cases 25 to 29: normalisation, saturation, divergence and precision of the deep network.

use eit::inverse::learned::network::{Layer, Weights, elu, elu_slope};
use eit::{DeepNetwork, DeepSettings, Jitter, Precision, TrainingSettings};
use training::deep::{DeepFault, Recipe, train};
use training::samples::{Noise, SampleError, Samples};

use super::radial::Made;
use crate::failure::{Attempt, Failure};
use crate::stability::outcome::{Check, Naive, Outcome, naive, worst};
use crate::stability::solvers::tank::Tank;

fn unsound(fault: String) -> Failure {
    Failure::because(fault)
}

fn settings() -> DeepSettings {
    DeepSettings {
        hidden_layers: 1,
        width: 16,
        epochs: 4,
        batch: 16,
        held_out: 16,
        ..DeepSettings::default()
    }
}

/// 96 samples of eight readings; the fourth is constant.
fn with_constant() -> Made {
    let wave = |i: usize, k: usize| (0.37 * (i * i + 3 * i * (k + 1)) as f32).sin();
    let inputs = (0..96)
        .map(|i| {
            (0..8)
                .map(|k| if k == 3 { 0.5 } else { wave(i, k) })
                .collect()
        })
        .collect();
    let targets = (0..96)
        .map(|i| (0..5).map(|k| -0.4 * (1.0 + wave(i, k))).collect())
        .collect();
    Made::new(inputs, targets)
}

fn recipe<'a>(samples: &'a dyn Samples, noise: &'a Noise, settings: DeepSettings) -> Recipe<'a> {
    Recipe {
        samples,
        noise,
        repeats: 1,
        settings,
        seed: 3,
        precision: Precision::F32,
        checkpoint: None,
    }
}

fn noise(set: &Made) -> Result<Noise, Failure> {
    let settings = set.settings(1);
    Noise::new(
        &settings.jitter,
        settings.open.spread,
        &set.baseline,
        settings.seed,
    )
    .attempt("the jitter")
}

fn untrained(fault: DeepFault) -> Failure {
    Failure::of("the training", &fault)
}

/// 25: a constant reading.
pub(crate) fn constant_channel() -> Result<Outcome, Failure> {
    let set = with_constant();
    let noise = noise(&set)?;
    let settings = settings();
    let epsilon = settings.normalisation_epsilon;
    let (network, _, _) = train(&recipe(&set, &noise, settings), &|_| {}).map_err(untrained)?;
    let outputs = network.predict(&set.inputs[0]);
    let bad = outputs.iter().filter(|x| !x.is_finite()).count();
    let column: Vec<f64> = set.inputs.iter().map(|row| f64::from(row[3])).collect();
    let mean = column.iter().sum::<f64>() / column.len() as f64;
    let variance = column.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
    let divided = (column[0] - mean) / variance.sqrt();
    // the scale starts at 1 and does not change, because its gradient is zero
    let gain = f64::from(network.normalisation()[1][3]) * epsilon.sqrt();
    Ok(Outcome::of([
        Check::at_most(
            "outputs that are not numbers",
            naive(divided, "0/0 in the normalisation"),
            bad as f64,
            0.0,
        ),
        Check::at_most(
            "what training moved the scale of that reading by",
            naive(divided, "0/0 in the normalisation"),
            (gain - 1.0).abs(),
            1e-6,
        ),
    ])
    .noted(
        "epsilon is 1e-5 of the largest baseline reading squared, as in the paper's tool, not of the median variance: with little \
         noise a smaller one is a setting (normalisation_epsilon)",
    ))
}

/// 26: readings of very different magnitude.
pub(crate) fn scales() -> Result<Outcome, Failure> {
    const CHANNELS: usize = 64;
    // magnitudes from 1 to 1/2100; mean and standard deviation are equal, except for one reading with a mean 2100 times
    // larger
    let size = |k: usize| 2100_f64.powf(-(k as f64) / (CHANNELS - 1) as f64);
    let far = |k: usize| if k == 5 { 2100.0 } else { 1.0 };
    let mean: Vec<f32> = (0..CHANNELS).map(|k| (far(k) * size(k)) as f32).collect();
    let gain: Vec<f32> = (0..CHANNELS).map(|k| (1.0 / size(k)) as f32).collect();
    let weights: Vec<f32> = (0..CHANNELS)
        .map(|k| (1.3 * k as f32).sin() / (CHANNELS as f32).sqrt())
        .collect();
    let network = DeepNetwork::new(
        mean.clone(),
        gain.clone(),
        vec![0.0; CHANNELS],
        vec![Layer {
            weights: Weights::F32(weights.clone()),
            bias: vec![0.0],
        }],
    )
    .map_err(unsound)?;
    let folded: Vec<f32> = (0..CHANNELS).map(|k| weights[k] * gain[k]).collect();
    let bias = (0..CHANNELS).fold(0.0_f32, |sum, k| sum - folded[k] * mean[k]);
    let (mut ours, mut once, mut largest) = (0.0, 0.0, 0.0_f64);
    for i in 0..50 {
        let input: Vec<f32> = (0..CHANNELS)
            .map(|k| mean[k] + ((i * 7 + k * 13) as f32 * 0.61).sin() * size(k) as f32)
            .collect();
        let exact: f64 = (0..CHANNELS)
            .map(|k| {
                let centred = f64::from(input[k]) - f64::from(mean[k]);
                f64::from(weights[k]) * f64::from(gain[k]) * centred
            })
            .sum();
        largest = largest.max(exact.abs());
        ours = worst(ours, (f64::from(network.predict(&input)[0]) - exact).abs());
        let narrow = (0..CHANNELS).fold(bias, |sum, k| sum + folded[k] * input[k]);
        once = worst(once, (f64::from(narrow) - exact).abs());
    }
    Ok(Outcome::of([Check::at_most(
        "normalised in f32 against f64, of the largest output",
        Naive::Error(once / largest),
        ours / largest,
        1e-6,
    )])
    .noted("ours subtracts the mean first; naive: mean and gain are merged into weights and bias in f32"))
}

/// 27: ELU for very large arguments of both signs.
pub(crate) fn saturation() -> Result<Outcome, Failure> {
    let arguments = [-1e4_f32, 1e4, -1e-6, -200.0, 90.0];
    let masked = |x: f32| {
        let above = f32::from(u8::from(x > 0.0));
        above * x + (1.0 - above) * (x.exp() - 1.0)
    };
    let (mut ours, mut mask) = (0.0, 0.0);
    for x in arguments {
        let exact = if x > 0.0 {
            f64::from(x)
        } else {
            f64::from(x).exp_m1()
        };
        let mut y = [x];
        elu(&mut y);
        let off = |y: f32| (f64::from(y) - exact).abs() / exact.abs();
        ours = worst(ours, off(y[0]));
        mask = worst(mask, off(masked(x)));
    }
    let mut at_zero = [0.0_f32];
    elu(&mut at_zero);
    let slope = f64::from(elu_slope(at_zero[0]));
    Ok(Outcome::of([
        Check::at_most(
            "elu from -1e4 to 1e4 against expm1, relative",
            naive(
                mask,
                "0 times infinity: both branches are computed and masked",
            ),
            ours,
            3e-7,
        ),
        Check::at_most(
            "|slope at 0, less 1|",
            Naive::Absent("all forms that were tried have the same slope".into()),
            (slope - 1.0).abs(),
            0.0,
        ),
    ])
    .noted("the slope at 0 is right in all forms that were tried"))
}

/// Weights of one layer after plain gradient descent through the set.
fn weights_at_rate(set: &Made, rate: f32) -> [f32; 8] {
    let mut weights = [0.1_f32; 8];
    for (row, target) in set.inputs.iter().zip(&set.targets) {
        let error = row.iter().zip(&weights).map(|(x, w)| x * w).sum::<f32>() - target[0];
        weights
            .iter_mut()
            .zip(row)
            .for_each(|(w, x)| *w -= rate * error * x);
    }
    weights
}

/// 28: a sample with a value that is not finite.
pub(crate) fn divergence() -> Result<Outcome, Failure> {
    let mut set = with_constant();
    set.inputs[7][3] = f32::NAN;
    let noise = noise(&set)?;
    let named = match train(&recipe(&set, &noise, settings()), &|_| {}) {
        Err(DeepFault::Sample(SampleError::NotFinite { case, what, .. })) => {
            case == 7 && what == "reading 3"
        }
        _ => false,
    };
    let poisoned = weights_at_rate(&set, 0.01)
        .iter()
        .filter(|w| w.is_nan())
        .count();
    let sound = with_constant();
    let quick = DeepSettings {
        learning_rate: 1e30,
        ..settings()
    };
    let published = match train(&recipe(&sound, &noise, quick), &|_| {}) {
        Ok((network, ..)) => network
            .predict(&sound.inputs[0])
            .iter()
            .any(|x| !x.is_finite()),
        Err(_) => false,
    };
    Ok(Outcome::of([
        Check::at_most(
            "weights without a number after a bad sample; sample not named",
            Naive::Error(poisoned as f64),
            f64::from(u8::from(!named)),
            0.0,
        ),
        Check::at_most(
            "networks published that answer with none, rate 1e30",
            Naive::Error(f64::from(u8::from(
                weights_at_rate(&sound, 1e30).iter().any(|w| !w.is_finite()),
            ))),
            f64::from(u8::from(published)),
            0.0,
        ),
    ]))
}

/// Smallest peak change of a map that shows a load.
const SHOWN: f64 = 0.2;

/// 29: weights in two bytes and in one byte.
pub(crate) fn precision() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let data = TrainingSettings {
        cases: 400,
        repeats: 1,
        jitter: Jitter::Matched {
            noise_v: 2e-6,
            current_a: 1e-3,
        },
        ..TrainingSettings::default()
    };
    let simulation = tank.simulation(&data).attempt("the training set")?;
    let noise = Noise::new(&data.jitter, data.open.spread, simulation.baseline(), 1)
        .attempt("the jitter")?;
    let settings = DeepSettings {
        hidden_layers: 2,
        width: 96,
        epochs: 12,
        batch: 32,
        held_out: 60,
        ..DeepSettings::default()
    };
    let (network, _, _) =
        train(&recipe(&simulation, &noise, settings), &|_| {}).map_err(untrained)?;
    let kept = [Precision::F32, Precision::F16, Precision::Int8]
        .map(|precision| network.with_precision(precision));
    let (mut errors, mut shifts, mut largest) = ([0.0; 3], [0.0; 3], 0.0_f64);
    let (mut whole, mut strayed) = (0.0, 0.0);
    let (centroids, areas) = (tank.mesh.region_centroids(), tank.mesh.region_areas());
    for case in 340..400 {
        let sample = simulation.sample(case).attempt("the training set")?;
        if sample.target.is_empty() {
            continue;
        }
        let exact = wide(&network, &sample.input, |_, weight| weight)?;
        let top = exact.iter().fold(0.0_f64, |top, x| top.max(x.abs()));
        largest = largest.max(top);
        let off = |found: &[f64]| {
            let far = found.iter().zip(&exact).map(|(a, b)| (a - b).abs());
            far.fold(0.0, worst)
        };
        // the position is the centroid of the loss; on so coarse a mesh a contour would jump by triangles
        let place = |values: &[f64]| {
            let mut sums = [0.0; 3];
            for ((value, c), area) in values.iter().zip(&centroids).zip(&areas) {
                let lost = (-value).max(0.0) * area;
                for (sum, by) in sums.iter_mut().zip([c[0], c[1], 1.0]) {
                    *sum += lost * by;
                }
            }
            [sums[0] / sums[2], sums[1] / sums[2]]
        };
        let at = place(&exact);
        let away = |b: [f64; 2]| 1e3 * (at[0] - b[0]).hypot(at[1] - b[1]);
        for ((error, shift), network) in errors.iter_mut().zip(&mut shifts).zip(&kept) {
            let found: Vec<f64> = network
                .predict(&sample.input)
                .into_iter()
                .map(f64::from)
                .collect();
            *error = worst(*error, off(&found));
            // a nearly empty map has no position
            if top > SHOWN {
                *shift = worst(*shift, away(place(&found)));
            }
        }
        // naive: one byte with one scale per layer, and truncation
        let coarse = wide(&network, &sample.input, |largest, weight| {
            let step = largest / 127.0;
            (weight / step).trunc() * step
        })?;
        whole = worst(whole, off(&coarse));
        if top > SHOWN {
            strayed = worst(strayed, away(place(&coarse)));
        }
    }
    let errors = errors.map(|error| error / largest);
    let whole = whole / largest;
    Ok(Outcome::of([
        Check::at_most(
            "f32 against f64, of the largest output",
            Naive::Error(whole),
            errors[0],
            1e-5,
        ),
        Check::at_most("f16", Naive::Error(whole), errors[1], 2e-3),
        Check::at_most("int8, a scale a row", Naive::Error(whole), errors[2], 0.03),
        Check::at_most(
            "shift of the place found, mm: f32 and f16",
            Naive::Error(strayed),
            worst(shifts[0], shifts[1]),
            0.2,
        ),
        Check::at_most(
            "the same, int8",
            Naive::Error(strayed),
            shifts[2],
            0.5,
        ),
    ])
    .noted(
        "1e-2 and 0.2 mm are asked of int8 too: one byte per weight has steps of 1/127 of its row's largest, whose rounding adds up to some 2 % over 96 neurons and moves places in a tank of 300 mm by up to half a millimetre. Naive: one scale per layer, truncated in place of rounded",
    ))
}

/// The network's output in f64 with modified weights; `change` receives the layer's largest weight and the weight.
fn wide(
    network: &DeepNetwork,
    input: &[f32],
    change: impl Fn(f64, f64) -> f64,
) -> Result<Vec<f64>, Failure> {
    let [mean, gain, shift] = network.normalisation();
    let mut values: Vec<f64> = (0..input.len())
        .map(|k| {
            let [v, m, g, s] = [input[k], mean[k], gain[k], shift[k]].map(f64::from);
            (v - m) * g + s
        })
        .collect();
    for (index, layer) in network.layers().iter().enumerate() {
        let Weights::F32(weights) = &layer.weights else {
            return Err(Failure::because("the network was trained in f32"));
        };
        let largest = weights
            .iter()
            .fold(0.0_f64, |top, w| top.max(f64::from(w.abs())));
        values = (0..layer.outputs())
            .map(|row| {
                let weights = &weights[row * values.len()..];
                let sum: f64 = weights
                    .iter()
                    .zip(&values)
                    .map(|(w, x)| change(largest, f64::from(*w)) * x)
                    .sum();
                let sum = sum + f64::from(layer.bias[row]);
                if index + 1 == network.layers().len() || sum > 0.0 {
                    sum
                } else {
                    sum.exp_m1()
                }
            })
            .collect();
    }
    Ok(values)
}
