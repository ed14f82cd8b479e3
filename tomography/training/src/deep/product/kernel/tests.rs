use super::super::{in_panels, in_rows, place, tiled, turn};
use super::*;

const INPUTS: usize = 70;
const OUTPUTS: usize = 90;
const SAMPLES: usize = 40;
const STRIPS: usize = 2;

fn wave(count: usize, step: f32) -> Vec<f32> {
    (0..count).map(|i| (i as f32 * step).sin()).collect()
}

/// Converts rows of SAMPLES entries to the layout of a batch.
fn laid(plain: &[f32]) -> Vec<f32> {
    let neurons = plain.len() / SAMPLES;
    let mut values = vec![0.0; tiled(neurons) * STRIPS * STRIP];
    for neuron in 0..neurons {
        for sample in 0..SAMPLES {
            values[place(neuron, sample, STRIPS)] = plain[neuron * SAMPLES + sample];
        }
    }
    values
}

fn close(a: f32, b: f32) {
    assert!((a - b).abs() < 2e-5, "{a} {b}");
}

type Three = (
    fn(&[f32], &[f32], &mut [f32]),
    fn(&[f32], &[f32], usize, &mut [f32]),
    fn(&[f32], &[f32], &mut [f32]),
);

fn check((forward, backward, gradient): Three) {
    let (w, x, dy) = (
        wave(OUTPUTS * INPUTS, 0.7),
        wave(INPUTS * SAMPLES, 0.3),
        wave(OUTPUTS * SAMPLES, 1.1),
    );
    let weights = in_panels(&w, INPUTS);
    assert_eq!(in_rows(&weights, INPUTS, OUTPUTS), w);
    let (inputs, slopes) = (laid(&x), laid(&dy));
    let tile = TILE * STRIPS * STRIP;
    let mut y = vec![1.0; 2 * tile];
    for (y, weights) in y.chunks_mut(tile).zip(weights.chunks(TILE * tiled(INPUTS))) {
        forward(weights, &inputs, y);
    }
    let mut dx = vec![0.0; 2 * tile];
    for (index, dx) in dx.chunks_mut(tile).enumerate() {
        backward(&weights, &slopes, index, dx);
    }
    for s in 0..SAMPLES {
        for o in 0..OUTPUTS {
            let sum: f32 = (0..INPUTS)
                .map(|i| w[o * INPUTS + i] * x[i * SAMPLES + s])
                .sum();
            close(y[place(o, s, STRIPS)], 1.0 + sum);
        }
        for i in 0..INPUTS {
            let sum: f32 = (0..OUTPUTS)
                .map(|o| w[o * INPUTS + i] * dy[o * SAMPLES + s])
                .sum();
            close(dx[place(i, s, STRIPS)], sum);
        }
    }
    let mut turned = Vec::new();
    let mut block = vec![0.0; 2 * PANEL * TILE];
    for pair in 0..tiled(OUTPUTS) / (2 * PANEL) {
        let sums = turn(&slopes, pair, STRIPS, &mut turned);
        for (above, inputs) in inputs.chunks(tile).enumerate() {
            gradient(&turned, inputs, &mut block);
            for (o, total) in sums.iter().enumerate() {
                let output = pair * 2 * PANEL + o;
                let dy = |s: usize| {
                    if output < OUTPUTS {
                        dy[output * SAMPLES + s]
                    } else {
                        0.0
                    }
                };
                close(*total, (0..SAMPLES).map(dy).sum());
                for i in 0..TILE {
                    let input = above * TILE + i;
                    let x = |s: usize| {
                        if input < INPUTS {
                            x[input * SAMPLES + s]
                        } else {
                            0.0
                        }
                    };
                    let found = block[(o / PANEL * TILE + i) * PANEL + o % PANEL];
                    close(found, (0..SAMPLES).map(|s| dy(s) * x(s)).sum());
                }
            }
        }
    }
}

#[test]
fn products_equal_their_formulas_in_every_instruction_set() {
    check((forward, backward, gradient));
    check((portable::forward, portable::backward, portable::gradient));
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: for all three calls the features were detected above.

        check((
            |w, x, y| unsafe { half_wide::forward(w, x, y) },
            |w, dy, tile, dx| unsafe { half_wide::backward(w, dy, tile, dx) },
            |dy, x, dw| unsafe { half_wide::gradient(dy, x, dw) },
        ));
    }
}
