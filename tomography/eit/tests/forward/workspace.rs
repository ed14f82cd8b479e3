//! Many conductances on one mesh: the same bits as one at a time, in any order and on any number of threads.

use std::sync::Arc;

use crate::parts::{eight, spread};
use eit::{DiscTank, Forward, ForwardError, PaperSheet};
use nalgebra::DVector;
use rayon::prelude::*;
use survey::{Protocol, skip};

fn same_bits(a: &DVector<f64>, b: &DVector<f64>) -> bool {
    a.len() == b.len()
        && a.iter()
            .zip(b.iter())
            .all(|(a, b)| a.to_bits() == b.to_bits())
}

/// Conductances that differ from `sigma0` in a patch, nowhere, or everywhere.
fn changes(forward: &Forward, sigma0: &[f64]) -> Vec<Vec<f64>> {
    let mesh = forward.mesh();
    let patch = |k: usize| {
        let centre = mesh.centroid(k * 37 % mesh.triangles().len());
        (0..mesh.triangles().len())
            .map(|t| {
                let p = mesh.centroid(t);
                let near = (p[0] - centre[0]).hypot(p[1] - centre[1]) < 0.02;
                sigma0[t] * if near { 0.1 * (k % 10) as f64 } else { 1.0 }
            })
            .collect()
    };
    let mut all: Vec<Vec<f64>> = (0..10).map(patch).collect();
    all.push(sigma0.to_vec());
    all.push(spread(sigma0.len(), 1e-3, 20.0));
    all
}

#[test]
fn neither_history_nor_base_nor_threads_change_a_bit() {
    let tank = DiscTank::default();
    let mesh = Arc::new(tank.mesh().unwrap());
    let forward = Forward::new(mesh.clone(), &tank.contact_ohm_m()).unwrap();
    let protocol = Protocol::sheffield(16).unwrap();
    let sigma0 = vec![1e-3; mesh.triangles().len()];
    let sigmas = changes(&forward, &sigma0);
    let start = || forward.workspace(&protocol).unwrap();
    for plain in [false, true] {
        let start = || if plain { start().plain() } else { start() };
        let alone: Vec<DVector<f64>> = sigmas
            .iter()
            .map(|sigma| start().readings(sigma).unwrap())
            .collect();
        if !plain {
            let direct = forward.readings(&sigmas[3], &protocol).unwrap();
            assert!(same_bits(&direct, &alone[3]));
        }
        let mut about = start().about(&sigma0).unwrap();
        for order in [1_usize, 5, 7] {
            for k in 0..sigmas.len() {
                let k = k * order % sigmas.len();
                let again = about.readings(&sigmas[k]).unwrap();
                assert!(same_bits(&again, &alone[k]), "plain {plain}, case {k}");
            }
        }
        for threads in [1, 2, 8] {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let found: Vec<DVector<f64>> = pool.install(|| {
                sigmas
                    .par_iter()
                    .map_init(
                        || about.clone(),
                        |workspace, sigma| workspace.readings(sigma).unwrap(),
                    )
                    .collect()
            });
            assert!(found.iter().zip(&alone).all(|(a, b)| same_bits(a, b)));
        }
    }
}

/// Unrefined readings depend on the factor alone: 13 digits of the largest for any contact.
#[test]
fn plain_readings_are_close_to_refined_ones() {
    let sheet = PaperSheet {
        fineness: 0.5,
        ..PaperSheet::default()
    };
    let mesh = Arc::new(sheet.mesh().unwrap());
    let protocol = Protocol::sheffield(26).unwrap();
    for z in [0.0, 1e-9, 1e-4, 2.4, 10.0, 30.0, 1e4] {
        let forward = Forward::new(mesh.clone(), &[z; 26]).unwrap();
        let sigma = spread(mesh.triangles().len(), 1e-3, 10.0);
        let mut refined = forward.workspace(&protocol).unwrap();
        let exact = refined.readings(&sigma).unwrap();
        let found = refined.plain().readings(&sigma).unwrap();
        let error = (&found - &exact).amax() / exact.amax();
        println!("z {z:e}: {error:.1e}");
        assert!(error < 1e-12, "z {z:e}: {error:e}");
    }
}

/// The fields of other pairs are sums of those of neighbouring pairs, the shorter way round; with contacts of both
/// forms.
#[test]
fn readings_of_any_pairs_are_those_of_the_fields() {
    let mesh = Arc::new(eight(0.5));
    let contacts = [0.0, 1e-9, 1.0, 5.0, 19.0, 25.0, 1e3, 1e6];
    let forward = Forward::new(mesh.clone(), &contacts).unwrap();
    let sigma = spread(mesh.triangles().len(), 1e-3, 10.0);
    for away in 0..4 {
        let protocol = Protocol::new(8, skip(8, away).collect()).unwrap();
        let readings = forward.readings(&sigma, &protocol).unwrap();
        let plain = forward.workspace(&protocol).unwrap().plain();
        let plain = plain.clone().readings(&sigma).unwrap();
        for (k, question) in protocol.measurements().iter().enumerate() {
            let fields = forward.solve(&sigma, &[question.drive]).unwrap();
            let volts = fields.electrodes[(question.sense.plus.0, 0)]
                - fields.electrodes[(question.sense.minus.0, 0)];
            for found in [readings[k], plain[k]] {
                let error = (found - volts).abs() / readings.amax();
                // the gauge of the fields includes the drops over contacts of 5e7 ohm
                assert!(error < 1e-7, "skip {away}, reading {k}: {error:e}");
            }
        }
    }
}

#[test]
fn what_cannot_be_solved_is_refused_and_the_workspace_goes_on() {
    let mesh = Arc::new(eight(0.0));
    let forward = Forward::new(mesh.clone(), &[1.0; 8]).unwrap();
    let protocol = Protocol::sheffield(8).unwrap();
    let sigma = vec![1e-3; mesh.triangles().len()];
    let mut workspace = forward.workspace(&protocol).unwrap();
    let before = workspace.readings(&sigma).unwrap();
    let mut bad = sigma.clone();
    bad[3] = f64::NAN;
    assert!(matches!(
        workspace.readings(&bad),
        Err(ForwardError::Sigma { element: 3, .. })
    ));
    assert!(same_bits(&workspace.readings(&sigma).unwrap(), &before));
    assert!(matches!(
        forward.workspace(&Protocol::sheffield(9).unwrap()),
        Err(ForwardError::Ring { .. })
    ));
    assert!(workspace.about(&bad).is_err());
}
