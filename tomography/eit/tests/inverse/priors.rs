//! The smooth prior, the rules that choose lambda, and low-rank frames, each compared with its definition.

use std::sync::Arc;

use eit::{
    DiscTank, Forward, Hyper, Mesh, OneStep, OneStepOptions, Prior, Reconstructor, Scale,
    l_curve_lambda, probable_lambda,
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
        OneStep::new(
            Arc::clone(&self.mesh),
            &self.contact,
            &self.sigma0,
            &self.protocol,
            options,
        )
        .unwrap()
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
    let error = (step.matrix() - &expected).amax() / expected.amax();
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
    let options = OneStepOptions::default();
    for noise_v in [1e-6, 1e-5, 1e-4] {
        let (baseline, frames) = tank.recording(noise_v, 6);
        let frames: Vec<&[Reading]> = frames.iter().map(Vec::as_slice).collect();
        let [probable, corner] = [probable_lambda, l_curve_lambda].map(|rule| {
            let found = rule(
                &tank.mesh,
                &tank.contact,
                &tank.sigma0,
                &tank.protocol,
                &options,
                &baseline,
                &frames,
            );
            found.unwrap().unwrap()
        });
        println!("noise {noise_v:e}: evidence {probable:.2e}, L-curve {corner:.2e}");
        // corner and evidence agree within the usual difference of the two rules
        assert!((0.3..3.0).contains(&(corner / probable)), "{noise_v:e}");
    }
}

#[test]
fn quick_frames_keep_their_word() {
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
    // pure noise allows no bound: the full matrix, bit for bit
    let [a, b] = [&exact, &quick].map(|step| step.reconstruct(&baseline, &baseline).unwrap());
    assert_eq!(a.values, b.values);
}
