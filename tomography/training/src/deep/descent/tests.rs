use super::*;

fn settings() -> DeepSettings {
    DeepSettings {
        hidden_layers: 2,
        width: 9,
        // Adam's first moment is then equal to the gradient
        beta1: 0.0,
        ..DeepSettings::default()
    }
}

fn batch() -> Batch {
    let wave = |i: usize| ((i * i + 3 * i) as f32 * 0.37).sin();
    Batch {
        samples: 5,
        inputs: (0..7 * 5).map(wave).collect(),
        targets: vec![(0, 0, -0.5), (3, 0, -0.2), (5, 2, -0.9), (1, 4, -0.7)],
    }
}

#[test]
fn the_gradient_is_the_finite_difference() {
    for batch_normalisation in [true, false] {
        let settings = DeepSettings {
            batch_normalisation,
            ..settings()
        };
        let mut stepped = Descent::new(&settings, 7, 6, 4);
        stepped.step(&batch(), 1e-3, 1e-5);
        let gradients: Vec<Vec<f32>> = stepped.trained().map(|part| part.first.clone()).collect();
        let mut probe = Descent::new(&settings, 7, 6, 4);
        let h = 4e-3;
        let mut compared = 0;
        for (part, gradient) in gradients.iter().enumerate() {
            for (index, gradient) in gradient.iter().enumerate().step_by(3) {
                let mut at = |change: f32| {
                    let values = &mut probe.trained_mut().nth(part).unwrap().values;
                    values[index] += change;
                    let loss = probe.loss(&batch(), None, 1e-5);
                    let values = &mut probe.trained_mut().nth(part).unwrap().values;
                    values[index] -= change;
                    loss
                };
                let slope = (at(h) - at(-h)) / (2.0 * f64::from(h));
                let error = (slope - f64::from(*gradient)).abs();
                assert!(
                    error < 2e-4 + 1e-3 * slope.abs(),
                    "part {part}, number {index}: {slope} {gradient}"
                );
                compared += usize::from(slope.abs() > 1e-2);
            }
        }
        assert!(compared > 30, "{compared}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let settings = DeepSettings {
        width: 300,
        ..settings()
    };
    let bits = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let mut descent = Descent::new(&settings, 7, 400, 4);
            let losses: Vec<u64> = (0..3)
                .map(|_| descent.step(&batch(), 1e-3, 1e-5).to_bits())
                .collect();
            let values: Vec<u32> = descent
                .trained()
                .flat_map(|part| part.values.iter().map(|value| value.to_bits()))
                .collect();
            (losses, values)
        })
    };
    let one = bits(1);
    assert!(one == bits(2) && one == bits(8));
}

#[test]
fn the_paper_counts_twenty_one_million_weights() {
    let widths = DeepSettings::default().widths(598, 3690);
    let weights: usize = widths.windows(2).map(|pair| pair[0] * pair[1]).sum();
    assert_eq!(weights, 21_364_736);
}
