//! The standard deviation of maps relative to the tracked baseline, with loads on a finer mesh than the model's.

use std::sync::Arc;

use drift::{DriftModel, Judgement, Tracker};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use survey::Reading;

use crate::sheet::Sheet;
use crate::walk::{EVERY_S, walked};

/// Prior standard deviation of local change, ln conductance: smooths maps as much as the one-step method.
const SMOOTHED: f64 = 0.03;

/// The same, less smoothed.
const LESS_SMOOTHED: f64 = 0.1;

/// Triangles more than 20 mm from the sheet's edge, where loads lie.
fn inner(model: &DriftModel) -> Vec<usize> {
    let mesh = model.mesh();
    let within = |&triangle: &usize| {
        let [x, y] = mesh.centroid(triangle);
        (0.02..0.19).contains(&x) && (0.02..0.21).contains(&y)
    };
    (0..mesh.triangles().len()).filter(within).collect()
}

#[test]
fn deviation_of_a_tracked_map_contains_the_truth() {
    let (mut walk, empty) = walked(30);
    let model = Arc::clone(&walk.model);
    let away = |at: [f64; 2], [x, y]: [f64; 2]| (at[0] - x).hypot(at[1] - y);
    let disc = |at: [f64; 2]| away(at, [0.080, 0.135]) < 15e-3;
    let press = |at: [f64; 2]| away(at, [0.100, 0.110]) < 6e-3;
    let two = |at: [f64; 2]| disc(at) || away(at, [0.150, 0.060]) < 20e-3;
    let bar = |[x, y]: [f64; 2]| (0.05..0.12).contains(&x) && (0.10..0.13).contains(&y);
    for (load, loss, least) in [
        (&disc as &dyn Fn([f64; 2]) -> bool, 0.5, 0.99),
        (&disc, 0.1, 0.99),
        (&press, 0.5, 0.99),
        (&press, 0.2, 0.99),
        (&two, 0.5, 0.99),
        (&bar, 0.5, 0.95),
    ] {
        let factor = |at: [f64; 2]| if load(at) { 1.0 - loss } else { 1.0 };
        let readings = walk.sheet.readings(|_| 1.0, factor);
        let change = model.relative(&readings).unwrap().data;
        let mut tracker = empty.clone();
        let frame = walk.frame(Some((&change, 1.0)));
        let answer = tracker.follow(&frame, EVERY_S * 31.0).unwrap();
        assert_eq!(answer.judgement, Judgement::Loaded);
        let began = std::time::Instant::now();
        let found = tracker.map_deviation().unwrap();
        let (took, deviations) = (began.elapsed(), found.values());
        let map = tracker.map(SMOOTHED).unwrap();
        let truth = |triangle: usize| factor(model.mesh().centroid(triangle)).ln();
        let holds = |&triangle: &usize| {
            (map[triangle] - truth(triangle)).abs() <= 1.96 * deviations[triangle]
        };
        let known: Vec<usize> = inner(&model)
            .into_iter()
            .filter(|&triangle| deviations[triangle].is_finite())
            .collect();
        let share =
            |of: &[usize]| of.iter().filter(|one| holds(one)).count() as f64 / of.len() as f64;
        let (under, _): (Vec<usize>, Vec<usize>) =
            known.iter().partition(|&&triangle| truth(triangle) < 0.0);
        println!(
            "{:.3}, under the load {:.3}; {took:?}",
            share(&known),
            share(&under)
        );
        assert!(share(&known) >= least && share(&under) >= least);
    }
}

#[test]
fn noise_and_lost_rows_make_a_tracked_map_less_certain() {
    let sheet = Sheet::new();
    let deviations = |reading_v: f64, lost: usize| {
        let model = Arc::new(sheet.model_with_noise(reading_v));
        let mut frame = sheet.baseline.clone();
        for row in 0..lost {
            for reading in model.pairs().readings(row) {
                frame[reading] = Reading::NotMeasured;
            }
        }
        let mut tracker = Tracker::new(Arc::clone(&model), 0.0).unwrap();
        assert!(tracker.map_deviation().is_err(), "no frame yet");
        let answer = tracker.follow(&frame, EVERY_S).unwrap();
        assert_eq!(answer.judgement, Judgement::Empty);
        let found = tracker.map_deviation().unwrap();
        let known = found.resolved.iter().filter(|known| **known).count();
        (found.deviation, known)
    };
    let (whole, known) = deviations(2e-6, 0);
    assert!(whole.iter().all(|sd| (0.0..=0.05).contains(sd)));
    for (reading_v, lost) in [(20e-6, 0), (2e-6, 140)] {
        let (less, fewer) = deviations(reading_v, lost);
        println!("{known} {fewer}");
        assert!(whole.iter().zip(&less).all(|(a, b)| *a <= b + 1e-9));
        assert!(fewer < known);
    }
}

/// Presses, discs, bars and pairs of discs of random size, loss and place.
fn random_load(random: &mut ChaCha8Rng, kind: usize) -> impl Fn([f64; 2]) -> f64 + use<> {
    let mut place = || {
        [
            random.random_range(0.05..0.165),
            random.random_range(0.05..0.18),
        ]
    };
    let (first, second) = (place(), place());
    let radius = match kind {
        0 => random.random_range(4e-3..11e-3),
        _ => random.random_range(11e-3..29e-3),
    };
    let half = [(); 2].map(|()| random.random_range(0.01..0.04));
    let loss = random.random_range(0.08..0.63);
    move |at: [f64; 2]| {
        let from = |[x, y]: [f64; 2]| (at[0] - x).hypot(at[1] - y);
        let inside = match kind {
            2 => (0..2).all(|axis| (at[axis] - first[axis]).abs() < half[axis]),
            3 => from(first) < radius || from(second) < half[0],
            _ => from(first) < radius,
        };
        if inside { 1.0 - loss } else { 1.0 }
    }
}

#[test]
fn deviation_holds_under_random_loads() {
    let (mut walk, empty) = walked(30);
    let model = Arc::clone(&walk.model);
    let rows: Vec<usize> = (0..299).collect();
    let inner = inner(&model);
    let mut random = ChaCha8Rng::seed_from_u64(9);
    // shares of triangles within their intervals, of all and of those under the load: with the tracked baseline, and
    // with a single frame
    let mut shares = [[0.0; 2]; 2];
    const LOADS: usize = 24;
    for number in 0..LOADS {
        let factor = random_load(&mut random, number % 4);
        let change = model.relative(&walk.sheet.readings(|_| 1.0, &factor));
        let frame = walk.frame(Some((&change.unwrap().data, 1.0)));
        let mut tracker = empty.clone();
        tracker.follow(&frame, EVERY_S * 31.0).unwrap();
        let data = model.relative(&frame).unwrap().data;
        let drift = model.frame_drift(&data, &rows).unwrap();
        let alone = model.map_deviation(&drift, &rows).unwrap();
        let tracked = tracker.map_deviation().unwrap();
        let map = tracker.map(LESS_SMOOTHED).unwrap();
        let truth = |triangle: usize| factor(model.mesh().centroid(triangle)).ln();
        let under: Vec<usize> = inner
            .iter()
            .copied()
            .filter(|&one| truth(one) < 0.0)
            .collect();
        for (share, found) in shares.iter_mut().zip([tracked, alone]) {
            for (sum, of) in share.iter_mut().zip([&inner, &under]) {
                let holds =
                    |&&one: &&usize| (map[one] - truth(one)).abs() <= 1.96 * found.deviation[one];
                *sum += of.iter().filter(holds).count() as f64 / of.len() as f64 / LOADS as f64;
            }
        }
    }
    println!("{shares:.3?}");
    // if the most probable size of the whole sheet replaced that of the load, the share under the load would be 0.6
    assert!(
        shares
            .iter()
            .all(|[all, under]| *all > 0.95 && *under > 0.85),
        "{shares:?}"
    );
}
