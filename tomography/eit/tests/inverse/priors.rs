//! The smooth prior, the rules that choose lambda, and low-rank frames, each compared with its definition.

use std::sync::Arc;

use eit::{
    DiscTank, Forward, Hyper, HyperRule, Mesh, OneStep, OneStepError, OneStepOptions, Prior,
    Reconstructor, Scale,
};
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::{Protocol, Reading, Volts};

struct Tank {
    mesh: Arc<Mesh>,
    contact: Vec<f64>,
    sigma0: Vec<f64>,
    protocol: Protocol,
}

impl Tank {
    fn new(fineness: f64) -> Self {
        let tank = DiscTank {
            fineness,
            ..DiscTank::default()
        };
        let mesh = Arc::new(tank.mesh().unwrap());
        Self {
            sigma0: vec![tank.conductance(); mesh.triangles().len()],
            contact: tank.contact_ohm_m(),
            protocol: Protocol::sheffield(16).unwrap(),
            mesh,
        }
    }

    fn step(&self, options: OneStepOptions) -> OneStep {
        self.try_step(options).unwrap()
    }

    fn try_step(&self, options: OneStepOptions) -> Result<OneStep, OneStepError> {
        OneStep::new(
            Arc::clone(&self.mesh),
            &self.contact,
            &self.sigma0,
            &self.protocol,
            options,
        )
    }

    /// Baseline, and frames of one disc each, at 1 mA with white noise.
    fn recording(&self, noise_v: f64, count: usize) -> (Vec<Reading>, Vec<Vec<Reading>>) {
        let forward = Forward::new(Arc::clone(&self.mesh), &self.contact).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let normal = Normal::new(0.0, noise_v).unwrap();
        let mut taken = |sigma: &[f64]| -> Vec<Reading> {
            let volts = forward.readings(sigma, &self.protocol).unwrap();
            let noisy = |v: &f64| Reading::Ok(Volts(1e-3 * v + normal.sample(&mut random)));
            volts.iter().map(noisy).collect()
        };
        let baseline = taken(&self.sigma0);
        let reach = (0..self.mesh.triangles().len())
            .map(|t| self.mesh.centroid(t)[0].abs())
            .fold(0.0, f64::max);
        let frames = (0..count)
            .map(|k| {
                let angle = k as f64 * 2.4;
                let at = [0.6 * reach * angle.cos(), 0.6 * reach * angle.sin()];
                let sigma: Vec<f64> = (0..self.sigma0.len())
                    .map(|t| {
                        let [x, y] = self.mesh.centroid(t);
                        let inside = (x - at[0]).hypot(y - at[1]) < 0.2 * reach;
                        self.sigma0[t] * if inside { 0.6 } else { 1.0 }
                    })
                    .collect();
                taken(&sigma)
            })
            .collect();
        (baseline, frames)
    }
}

#[test]
fn the_gaussian_map_is_that_of_its_covariance() {
    let tank = Tank::new(0.5);
    let (length, lambda) = (0.02, 1.0);
    let step = tank.step(OneStepOptions {
        prior: Prior::Gaussian { length_m: length },
        hyper: Hyper::Lambda(lambda),
        scale: Scale::Currents(vec![1.0; 208]),
        ..OneStepOptions::default()
    });
    let n = tank.mesh.triangles().len();
    let mut kernel = DMatrix::from_fn(n, n, |i, j| {
        let (p, q) = (tank.mesh.centroid(i), tank.mesh.centroid(j));
        let square = ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)) / (length * length);
        if square <= 9.0 {
            (-square).exp() * tank.mesh.area(j).sqrt()
        } else {
            0.0
        }
    });
    for mut row in kernel.row_iter_mut() {
        let norm = row.norm();
        row /= norm;
    }
    let covariance = &kernel * kernel.transpose();
    // the stated correlation, as triangles are small compared with the length
    for (i, j) in [(0, 1), (n / 2, n / 2 + 1), (n / 3, n / 3 + 2)] {
        let (p, q) = (tank.mesh.centroid(i), tank.mesh.centroid(j));
        let square = ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)) / (length * length);
        let apart = covariance[(i, j)] - (-0.5 * square).exp();
        assert!(apart.abs() < 0.05, "{apart} at {square}");
    }
    let j = Forward::new(Arc::clone(&tank.mesh), &tank.contact)
        .unwrap()
        .jacobian(&tank.sigma0, &tank.protocol)
        .unwrap()
        * tank.sigma0[0];
    let spread = &covariance * j.transpose();
    let mut system = &j * &spread;
    for i in 0..system.nrows() {
        system[(i, i)] += lambda * lambda;
    }
    let expected = spread * system.try_inverse().unwrap();
    let error = (step.matrix().unwrap() - &expected).amax() / expected.amax();
    println!("gaussian: {error:.1e}");
    assert!(error < 1e-11, "{error:e}");
}

#[test]
fn lambda_follows_its_rules() {
    let tank = Tank::new(0.6);
    for wanted in [0.7, 2.0] {
        let step = tank.step(OneStepOptions {
            hyper: Hyper::NoiseFigure(wanted),
            ..OneStepOptions::default()
        });
        let has = step.noise_figure().unwrap();
        assert!((has / wanted - 1.0).abs() < 3e-3, "{has} for {wanted}");
    }
    let refused = tank.try_step(OneStepOptions {
        hyper: in_frame(HyperRule::Evidence, None),
        map_error: Some(1e-3),
        ..OneStepOptions::default()
    });
    assert_eq!(refused.err(), Some(OneStepError::MapErrorPerFrame));
}

fn in_frame(rule: HyperRule, volts: Option<f64>) -> Hyper {
    Hyper::Frame {
        rule,
        volts,
        current: 1e-3,
    }
}

/// The map of a frame equals the map with one fixed lambda, for every prior and with missing readings.
#[test]
fn a_frame_is_mapped_with_one_lambda() {
    let tank = Tank::new(0.3);
    let (baseline, frames) = tank.recording(2e-6, 1);
    let mut holed = frames[0].clone();
    holed[17] = Reading::Overload;
    holed[100] = Reading::NotMeasured;
    let gaussian = Prior::Gaussian { length_m: 0.03 };
    for (prior, rule, frame) in [
        (Prior::Noser { p: 0.25 }, HyperRule::Evidence, &frames[0]),
        (Prior::Noser { p: 0.25 }, HyperRule::LCurve, &holed),
        (Prior::Laplace, HyperRule::Evidence, &holed),
        (gaussian, HyperRule::Evidence, &frames[0]),
    ] {
        let with = |hyper| {
            tank.try_step(OneStepOptions {
                prior,
                hyper,
                ..OneStepOptions::default()
            })
        };
        let chosen = with(in_frame(rule, Some(2e-6))).unwrap();
        assert_eq!(chosen.lambda(), None);
        assert!(chosen.matrix().is_err() && chosen.noise_figure().is_none());
        let map = DVector::from_vec(chosen.reconstruct(&baseline, frame).unwrap().values);
        let far = |log: f64| {
            let Ok(step) = with(Hyper::Lambda(10_f64.powf(log))) else {
                return f64::INFINITY; // negligible relative to the sensitivities
            };
            let other = step.reconstruct(&baseline, frame).unwrap();
            (DVector::from_vec(other.values) - &map).norm() / map.norm()
        };
        // a coarse search, then golden sections
        let coarse = (-12..6)
            .map(|step| f64::from(step) * 0.5)
            .min_by(|a, b| far(*a).total_cmp(&far(*b)))
            .unwrap();
        let (mut low, mut high) = (coarse - 0.5, coarse + 0.5);
        for _ in 0..25 {
            let (a, b) = (low + 0.382 * (high - low), low + 0.618 * (high - low));
            if far(a) < far(b) {
                high = b;
            } else {
                low = a;
            }
        }
        let least = far(0.5 * (low + high));
        println!("{prior:?} {rule:?}: lambda 1e{low:.3}, {least:.1e}");
        assert!(least < 1e-4, "{prior:?} {rule:?}: {least:e}");
    }
}

/// The evidence rule finds the noise of a frame if it is not stated; the corner rule agrees within the usual difference
/// of the two.
#[test]
fn lambda_of_a_frame_follows_its_noise() {
    let tank = Tank::new(0.6);
    let size = |values: &[f64]| DVector::from_column_slice(values).norm();
    for noise_v in [1e-6, 1e-5, 1e-4] {
        let (baseline, frames) = tank.recording(noise_v, 6);
        let mean = |hyper| {
            let step = tank.step(OneStepOptions {
                hyper,
                ..OneStepOptions::default()
            });
            let maps = frames
                .iter()
                .map(|frame| size(&step.reconstruct(&baseline, frame).unwrap().values));
            maps.sum::<f64>() / frames.len() as f64
        };
        let free = mean(in_frame(HyperRule::Evidence, None));
        let stated = mean(in_frame(HyperRule::Evidence, Some(noise_v)));
        let corner = mean(in_frame(HyperRule::LCurve, Some(noise_v)));
        let doubtful = mean(in_frame(HyperRule::Evidence, Some(100.0 * noise_v)));
        println!(
            "{noise_v:e} V: free {free:.3}, stated {stated:.3}, corner {corner:.3}, 100 x {doubtful:.3}"
        );
        assert!((0.8..1.25).contains(&(free / stated)), "{free} {stated}");
        assert!((0.5..2.0).contains(&(corner / stated)), "{corner} {stated}");
        assert!(doubtful < 0.98 * stated, "{doubtful} {stated}");
    }
}

/// The bound is decided for each frame: true gains are kept, ringing is removed.
#[test]
fn frames_with_gain_are_not_bounded() {
    let tank = Tank::new(0.6);
    let (baseline, frames) = tank.recording(1e-6, 1);
    let step = tank.step(OneStepOptions {
        hyper: in_frame(HyperRule::Evidence, Some(1e-6)),
        loss_only: true,
        most_gain: Some(0.2),
        ..OneStepOptions::default()
    });
    let loss = step.reconstruct(&baseline, &frames[0]).unwrap();
    let gain = step.reconstruct(&frames[0], &baseline).unwrap();
    assert!(loss.method.ends_with(", loss only"), "{}", loss.method);
    assert!(loss.values.iter().all(|value| (-1.0..=0.0).contains(value)));
    assert!(!gain.method.contains("loss only"), "{}", gain.method);
    assert!(gain.values.iter().any(|value| *value > 0.1));
}

#[test]
fn low_rank_maps_stay_within_map_error() {
    let tank = Tank::new(1.0);
    let (baseline, frames) = tank.recording(2e-6, 8);
    let exact = tank.step(OneStepOptions::default());
    let quick = tank.step(OneStepOptions {
        map_error: Some(1e-3),
        ..OneStepOptions::default()
    });
    assert!(
        quick
            .assumptions()
            .iter()
            .any(|reported| reported.contains("1e-3")),
        "{:?}",
        quick.assumptions()
    );
    let mut differ = 0;
    for frame in &frames {
        let [a, b] = [&exact, &quick]
            .map(|step| DVector::from_vec(step.reconstruct(&baseline, frame).unwrap().values));
        let error = (&b - &a).amax() / a.amax();
        assert!(error <= 1e-3, "{error:e}");
        differ += usize::from(error > 0.0);
    }
    assert!(differ >= 6, "{differ} of {} were quick", frames.len());
    // for pure noise no bound of the error holds: the full matrix is used, bit for bit
    let [a, b] = [&exact, &quick].map(|step| step.reconstruct(&baseline, &baseline).unwrap());
    assert_eq!(a.values, b.values);
}
