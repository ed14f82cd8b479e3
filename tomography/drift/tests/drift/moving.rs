//! A load that moves while it is measured: simulated injection by injection on a finer mesh than the model's.

use drift::{DriftError, DriftModel, Injection, TimedReading};
use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use survey::Protocol;

use crate::sheet::{Fine, Sheet};

/// From one injection to the next, s: a frame takes 13 s.
const STEP_S: f64 = 0.5;
const NOISE_V: f64 = 2e-6;
const RADIUS_M: f64 = 15e-3;

/// The injections of a disc of 30 mm that takes half of the conductance, or of an empty sheet, at 2 uV.
fn injections(count: usize, seed: u64, place: impl Fn(f64) -> Option<[f64; 2]>) -> Vec<Injection> {
    injections_of(0.5, count, seed, place)
}

/// Like [`injections`], for a disc with this loss.
fn injections_of(
    loss: f64,
    count: usize,
    seed: u64,
    place: impl Fn(f64) -> Option<[f64; 2]>,
) -> Vec<Injection> {
    let fine = Fine::new();
    let protocol = Protocol::sheffield(26).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|k| {
            let at_s = STEP_S * k as f64;
            let centre = place(at_s);
            let volts = fine.volts(|share_within| match centre {
                Some(centre) => 1.0 - loss * share_within(centre, RADIUS_M),
                None => 1.0,
            });
            let drive = (k % 26, (k + 1) % 26);
            let measurements = protocol.measurements().iter().enumerate();
            let own = measurements.filter(|(_, q)| (q.drive.plus.0, q.drive.minus.0) == drive);
            let readings = own.map(|(reading, _)| {
                let normal: f64 = StandardNormal.sample(&mut random);
                TimedReading {
                    reading,
                    volts: volts[reading] + NOISE_V * normal,
                }
            });
            Injection {
                at_s,
                readings: readings.collect(),
            }
        })
        .collect()
}

fn model() -> DriftModel {
    let fine = Fine::new();
    let readings = fine.volts(|_| 1.0);
    let readings = readings
        .into_iter()
        .map(|volts| survey::Reading::Ok(survey::Volts(volts)));
    Sheet::of(readings.collect()).model()
}

#[test]
fn a_load_that_moves_is_found_where_it_is_now() {
    let model = model();
    let none = DVector::zeros(299);
    for (speed, goal_mm) in [(2e-3, 0.2), (8e-3, 1.0)] {
        let path = |at_s: f64| [0.06 + speed * at_s * 0.8, 0.08 + speed * at_s * 0.6];
        let all = injections(30, 3, |at_s| Some(path(at_s)));
        let mut sum = 0.0;
        for end in 26..=30 {
            let found = model
                .moving_load(&all[..end], &none, model.noise())
                .unwrap()
                .expect("it is seen");
            let truth = path(STEP_S * (end - 1) as f64);
            let [x, y] = found.disc.centre;
            let error = 1e3 * (x - truth[0]).hypot(y - truth[1]);
            let velocity = (found.velocity[0] - 0.8 * speed).hypot(found.velocity[1] - 0.6 * speed);
            assert!(velocity < 1e-3 && found.accepted, "{speed}: {found:?}");
            let sd_mm = 1e3 * found.covariance[0][0].max(found.covariance[1][1]).sqrt();
            assert!(error < 3.0 * sd_mm && sd_mm < 1.0, "{speed}: {found:?}");
            sum += error / 5.0;
        }
        eprintln!("{} mm/s: {sum:.2} mm", 1e3 * speed);
        assert!(sum < goal_mm, "{speed}: {sum} mm");
    }
}

#[test]
fn a_load_that_came_is_found_from_the_injections_after_it() {
    let model = model();
    let none = DVector::zeros(299);
    let place = [0.07, 0.11];
    let came_s = STEP_S * 20.0;
    let all = injections(30, 4, |at_s| (at_s >= came_s).then_some(place));
    let at = |end: usize| {
        let found = model
            .moving_load(&all[..end], &none, model.noise())
            .unwrap();
        found.expect("it is seen")
    };
    let of = at(30);
    let error = 1e3 * (of.disc.centre[0] - place[0]).hypot(of.disc.centre[1] - place[1]);
    assert!(of.accepted && error < 1.0, "{error} mm: {of:?}");
    assert!(of.injections < 13, "those before it came are left out");
    // some of the last seven injections saw an empty sheet, which no moving load explains
    assert!(!at(23).accepted, "{:?}", at(23));
    let map = of.disc.map(model.mesh());
    let areas = model.mesh().region_areas();
    let sum: f64 = map
        .iter()
        .zip(&areas)
        .map(|(value, area)| value * area)
        .sum();
    let area = std::f64::consts::FRAC_PI_4 * of.disc.diameter.powi(2);
    assert!((sum / (-of.disc.loss * area) - 1.0).abs() < 1e-9);
}

#[test]
fn a_weak_load_shows_in_more_injections() {
    let model = model();
    let none = DVector::zeros(299);
    let place = [0.15, 0.15];
    let all = injections_of(0.0022, 26, 6, |_| Some(place));
    let of = |from: usize| {
        let found = model.moving_load(&all[from..], &none, model.noise());
        found.unwrap()
    };
    assert_eq!(of(19), None, "seven injections do not show it");
    let found = of(0).expect("26 do");
    let error = 1e3 * (found.disc.centre[0] - place[0]).hypot(found.disc.centre[1] - place[1]);
    let sd = 1e3 * found.covariance[0][0].max(found.covariance[1][1]).sqrt();
    assert_eq!(found.injections, 26);
    assert!(error < 3.0 * sd, "{error} mm: {found:?}");
}

#[test]
fn an_empty_sheet_has_no_moving_load() {
    let model = model();
    let none = DVector::zeros(299);
    let mut all = injections(26, 5, |_| None);
    for end in 1..=26 {
        let found = model
            .moving_load(&all[..end], &none, model.noise())
            .unwrap();
        assert_eq!(found, None, "{end} injections");
    }
    // readings without a value are left out, others refused
    all[3].readings[2].volts = f64::NAN;
    all[25].readings.clear();
    let found = model.moving_load(&all, &none, model.noise()).unwrap();
    assert_eq!(found, None);
    assert_eq!(model.moving_load(&[], &none, model.noise()).unwrap(), None);
    all[0].readings[0].reading = 598;
    assert!(model.moving_load(&all[..1], &none, model.noise()).is_err());
}

#[test]
fn readings_of_nearly_0_v_are_missing_after_an_injection() {
    let model = model();
    let none = DVector::zeros(299);
    let all = injections(26, 7, |_| Some([0.07, 0.11]));
    // the source is off during these of the last injections
    let off_as = |volts: f64, off: std::ops::Range<usize>| {
        let mut all = all.clone();
        for injection in &mut all[off] {
            injection
                .readings
                .iter_mut()
                .for_each(|one| one.volts = volts);
        }
        model.moving_load(&all, &none, model.noise())
    };
    let found = [1e-7, f64::NAN].map(|volts| off_as(volts, 20..23).unwrap());
    assert_eq!(found[0], found[1]);
    let load = found[0].as_ref().expect("the other injections show it");
    let off_mm = 1e3 * (load.disc.centre[0] - 0.07).hypot(load.disc.centre[1] - 0.11);
    assert!(load.accepted && off_mm < 1.0, "{load:?}");
    for off in [19..26, 22..26] {
        for volts in [1e-7, f64::NAN] {
            let found = off_as(volts, off.clone());
            let few = matches!(found, Err(DriftError::FewReadings { wants: 161, .. }));
            assert!(few, "{off:?}, {volts} V: {found:?}");
        }
    }
}

#[test]
fn gain_of_conductance_is_reported_in_full() {
    let model = model();
    let none = DVector::zeros(299);
    // three times the conductance
    let all = injections_of(-2.0, 26, 8, |_| Some([0.1, 0.11]));
    let found = model.moving_load(&all, &none, model.noise()).unwrap();
    let disc = found.expect("it is seen").disc;
    assert!((disc.loss / -2.0 - 1.0).abs() < 0.1, "{disc:?}");
}
