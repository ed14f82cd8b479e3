//! Total variation compared with a solved case, and its stated properties.

use std::sync::Arc;

use crate::solved::{column, mesh, readings};
use eit::{
    DiscTank, Forward, Mesh, ReconstructError, Reconstructor, Scale, Strength, Tv, TvError,
    TvOptions,
};
use survey::{Protocol, Reading, Volts};

/// Compared with the minimum of an offline interior method: by objective, because the minimiser may not be unique.
#[test]
fn the_solved_case_is_met() {
    let case = needs::case("disc16");
    let (mesh, contact) = mesh(&case);
    let baseline = readings(&column(&case.join("v_exact_homog.csv")));
    let frame = readings(&column(&case.join("v_exact_one.csv")));
    let protocol = Protocol::sheffield(16).unwrap();
    let sigma0 = column(&case.join("sigma_homog.csv"));
    for (alpha, least) in [(1e-5, 1.1788770449e-6), (1e-6, 1.2140501327e-7)] {
        let options = TvOptions {
            strength: Strength::Alpha(alpha),
            scale: Scale::Currents(vec![1.0; 208]),
            gap: 1e-7,
            ..TvOptions::default()
        };
        let tv = Tv::new(Arc::clone(&mesh), &contact, &sigma0, &protocol, options).unwrap();
        let (solution, _) = tv.solve(&baseline, &frame).unwrap();
        let own = tv.objective(&baseline, &frame, &solution.values).unwrap();
        println!(
            "alpha {alpha:e}: {own:.10e} ({:e} above the solved case), stated gap {:e}, {} rounds, {} regions",
            own / least - 1.0,
            solution.gap / own,
            solution.rounds,
            solution.regions
        );
        assert!(
            (own / least - 1.0).abs() <= 1e-7,
            "{own:e} instead of {least:e}"
        );
        assert!(solution.gap <= 1e-7 * own);
    }
    let optimal = column(&case.join("recon_tv_one_a1e-05_optimal.csv"));
    let options = TvOptions {
        strength: Strength::Alpha(1e-5),
        scale: Scale::Currents(vec![1.0; 208]),
        ..TvOptions::default()
    };
    let tv = Tv::new(mesh, &contact, &sigma0, &protocol, options).unwrap();
    let theirs = tv.objective(&baseline, &frame, &optimal).unwrap();
    assert!((theirs / 1.1788770449e-6 - 1.0).abs() <= 1e-8, "{theirs:e}");
}

struct Tank {
    mesh: Arc<Mesh>,
    contact: Vec<f64>,
    sigma0: Vec<f64>,
    protocol: Protocol,
    baseline: Vec<Reading>,
    frame: Vec<Reading>,
}

/// A tank of 16 electrodes in which one corner has lost half of its conductance.
fn tank() -> Tank {
    let preset = DiscTank {
        fineness: 0.7,
        ..DiscTank::default()
    };
    let mesh = Arc::new(preset.mesh().unwrap());
    let contact = preset.contact_ohm_m();
    let protocol = Protocol::sheffield(16).unwrap();
    let forward = Forward::new(Arc::clone(&mesh), &contact).unwrap();
    let sigma0 = vec![preset.conductance(); mesh.triangles().len()];
    let radius = preset.radius_mm * 1e-3;
    let sigma1: Vec<f64> = (0..sigma0.len())
        .map(|t| {
            let [x, y] = mesh.centroid(t);
            let inside = (x - 0.4 * radius).hypot(y) < 0.2 * radius;
            sigma0[t] * if inside { 0.5 } else { 1.0 }
        })
        .collect();
    let volts = |sigma: &[f64]| {
        let volts = forward.readings(sigma, &protocol).unwrap() * 1e-3;
        readings(volts.as_slice())
    };
    Tank {
        baseline: volts(&sigma0),
        frame: volts(&sigma1),
        mesh,
        contact,
        sigma0,
        protocol,
    }
}

impl Tank {
    fn tv(&self, options: TvOptions) -> Result<Tv, TvError> {
        Tv::new(
            Arc::clone(&self.mesh),
            &self.contact,
            &self.sigma0,
            &self.protocol,
            options,
        )
    }
}

#[test]
fn bounds_are_kept_and_cost_what_they_must() {
    let tank = tank();
    let solve = |loss_only| {
        let tv = tank
            .tv(TvOptions {
                loss_only,
                gap: 1e-6,
                ..TvOptions::default()
            })
            .unwrap();
        tv.solve(&tank.baseline, &tank.frame).unwrap().0
    };
    let (free, bounded) = (solve(false), solve(true));
    assert!(bounded.values.iter().all(|x| (-1.0..=0.0).contains(x)));
    assert!(
        free.values.iter().any(|x| *x > 1e-3),
        "the bound would do nothing here"
    );
    assert!(free.objective <= bounded.objective * (1.0 + 1e-6));
    assert!(bounded.gap <= 1e-6 * bounded.objective && free.gap <= 1e-6 * free.objective);
}

#[test]
fn tv_map_has_the_same_bits_whatever_frames_came_before() {
    let tank = tank();
    let [alone, sequence] = [(); 2].map(|()| tank.tv(TvOptions::default()).unwrap());
    let halved: Vec<Reading> = std::iter::zip(&tank.baseline, &tank.frame)
        .map(|(before, now)| match (before.volts(), now.volts()) {
            (Some(before), Some(now)) => Reading::Ok(Volts(0.5 * (before.0 + now.0))),
            _ => *now,
        })
        .collect();
    for frame in [&tank.frame, &halved, &tank.baseline] {
        sequence.solve(&tank.baseline, frame).unwrap();
    }
    assert_eq!(
        alone.solve(&tank.baseline, &tank.frame).unwrap(),
        sequence.solve(&tank.baseline, &tank.frame).unwrap()
    );
}

#[test]
fn missing_readings_are_left_out_and_too_many_are_refused() {
    let tank = tank();
    let tv = tank
        .tv(TvOptions {
            loss_only: true,
            ..TvOptions::default()
        })
        .unwrap();
    let whole = tv.reconstruct(&tank.baseline, &tank.frame).unwrap();
    let mut frame = tank.frame.clone();
    frame[17] = Reading::Ok(Volts(f64::NAN));
    frame[40] = Reading::NotMeasured;
    let masked = tv.reconstruct(&tank.baseline, &frame).unwrap();
    assert_eq!((whole.masked, masked.masked), (0, 2));
    let apart: f64 = whole
        .values
        .iter()
        .zip(&masked.values)
        .map(|(a, b)| (a - b).abs())
        .sum();
    let size: f64 = whole.values.iter().map(|a| a.abs()).sum();
    assert!(apart < 0.2 * size, "{apart} of {size}");
    for reading in &mut frame[..110] {
        *reading = Reading::NotMeasured;
    }
    assert!(matches!(
        tv.reconstruct(&tank.baseline, &frame),
        Err(ReconstructError::TooManyMissing { .. })
    ));
}

#[test]
fn a_frame_that_no_map_explains_is_new() {
    let tank = tank();
    let tv = tank.tv(TvOptions::default()).unwrap();
    let known = tv.novelty(&tank.baseline, &tank.frame).unwrap().unwrap();
    assert!(!known.outside(), "{known:?}");
    let mut frame = tank.frame.clone();
    // reciprocal twins that differ by a millivolt: no conductance causes that
    frame[5] = Reading::Ok(Volts(frame[5].volts().unwrap().0 + 1e-3));
    let new = tv.novelty(&tank.baseline, &frame).unwrap().unwrap();
    assert!(new.outside(), "{new:?}");
}

#[test]
fn settings_that_are_no_positive_numbers_are_refused() {
    let tank = tank();
    for wrong in [
        TvOptions {
            noise_v: Some(f64::NAN),
            ..TvOptions::default()
        },
        TvOptions {
            current_a: 0.0,
            ..TvOptions::default()
        },
        TvOptions {
            gap: -1e-3,
            ..TvOptions::default()
        },
        TvOptions {
            strength: Strength::Alpha(0.0),
            ..TvOptions::default()
        },
        TvOptions {
            strength: Strength::Relative(f64::INFINITY),
            ..TvOptions::default()
        },
    ] {
        assert!(matches!(tank.tv(wrong), Err(TvError::NotPositive { .. })));
    }
}
