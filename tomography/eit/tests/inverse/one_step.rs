//! One-step reconstruction against solved cases, and its own invariants.

use std::sync::Arc;

use crate::solved::{column, mesh, readings};
use eit::{
    DiscTank, Forward, Hyper, OneStep, OneStepError, OneStepOptions, Prior, ReconstructError,
    Reconstructor, Scale,
};
use survey::{Protocol, Reading};

fn options(prior: Prior, lambda: f64) -> OneStepOptions {
    OneStepOptions {
        prior,
        hyper: Hyper::Lambda(lambda),
        scale: Scale::Currents(vec![1.0; 208]),
        ..OneStepOptions::default()
    }
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    let difference: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    let size: f64 = b.iter().map(|b| b * b).sum();
    (difference / size).sqrt()
}

const PRIORS: [(&str, Prior, f64); 3] = [
    ("tikhonov", Prior::Tikhonov, 1e-3),
    ("noser", Prior::Noser { p: 0.5 }, 3e-2),
    ("laplace", Prior::Laplace, 1e-3),
];

#[test]
fn the_solved_case_is_met_by_every_prior() {
    let case = needs::case("disc16");
    let (mesh, contact) = mesh(&case);
    let protocol = Protocol::sheffield(16).unwrap();
    let baseline = readings(&column(&case.join("v_exact_homog.csv")));
    let frame = readings(&column(&case.join("v_exact_one.csv")));
    for (name, prior, lambda) in PRIORS {
        let one_step = OneStep::new(
            Arc::clone(&mesh),
            &contact,
            &vec![1.0; 780],
            &protocol,
            options(prior, lambda),
        )
        .unwrap();
        let map = one_step.reconstruct(&baseline, &frame).unwrap();
        let solved = column(&case.join(format!("recon_{name}_one.csv")));
        let error = distance(&map.values, &solved);
        println!("{name}: {error:.1e}");
        assert!(error < 1e-11, "{name}: {error:e}");
    }
}

/// Masking a reading gives exactly the map of the protocol without it.
#[test]
fn masking_is_the_smaller_problem() {
    let case = needs::case("disc16");
    let (mesh, contact) = mesh(&case);
    let protocol = Protocol::sheffield(16).unwrap();
    let volts = [
        column(&case.join("v_exact_homog.csv")),
        column(&case.join("v_exact_one.csv")),
    ];
    let gone = [0, 7, 100, 101, 207];
    let kept: Vec<usize> = (0..208).filter(|i| !gone.contains(i)).collect();
    let fewer = Protocol::new(
        16,
        kept.iter().map(|&i| protocol.measurements()[i]).collect(),
    )
    .unwrap();
    let gaussian = Prior::Gaussian { length_m: 0.02 };
    for (name, prior, lambda) in PRIORS.into_iter().chain([("gaussian", gaussian, 1e-3)]) {
        if name == "noser" {
            continue; // its prior uses the whole protocol's sensitivity
        }
        for loss_only in [false, true] {
            let build = |protocol: &Protocol| {
                OneStep::new(
                    Arc::clone(&mesh),
                    &contact,
                    &vec![1.0; 780],
                    protocol,
                    OneStepOptions {
                        scale: Scale::Currents(vec![1.0; protocol.len()]),
                        loss_only,
                        ..options(prior, lambda)
                    },
                )
                .unwrap()
            };
            let mut masked = volts.clone().map(|volts| readings(&volts));
            for (i, &reading) in gone.iter().enumerate() {
                masked[i % 2][reading] = [Reading::Overload, Reading::NotMeasured][i % 2];
            }
            let map = build(&protocol)
                .reconstruct(&masked[0], &masked[1])
                .unwrap();
            let short = volts
                .clone()
                .map(|volts| kept.iter().map(|&i| volts[i]).collect::<Vec<_>>());
            let small = build(&fewer)
                .reconstruct(&readings(&short[0]), &readings(&short[1]))
                .unwrap();
            assert_eq!(map.masked, gone.len());
            let error = distance(&map.values, &small.values);
            let bound = if loss_only { 1e-6 } else { 1e-9 };
            assert!(error < bound, "{name}, loss only {loss_only}: {error:e}");
        }
    }
}

#[test]
fn more_than_half_missing_makes_no_map() {
    let case = needs::case("disc16");
    let (mesh, contact) = mesh(&case);
    let protocol = Protocol::sheffield(16).unwrap();
    let one_step = OneStep::new(
        mesh,
        &contact,
        &vec![1.0; 780],
        &protocol,
        options(Prior::default(), 0.03),
    )
    .unwrap();
    let baseline = readings(&column(&case.join("v_exact_homog.csv")));
    let mut frame = baseline.clone();
    frame[..105].fill(Reading::Overload);
    assert!(matches!(
        one_step.reconstruct(&baseline, &frame),
        Err(ReconstructError::TooManyMissing {
            missing: 105,
            readings: 208,
            ..
        })
    ));
    frame[104] = baseline[104];
    assert_eq!(one_step.reconstruct(&baseline, &frame).unwrap().masked, 104);
    assert!(matches!(
        one_step.reconstruct(&baseline[1..], &frame),
        Err(ReconstructError::Length {
            what: "baseline",
            has: 207,
            wants: 208,
            ..
        })
    ));
}

#[test]
fn a_map_does_not_depend_on_current_or_resistance() {
    let case = needs::case("disc16");
    let (mesh, contact) = mesh(&case);
    let protocol = Protocol::sheffield(16).unwrap();
    let one_step = OneStep::new(
        mesh,
        &contact,
        &vec![1.0; 780],
        &protocol,
        OneStepOptions {
            scale: Scale::Uniform,
            ..options(Prior::default(), 0.03)
        },
    )
    .unwrap();
    let volts = [
        column(&case.join("v_exact_homog.csv")),
        column(&case.join("v_exact_one.csv")),
    ];
    let map_at = |factor: f64| {
        let scaled = volts
            .clone()
            .map(|volts| readings(&volts.iter().map(|v| factor * v).collect::<Vec<_>>()));
        one_step.reconstruct(&scaled[0], &scaled[1])
    };
    let one = map_at(1.0).unwrap();
    assert!(distance(&map_at(1e-6).unwrap().values, &one.values) < 1e-12);
    let refusal = map_at(-1.0).unwrap_err();
    assert!(
        matches!(refusal, ReconstructError::OppositeSign),
        "{refusal}"
    );
}

#[test]
fn settings_without_meaning_are_refused_by_name() {
    let case = needs::case("disc16");
    let (mesh, contact) = mesh(&case);
    let protocol = Protocol::sheffield(16).unwrap();
    let build = |options| {
        OneStep::new(
            Arc::clone(&mesh),
            &contact,
            &vec![1.0; 780],
            &protocol,
            options,
        )
        .map(|_| ())
    };
    for lambda in [0.0, -1.0, f64::NAN, 1e-12] {
        assert!(matches!(
            build(options(Prior::Tikhonov, lambda)),
            Err(OneStepError::Lambda { .. })
        ));
    }
    assert!(matches!(
        build(OneStepOptions {
            hyper: Hyper::Noise {
                volts: 0.0,
                current: 1.0
            },
            ..OneStepOptions::default()
        }),
        Err(OneStepError::NotPositive { what: "noise", .. })
    ));
    assert!(matches!(
        build(options(Prior::Gaussian { length_m: f64::NAN }, 1e-3)),
        Err(OneStepError::NotPositive { .. })
    ));
    assert!(matches!(
        build(OneStepOptions {
            hyper: Hyper::NoiseFigure(1e9),
            ..OneStepOptions::default()
        }),
        Err(OneStepError::NoiseFigure { .. })
    ));
    assert!(matches!(
        build(OneStepOptions {
            map_error: Some(0.0),
            ..OneStepOptions::default()
        }),
        Err(OneStepError::MapError { .. })
    ));
    assert!(matches!(
        build(OneStepOptions {
            deviations: Some(vec![1.0; 3]),
            ..OneStepOptions::default()
        }),
        Err(OneStepError::Count { has: 3, .. })
    ));
}

/// More smoothing averages more noise away; novelty separates unexplained changes from explained ones.
#[test]
fn noise_figure_and_novelty_follow_their_definitions() {
    let tank = DiscTank {
        fineness: 0.6,
        ..DiscTank::default()
    };
    let mesh = Arc::new(tank.mesh().unwrap());
    let protocol = Protocol::sheffield(16).unwrap();
    let sigma0 = vec![tank.conductance(); mesh.triangles().len()];
    let contact = tank.contact_ohm_m();
    let prepare = |volts| {
        let options = OneStepOptions {
            hyper: Hyper::Noise {
                volts,
                current: 1e-3,
            },
            ..OneStepOptions::default()
        };
        OneStep::new(Arc::clone(&mesh), &contact, &sigma0, &protocol, options).unwrap()
    };
    let (sharp, smooth) = (prepare(1e-6), prepare(1e-4));
    let [sharp_figure, smooth_figure] = [&sharp, &smooth].map(|one| one.noise_figure().unwrap());
    println!("noise figures {sharp_figure:.3} and {smooth_figure:.3}");
    assert!(sharp_figure > 2.0 * smooth_figure && smooth_figure > 0.0);
    assert!(
        sharp
            .assumptions()
            .iter()
            .any(|reported| reported.contains("1.00e-3")),
        "{:?}",
        sharp.assumptions()
    );

    let forward = Forward::new(Arc::clone(&mesh), &contact).unwrap();
    let mut sigma = sigma0.clone();
    sigma[n_in_the_middle(&mesh)] *= 0.5;
    let volts = |sigma: &[f64]| forward.readings(sigma, &protocol).unwrap() * 1e-3;
    let (before, mut after) = (volts(&sigma0), volts(&sigma));
    let baseline = readings(before.as_slice());
    let known = sharp
        .novelty(&baseline, &readings(after.as_slice()))
        .unwrap()
        .unwrap();
    after[5] += 1e-3;
    let new = sharp
        .novelty(&baseline, &readings(after.as_slice()))
        .unwrap()
        .unwrap();
    assert!(!known.outside() && new.outside(), "{known:?} {new:?}");
}

fn n_in_the_middle(mesh: &eit::Mesh) -> usize {
    let away = |t: &usize| {
        let [x, y] = mesh.centroid(*t);
        x.hypot(y)
    };
    (0..mesh.triangles().len())
        .min_by(|a, b| away(a).total_cmp(&away(b)))
        .unwrap()
}
