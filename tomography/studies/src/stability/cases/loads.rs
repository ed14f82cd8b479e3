//! Hard cases 36 and 37: hot spots of a map, and a dose over months.

use eit::Mesh;
use imaging::quantities::{
    FrameQuantities, JudgedMap, LoadUnit, Quantifier, Quantity, QuantitySettings, Surface,
    add_compensated,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use survey::Map;

use crate::failure::{Attempt, Failure};
use crate::stability::outcome::{Check, Naive, Outcome};
use crate::stability::solvers::tank::Tank;

/// Number of maps with noise of one unit in the last place.
const NOISY_MAPS: u64 = 50;
const DAYS_90_S: u32 = 90 * 24 * 3600;

fn quantifier(mesh: &Mesh) -> Result<Quantifier, Failure> {
    let settings = QuantitySettings::default();
    let surface = Surface::new(mesh, 1e-4 * settings.window_cm2, &[]).attempt("the surface")?;
    let unit = LoadUnit::RelativeLoss;
    Ok(Quantifier::of_surface(surface, settings, unit))
}

/// The quantities of a frame with these losses.
fn taken(quantifier: &mut Quantifier, at_s: f64, losses: &[f64]) -> FrameQuantities {
    let map = Map::relative("", losses.iter().map(|loss| -loss).collect(), "given");
    let judged = JudgedMap {
        map: &map,
        pressure: None,
        noise: None,
        tracked: None,
        compared: None,
    };
    quantifier.take(at_s, Some(&judged))
}

/// At random the next larger number, the next smaller one, or the number itself.
fn last_place(value: f64, random: &mut ChaCha8Rng) -> f64 {
    match random.random_range(0..3) {
        0 => value.next_up(),
        1 => value.next_down(),
        _ => value,
    }
}

/// For each triangle of the map the triangles that share a side with it.
fn neighbours(mesh: &Mesh) -> Vec<Vec<usize>> {
    let mut neighbours = vec![Vec::new(); mesh.region().len()];
    for ([a, b], _) in mesh.borders(mesh.region()) {
        neighbours[a].push(b);
        neighbours[b].push(a);
    }
    neighbours
}

/// The naive count: each triangle at or above the threshold that no neighbour exceeds is a hot spot.
fn maxima(neighbours: &[Vec<usize>], losses: &[f64], threshold: f64) -> usize {
    let is_maximum = |place: usize| {
        let mut around = neighbours[place].iter();
        losses[place] >= threshold && around.all(|other| losses[*other] <= losses[place])
    };
    (0..losses.len()).filter(|place| is_maximum(*place)).count()
}

/// 36: a constant map, two equal plateaus with noise in the last place, and loads at the threshold.
pub(crate) fn hot_spots() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let mesh = &tank.mesh;
    let around = neighbours(mesh);
    let threshold = 1e-2 * QuantitySettings::default().threshold_percent;
    let count = |losses: &[f64]| -> Result<usize, Failure> {
        Ok(taken(&mut quantifier(mesh)?, 0.0, losses).spots.len())
    };
    let constant = vec![0.3; mesh.region().len()];

    // two discs of a third of the sheet's radius
    let centroids: Vec<[f64; 2]> = mesh.region().iter().map(|t| mesh.centroid(*t)).collect();
    let reach = centroids
        .iter()
        .fold(0.0_f64, |most, at| most.max(at[0].abs()));
    let plateau = |at: &[f64; 2], x: f64| (at[0] - x).hypot(at[1]) < reach / 3.0;
    let two: Vec<f64> = centroids
        .iter()
        .map(
            |at| match plateau(at, -reach / 2.0) || plateau(at, reach / 2.0) {
                true => 0.3,
                false => 0.0,
            },
        )
        .collect();
    let (mut changed, mut naive_changed) = (0_usize, 0_usize);
    let exact = [count(&two)?, maxima(&around, &two, threshold)];
    // the same discs at the threshold, from frame to frame
    let mut followed = quantifier(mesh)?;
    let loaded = two
        .iter()
        .map(|loss| if *loss > 0.0 { threshold } else { 0.0 });
    let at_threshold: Vec<f64> = loaded.collect();
    let began = taken(&mut followed, 0.0, &at_threshold);
    let naive_began = maxima(&around, &at_threshold, threshold);
    let (mut flickers, mut naive_flickers) = (0_usize, 0_usize);
    for seed in 0..NOISY_MAPS {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut noisy = |losses: &[f64]| -> Vec<f64> {
            let noisy = losses.iter().map(|loss| last_place(*loss, &mut random));
            noisy.map(|loss| loss.max(0.0)).collect()
        };
        let map = noisy(&two);
        changed = changed.max(count(&map)?.abs_diff(exact[0]));
        naive_changed = naive_changed.max(maxima(&around, &map, threshold).abs_diff(exact[1]));
        // all values are alternately just below the threshold and at it
        let shift = if seed % 2 == 0 { 1.0 - 1e-15 } else { 1.0 };
        let map: Vec<f64> = at_threshold.iter().map(|loss| loss * shift).collect();
        let frame = taken(&mut followed, 1.0 + seed as f64, &map);
        flickers += frame.changes.len() + frame.spots.len().abs_diff(began.spots.len());
        naive_flickers += maxima(&around, &map, threshold).abs_diff(naive_began);
    }
    let naive = |figure: usize| Naive::Error(figure as f64);
    Ok(Outcome::of([
        Check::at_most(
            "hot spots of a constant map",
            naive(maxima(&around, &constant, threshold)),
            count(&constant)? as f64,
            0.0,
        ),
        Check::at_most(
            "hot spots of two equal discs, less 2",
            naive(exact[1].abs_diff(2)),
            exact[0].abs_diff(2) as f64,
            0.0,
        ),
        Check::at_most(
            "largest change of their count by noise in the last place, 50 maps",
            naive(naive_changed),
            changed as f64,
            0.0,
        ),
        Check::at_most(
            "appearances and ends of discs at the threshold, 50 frames",
            naive(naive_flickers),
            flickers as f64,
            0.0,
        ),
    ])
    .noted("naive: each triangle above the threshold that has no larger neighbour"))
}

/// 37: the dose of 0.1 for 90 days at 1 Hz; and a gap of two hours in the frames of a constant load.
pub(crate) fn dose() -> Result<Outcome, Failure> {
    let exact = 0.1 * f64::from(DAYS_90_S);
    let (mut sum, mut excess, mut plain, mut single) = (0.0, 0.0, 0.0_f64, 0.0_f32);
    for _ in 0..DAYS_90_S {
        add_compensated(&mut sum, &mut excess, 0.1);
        plain += 0.1;
        single += 0.1;
    }
    let apart = |found: f64| (found - exact).abs() / exact;

    let tank = Tank::small()?;
    let load = vec![0.3; tank.mesh.region().len()];
    let none = vec![0.0; load.len()];
    let unrelieved = |frame: &FrameQuantities| {
        let value = frame.regions[0].values.get(Quantity::Unrelieved);
        value.unwrap_or(f64::INFINITY)
    };
    // one frame per minute for three hours, two hours without frames, then one more frame
    let mut lost = [0.0; 2];
    for (of, counted_as_empty) in [(0, false), (1, true)] {
        let mut followed = quantifier(&tank.mesh)?;
        let mut before = 0.0;
        for minute in 0..=180 {
            before = unrelieved(&taken(&mut followed, 60.0 * f64::from(minute), &load));
        }
        for minute in 181..300 {
            if counted_as_empty {
                taken(&mut followed, 60.0 * f64::from(minute), &none);
            }
        }
        // the clock is set back by a minute afterwards
        let after = taken(&mut followed, 60.0 * 300.0, &load);
        let set_back = taken(&mut followed, 60.0 * 299.0, &load);
        lost[of] = (before - unrelieved(&after)).abs() + (before - unrelieved(&set_back)).abs();
    }
    let what = "0.1 for 90 days at 1 Hz, relative error of the dose";
    Ok(Outcome::of([
        Check::at_most(
            what,
            Naive::Error(apart(f64::from(single))),
            apart(sum),
            1e-12,
        ),
        Check::at_most(
            "the same; naive: f64 without compensation",
            Naive::Error(apart(plain)),
            apart(sum),
            1e-12,
        ),
        Check::at_most(
            "change of the unrelieved time (3 h) by a gap of 2 h, s",
            Naive::Error(lost[1]),
            lost[0],
            0.0,
        ),
    ])
    .noted("naive at a gap: frames that are missing count as empty"))
}
