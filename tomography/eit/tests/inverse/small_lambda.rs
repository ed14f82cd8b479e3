//! Hyper-parameters far below the sensitivities: the map of the stated problem, or an error, never a wrong map.
//!
//! The reference is the stacked least-squares problem [J; lambda D] assembled here from the mesh, solved by QR and
//! refined with residuals in twice the precision to convergence (A. Bjorck, BIT 7 (1967) 257).

use std::sync::Arc;

use eit::{DiscTank, Forward, Hyper, Mesh, OneStep, OneStepError, OneStepOptions, Prior, Scale};
use nalgebra::{DMatrix, DVector};
use survey::Protocol;

/// b - A x in twice the precision, rounded once.
fn residual(
    a: &DMatrix<f64>,
    x: &DVector<f64>,
    b: &DVector<f64>,
    minus: &DVector<f64>,
) -> DVector<f64> {
    DVector::from_fn(b.len(), |i, _| {
        let (mut high, mut low) = (b[i], 0.0);
        let mut add = |term: f64, rest: f64| {
            let sum = high + term;
            let back = sum - high;
            low += (high - (sum - back)) + (term - back) + rest;
            high = sum;
        };
        add(-minus[i], 0.0);
        for k in 0..x.len() {
            let product = a[(i, k)] * x[k];
            add(-product, -a[(i, k)].mul_add(x[k], -product));
        }
        high + low
    })
}

/// The x that minimises |A x - b|.
fn least_squares(a: &DMatrix<f64>, b: &DVector<f64>) -> DVector<f64> {
    let qr = a.clone().qr();
    let (q, u) = (qr.q(), qr.r());
    let at = a.transpose();
    let mut x = u.solve_upper_triangular(&q.tr_mul(b)).unwrap();
    let mut r = residual(a, &x, b, &DVector::zeros(b.len()));
    for _ in 0..8 {
        let f = residual(a, &x, b, &r);
        let g = residual(&at, &r, &DVector::zeros(x.len()), &DVector::zeros(x.len()));
        // [I A; A' 0] [dr; dx] = [f; g]
        let h = u.tr_solve_upper_triangular(&g).unwrap();
        let d = q.tr_mul(&f);
        let dx = u.solve_upper_triangular(&(&d - &h)).unwrap();
        r += f - &q * (d - h);
        x += dx;
    }
    x
}

struct Tank {
    mesh: Arc<Mesh>,
    contact: Vec<f64>,
    sigma0: Vec<f64>,
    protocol: Protocol,
    currents: Vec<f64>,
}

impl Tank {
    fn new() -> Self {
        let tank = DiscTank {
            fineness: 0.3,
            ..DiscTank::default()
        };
        let mesh = Arc::new(tank.mesh().unwrap());
        let protocol = Protocol::sheffield(16).unwrap();
        Self {
            sigma0: vec![tank.conductance(); mesh.triangles().len()],
            contact: tank.contact_ohm_m(),
            currents: vec![1e-3; protocol.len()],
            mesh,
            protocol,
        }
    }

    fn forward(&self) -> Forward {
        Forward::new(Arc::clone(&self.mesh), &self.contact).unwrap()
    }

    fn step(&self, prior: Prior, hyper: Hyper) -> Result<OneStep, OneStepError> {
        let options = OneStepOptions {
            prior,
            hyper,
            scale: Scale::Currents(self.currents.clone()),
            ..OneStepOptions::default()
        };
        OneStep::new(
            Arc::clone(&self.mesh),
            &self.contact,
            &self.sigma0,
            &self.protocol,
            options,
        )
    }

    /// Rows of the penalty: a difference per border, times its length if `long`.
    fn differences(&self, long: bool) -> DMatrix<f64> {
        let mut open = std::collections::HashMap::new();
        let mut rows = Vec::new();
        for (t, &[a, b, c]) in self.mesh.triangles().iter().enumerate() {
            for (p, q) in [(a, b), (b, c), (c, a)] {
                if let Some(other) = open.insert((p.min(q), p.max(q)), t) {
                    let length = self.mesh.edge_length([p, q]);
                    rows.push((t, other, if long { length } else { 2_f64.sqrt() }));
                }
            }
        }
        let mut matrix = DMatrix::zeros(rows.len(), self.mesh.triangles().len());
        for (row, (t, other, weight)) in rows.into_iter().enumerate() {
            matrix[(row, t)] = weight;
            matrix[(row, other)] = -weight;
        }
        matrix
    }

    /// Error of a prior's map relative to the largest value of the reference.
    fn apart(&self, prior: Prior, penalty: &DMatrix<f64>, hyper: Hyper) -> f64 {
        let step = self.step(prior, hyper).unwrap();
        let lambda = step.lambda().unwrap();
        let mut j = self
            .forward()
            .jacobian(&self.sigma0, &self.protocol)
            .unwrap()
            * (1e-3 * self.sigma0[0]);
        // twins equal to the last bit: with so small a lambda, their rounding differences would show in the map
        for (reading, twin) in self.protocol.reciprocal_twins().into_iter().enumerate() {
            if let Some(twin) = twin.filter(|&twin| twin < reading) {
                let row = j.row(twin).into_owned();
                j.set_row(reading, &row);
            }
        }
        let dv = DVector::from_fn(j.nrows(), |i, _| 1e-6 * (1.0 + i as f64).sin());
        let mut stacked = DMatrix::zeros(j.nrows() + penalty.nrows(), j.ncols());
        stacked.rows_mut(0, j.nrows()).copy_from(&j);
        stacked
            .rows_mut(j.nrows(), penalty.nrows())
            .copy_from(&(penalty * lambda));
        let mut right = DVector::zeros(stacked.nrows());
        right.rows_mut(0, dv.len()).copy_from(&dv);
        let truth = least_squares(&stacked, &right);
        (step.matrix().unwrap() * dv - &truth).amax() / truth.amax()
    }
}

/// The paper's Eq. 4 and 5 as printed, over twelve decades of alpha.
#[test]
fn the_papers_step_is_the_least_squares_of_its_formula() {
    let tank = Tank::new();
    let penalty = tank.differences(true);
    for (alpha, tolerance) in [
        (1e-2, 1e-11),
        (1e-4, 1e-10),
        (1e-6, 1e-9),
        (1e-8, 1e-8),
        (1e-10, 1e-8),
    ] {
        let apart = tank.apart(Prior::Variation, &penalty, Hyper::Paper(alpha));
        println!("alpha {alpha:e}: {apart:.1e}");
        assert!(apart <= tolerance, "alpha {alpha:e}: {apart:e}");
    }
}

#[test]
fn every_prior_down_to_where_it_is_refused() {
    let tank = Tank::new();
    let n = tank.mesh.triangles().len();
    for (prior, penalty) in [
        (Prior::Tikhonov, DMatrix::identity(n, n)),
        (Prior::Laplace, tank.differences(false)),
    ] {
        let mut met = 0;
        for decade in -15..-3 {
            let lambda = 10_f64.powi(decade);
            match tank.step(prior, Hyper::Lambda(lambda)) {
                Ok(_) => {
                    let apart = tank.apart(prior, &penalty, Hyper::Lambda(lambda));
                    println!("{prior:?}, lambda {lambda:e}: {apart:.1e}");
                    assert!(apart <= 1e-8, "{prior:?}, lambda {lambda:e}: {apart:e}");

                    met += 1;
                }
                Err(OneStepError::Lambda { floor, .. }) => {
                    assert!(lambda <= floor && met == 0, "{lambda:e} {floor:e}");
                }
                Err(fault) => panic!("{fault}"),
            }
        }
        assert!((3..12).contains(&met), "{met}");
    }
}
