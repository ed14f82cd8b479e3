//! Sensitivities to triangles, regions, cells, logarithms and contacts, compared with differences and with each other.

use std::sync::Arc;

use crate::parts::{eight, spread};
use eit::{Forward, ForwardError, PaperSheet, Parameters};
use nalgebra::{DMatrix, DVector};
use survey::{Protocol, skip};

fn sheet() -> (Forward, Vec<f64>, Protocol) {
    let sheet = PaperSheet {
        fineness: 0.4,
        ..PaperSheet::default()
    };
    let mesh = Arc::new(sheet.mesh().unwrap());
    let sigma = spread(mesh.triangles().len(), 1e-3, 4.0);
    let forward = Forward::new(mesh, &sheet.contact_ohm_m()).unwrap();
    (forward, sigma, Protocol::sheffield(26).unwrap())
}

fn largest_difference(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    (a - b).amax() / b.amax()
}

#[test]
fn regions_cells_and_logarithms_follow_from_the_triangles() {
    let (forward, sigma, protocol) = sheet();
    let mesh = forward.mesh().clone();
    let whole = forward.jacobian(&sigma, &protocol).unwrap();
    let region = forward
        .sensitivity(&sigma, &protocol, &Parameters::region())
        .unwrap();
    assert_eq!(region, whole.select_columns(mesh.region()));
    let mut scaled = whole.clone();
    for (mut column, sigma) in scaled.column_iter_mut().zip(&sigma) {
        column *= *sigma;
    }
    let logarithmic = forward
        .sensitivity(&sigma, &protocol, &Parameters::elements().logarithmic())
        .unwrap();
    assert!(largest_difference(&logarithmic, &scaled) < 1e-15);

    let (cells, centres) = Parameters::grid(&mesh, 0.015);
    assert!(
        centres.len() > 100 && centres.len() < 200,
        "{}",
        centres.len()
    );
    for cells in [cells.clone(), cells.clone().logarithmic()] {
        let coarse = forward.sensitivity(&sigma, &protocol, &cells).unwrap();
        let sum: f64 = coarse.row(7).iter().sum();
        let fine = if cells == cells.clone().logarithmic() {
            &logarithmic
        } else {
            &whole
        };
        let all: f64 = mesh.region().iter().map(|&t| fine[(7, t)]).sum();
        assert!((sum / all - 1.0).abs() < 1e-12);
    }
    // a cell's derivative is the sum over its triangles
    let (one, _) = Parameters::grid(&mesh, 0.0);
    let derivative = forward.sensitivity(&sigma, &protocol, &one).unwrap();
    assert_eq!(derivative.ncols(), 1);
    let step = 1e-6;
    let moved = |by: f64| {
        let mut sigma = sigma.clone();
        mesh.region().iter().for_each(|&t| sigma[t] += by);
        forward.readings(&sigma, &protocol).unwrap()
    };
    let difference = (moved(step) - moved(-step)) / (2.0 * step);
    let error = (&difference - derivative.column(0)).amax() / difference.amax();
    assert!(error < 1e-5, "{error:e}");

    let other = PaperSheet {
        fineness: 0.3,
        ..PaperSheet::default()
    };
    let (cells, _) = Parameters::grid(&other.mesh().unwrap(), 0.015);
    assert!(matches!(
        forward.sensitivity(&sigma, &protocol, &cells),
        Err(ForwardError::Cells { .. })
    ));
}

/// Smallest error of a central difference over several relative steps: rounding limits small steps, curvature large
/// ones.
fn least_error(along: impl Fn(f64) -> DVector<f64>, at: f64, exact: &DVector<f64>) -> f64 {
    [1e-3, 3e-4, 1e-4]
        .map(|h| ((along(h) - along(-h)) / (2.0 * h * at) - exact).amax() / exact.amax())
        .into_iter()
        .fold(f64::INFINITY, f64::min)
}

/// Central differences of single entries, at the step where rounding and curvature are smallest.
#[test]
fn single_entries_are_central_differences() {
    let mesh = Arc::new(eight(0.5));
    let contacts = [0.5, 1e-3, 7.0, 40.0, 0.2, 1.0, 2.0, 300.0];
    let sigma = spread(mesh.triangles().len(), 1e-3, 10.0);
    let forward = Forward::new(mesh.clone(), &contacts).unwrap();
    for away in [0, 2] {
        let protocol = Protocol::new(8, skip(8, away).collect()).unwrap();
        let by_sigma = forward.jacobian(&sigma, &protocol).unwrap();
        let by_contact = forward.contact_jacobian(&sigma, &protocol).unwrap();
        let mut worst = 0.0_f64;
        for t in [0, 411, 1600, 2900] {
            let along = |h: f64| {
                let mut sigma = sigma.clone();
                sigma[t] *= 1.0 + h;
                forward.readings(&sigma, &protocol).unwrap()
            };
            worst = worst.max(least_error(
                along,
                sigma[t],
                &by_sigma.column(t).into_owned(),
            ));
        }
        for l in (0..8).filter(|&l| by_contact.column(l).amax() > 0.0) {
            let along = |h: f64| {
                let mut contacts = contacts;
                contacts[l] *= 1.0 + h;
                let forward = Forward::new(mesh.clone(), &contacts).unwrap();
                forward.readings(&sigma, &protocol).unwrap()
            };
            worst = worst.max(least_error(
                along,
                contacts[l],
                &by_contact.column(l).into_owned(),
            ));
        }
        println!("skip {away}: {worst:.1e}");
        assert!(worst < 1e-6, "skip {away}: {worst:e}");
    }
}

#[test]
fn a_sensitivity_has_the_same_bits_on_any_number_of_threads() {
    let (forward, sigma, protocol) = sheet();
    let on = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| forward.jacobian(&sigma, &protocol).unwrap())
    };
    let one = on(1);
    for threads in [2, 8] {
        let again = on(threads);
        assert!(
            one.iter()
                .zip(again.iter())
                .all(|(a, b)| a.to_bits() == b.to_bits())
        );
    }
}
