//! Maps bounded to losses are the minimum within their bounds, whatever the prior.

use std::sync::Arc;

use crate::solved::{column, mesh, readings};
use eit::{Forward, Hyper, OneStep, OneStepOptions, Prior, Reconstructor, Scale};
use nalgebra::{DMatrix, DVector};
use survey::Protocol;

/// Twice the graph Laplacian of triangles that share an edge, times x.
fn laplacian(mesh: &eit::Mesh, x: &DVector<f64>) -> DVector<f64> {
    let mut open = std::collections::HashMap::new();
    let mut out = DVector::zeros(x.len());
    for (t, &[a, b, c]) in mesh.triangles().iter().enumerate() {
        for (p, q) in [(a, b), (b, c), (c, a)] {
            if let Some(other) = open.insert((p.min(q), p.max(q)), t) {
                let other: usize = other;
                out[t] += 2.0 * (x[t] - x[other]);
                out[other] += 2.0 * (x[other] - x[t]);
            }
        }
    }
    out
}

/// The inverse of the covariance of the gaussian prior, by its definition.
fn precision(mesh: &eit::Mesh, length: f64) -> DMatrix<f64> {
    let n = mesh.triangles().len();
    let mut kernel = DMatrix::from_fn(n, n, |i, j| {
        let (p, q) = (mesh.centroid(i), mesh.centroid(j));
        let square = ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)) / (length * length);
        if square <= 9.0 {
            (-square).exp() * mesh.area(j).sqrt()
        } else {
            0.0
        }
    });
    for mut row in kernel.row_iter_mut() {
        let norm = row.norm();
        row /= norm;
    }
    (&kernel * kernel.transpose()).cholesky().unwrap().inverse()
}

#[test]
fn the_bounded_map_is_the_minimum_within_its_bounds() {
    let case = needs::case("disc16");
    let (mesh, contact) = mesh(&case);
    let protocol = Protocol::sheffield(16).unwrap();
    let sigma = vec![1.0; 780];
    let lambda = 1e-3;
    let volts = [
        column(&case.join("v_exact_homog.csv")),
        column(&case.join("v_exact_one.csv")),
    ];
    let jacobian: DMatrix<f64> = Forward::new(Arc::clone(&mesh), &contact)
        .unwrap()
        .jacobian(&sigma, &protocol)
        .unwrap();
    // a length of one triangle: larger ones cannot be inverted, which the test needs and the method does not
    let length_m = (mesh.region_areas().iter().sum::<f64>() / 780.0).sqrt();
    let precision = precision(&mesh, length_m);
    for prior in [
        Prior::Tikhonov,
        Prior::Laplace,
        Prior::Gaussian { length_m },
    ] {
        let one_step = OneStep::new(
            Arc::clone(&mesh),
            &contact,
            &sigma,
            &protocol,
            OneStepOptions {
                prior,
                hyper: Hyper::Lambda(lambda),
                scale: Scale::Currents(vec![1.0; 208]),
                loss_only: true,
                ..OneStepOptions::default()
            },
        )
        .unwrap();
        let map = one_step
            .reconstruct(&readings(&volts[0]), &readings(&volts[1]))
            .unwrap();
        assert!(!map.method.contains("clipped"), "{}", map.method);
        let x = DVector::from_column_slice(&map.values);
        let misfit = DVector::from_fn(208, |i, _| volts[1][i] - volts[0][i]) - &jacobian * &x;
        let held = match prior {
            Prior::Laplace => laplacian(&mesh, &x),
            Prior::Gaussian { .. } => &precision * &x,
            _ => x.clone(),
        };
        let gradient = held * (lambda * lambda) - jacobian.tr_mul(&misfit);
        let scale = jacobian
            .tr_mul(&DVector::from_column_slice(&volts[1]))
            .amax();
        let mut bound = [0, 0];
        let mut worst = 0.0_f64;
        for (x, gradient) in x.iter().zip(&gradient) {
            assert!((-1.0..=0.0).contains(x));
            let tolerance = 1e-6 * scale;
            match *x {
                0.0 => {
                    bound[0] += 1;
                    assert!(*gradient <= tolerance, "{gradient}");
                }
                -1.0 => {
                    bound[1] += 1;
                    assert!(*gradient >= -tolerance, "{gradient}");
                }
                _ => assert!(gradient.abs() <= tolerance, "{prior:?}: {gradient} {scale}"),
            }
            if (-1.0 + 1e-12..-1e-12).contains(x) {
                worst = worst.max(gradient.abs() / scale);
            }
        }
        println!("{prior:?}: {bound:?} on the bounds, gradient elsewhere {worst:.1e}");
        assert!(bound[0] > 50, "{prior:?}: {bound:?}");
    }
}
