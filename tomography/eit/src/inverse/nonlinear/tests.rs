//! The kind of map that the method chooses for a given sheet.

use super::*;
use crate::DiscTank;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::Volts;

const NOISE_V: f64 = 2e-5;

struct Stage {
    method: NonlinearTv,
    sigma0: Vec<f64>,
}

fn stage() -> Stage {
    let tank = DiscTank {
        radius_mm: 100.0,
        fineness: 0.7,
        ..DiscTank::default()
    };
    let mesh = Arc::new(tank.mesh().unwrap());
    let sigma0 = vec![tank.conductance(); mesh.triangles().len()];
    let protocol = Protocol::sheffield(16).unwrap();
    let options = NonlinearTvOptions {
        noise_v: Some(NOISE_V),
        most_gain: Some(0.2),
        ..NonlinearTvOptions::default()
    };
    let contacts = tank.contact_ohm_m();
    let method = NonlinearTv::new(mesh, &contacts, &sigma0, &protocol, options).unwrap();
    Stage { method, sigma0 }
}

impl Stage {
    /// Readings with a change of conductance as a function of position, m.
    fn readings(&self, change: impl Fn([f64; 2]) -> f64, seed: u64) -> Vec<Reading> {
        let mesh = self.method.mesh();
        // the geometric mean over 100 points of each triangle
        let mean = |t: usize| {
            let [a, b, c] = mesh.corners(t);
            let places = (0..100).map(|k| {
                let (u, v) = (f64::from(k % 10) + 0.5, f64::from(k / 10) + 0.5);
                let (u, v) = (0.1 * u, 0.1 * v);
                let (u, v) = if u + v > 1.0 {
                    (1.0 - u, 1.0 - v)
                } else {
                    (u, v)
                };
                [0, 1].map(|i| a[i] + u * (b[i] - a[i]) + v * (c[i] - a[i]))
            });
            (places.map(|at| (1.0 + change(at)).ln()).sum::<f64>() / 100.0).exp()
        };
        let triangles = 0..self.sigma0.len();
        let sigma: Vec<f64> = triangles.map(|t| self.sigma0[t] * mean(t)).collect();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let noise = Normal::new(0.0, NOISE_V).unwrap();
        let ohms = self
            .method
            .sheet
            .forward
            .readings(&sigma, &self.method.protocol);
        let volts = ohms
            .unwrap()
            .iter()
            .map(|ohms| 1e-3 * ohms)
            .collect::<Vec<f64>>();
        let noisy = volts.iter().map(|volts| volts + noise.sample(&mut random));
        noisy.map(|volts| Reading::Ok(Volts(volts))).collect()
    }

    fn map(&self, change: impl Fn([f64; 2]) -> f64) -> (Map, f64) {
        let mesh = self.method.mesh();
        let truth: Vec<f64> = mesh.region_centroids().into_iter().map(&change).collect();
        let baseline = self.readings(|_| 0.0, 1);
        let map = self
            .method
            .reconstruct(&baseline, &self.readings(change, 2))
            .unwrap();
        let correlation = likeness(&map.values, &truth, &mesh.region_areas()).correlation;
        (map, correlation)
    }
}

fn within([x, y]: [f64; 2], centre: [f64; 2], radius: f64) -> bool {
    (x - centre[0]).hypot(y - centre[1]) < radius
}

#[test]
fn discs_rings_others_and_gains_are_found_by_different_methods() {
    let stage = stage();
    let disc = |at| {
        if within(at, [0.03, -0.01], 0.025) {
            -0.6
        } else {
            0.0
        }
    };
    let (map, correlation) = stage.map(disc);
    assert_eq!(map.method, "discs (1)");
    assert!(correlation > 0.95, "{correlation}");
    let ring = |at| match within(at, [0.02, 0.0], 0.06) && !within(at, [0.02, 0.0], 0.04) {
        true => -0.6,
        false => 0.0,
    };
    let (map, correlation) = stage.map(ring);
    assert_eq!(map.method, "ring");
    assert!(correlation > 0.9, "{correlation}");
    // the evidence for a ring clearly exceeds that for any other shape
    let evidence = map.evidence.unwrap();
    let (left, next) = (evidence.left.unwrap(), evidence.next.unwrap());
    assert!(
        left <= 1.0 && next.left > left && next.ln_odds.unwrap() > 10.0,
        "{left} {next:?}"
    );
    let bar = |[x, y]: [f64; 2]| match (x - y).abs() < 0.08 && (x + y).abs() < 0.015 {
        true => -0.6,
        false => 0.0,
    };
    let (map, correlation) = stage.map(bar);
    assert_eq!(map.method, "bar");
    assert!(correlation > 0.9, "{correlation}");
    let half = |at: [f64; 2]| ring(at) * f64::from(u8::from(at[1] > 0.0));
    let (map, correlation) = stage.map(half);
    assert_eq!(map.method, "nonlinear total variation, loss only");
    assert!(correlation > 0.8, "{correlation}");
    let evidence = map.evidence.unwrap();
    let next = evidence.next.unwrap();
    assert!(next.left > 1.0 && next.ln_odds.is_none(), "{next:?}");
    assert_eq!(evidence.left, None);
    assert!(map.values.iter().all(|value| *value <= 0.0));
    let (map, correlation) = stage.map(|at| -disc(at));
    assert_eq!(map.method, METHOD);
    assert!(correlation > 0.8, "{correlation}");
}

#[test]
fn weak_disc_beside_a_strong_one_is_found_in_the_rest() {
    let stage = stage();
    let strong = |at| within(at, [0.03, -0.01], 0.025);
    let weak = |at| within(at, [-0.05, 0.03], 0.012);
    let (map, correlation) = stage.map(|at| match (strong(at), weak(at)) {
        (true, _) => -0.6,
        (_, true) => -0.05,
        _ => 0.0,
    });
    assert_eq!(map.method, "discs (2)");
    assert!(correlation > 0.97, "{correlation}");
}

#[test]
fn smooth_load_over_the_sheet_is_found_as_one() {
    let stage = stage();
    let wave = |[x, y]: [f64; 2]| -0.2 * (1.0 + (15.0 * x + 10.0 * y).sin());
    let (map, correlation) = stage.map(wave);
    assert_eq!(map.method, SMOOTH);
    assert!(correlation > 0.98, "{correlation}");
    assert!(map.values.iter().all(|value| *value <= 0.0));
    let evidence = map.evidence.unwrap();
    let (left, next) = (evidence.left.unwrap(), evidence.next.unwrap());
    assert!(left > 0.0 && left <= 1.0, "{left}");
    assert!(next.method == "discs (1)" && next.left > 1.0, "{next:?}");
    // losses cannot explain the same change as gains
    let (map, correlation) = stage.map(|at| -wave(at));
    assert_eq!(map.method, METHOD);
    assert!(correlation > 0.9, "{correlation}");
}

#[test]
fn noise_alone_gives_a_map_of_nothing() {
    let stage = stage();
    let (map, _) = stage.map(|_| 0.0);
    assert_eq!(map.method, NOISE_ONLY);
    assert!(map.values.iter().all(|value| value.abs() < 1e-3));
    let baseline = stage.readings(|_| 0.0, 1);
    let same = stage.method.reconstruct(&baseline, &baseline).unwrap();
    assert!(same.values.iter().all(|value| *value == 0.0));
}

#[test]
fn one_thread_and_two_give_the_same_map() {
    let stage = stage();
    let made = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            stage
                .map(|at| {
                    if within(at, [0.0, 0.04], 0.02) {
                        -0.5
                    } else {
                        0.0
                    }
                })
                .0
        })
    };
    assert_eq!(made(1), made(2));
}
