//! Sheet fit and single frames, with data from a mesh that is finer than the model's.

use drift::{DriftModel, Whitened};
use nalgebra::DVector;
use survey::Reading;

use crate::sheet::Sheet;

fn readings(contacts: impl Fn(usize) -> f64, sigma: impl Fn([f64; 2]) -> f64) -> Vec<Reading> {
    Sheet::new().readings(contacts, sigma)
}

fn model(baseline: &[Reading]) -> DriftModel {
    Sheet::of(baseline.to_vec()).model()
}

fn spread(electrode: usize) -> f64 {
    (0.3 * (electrode as f64 * 2.3).sin()).exp()
}

fn sprayed([x, y]: [f64; 2]) -> f64 {
    1.1 * (0.1 * (40.0 * x).sin() * (30.0 * y).cos()).exp()
}

#[test]
fn uneven_sheet_is_fitted_to_its_baseline() {
    let baseline = readings(spread, sprayed);
    let model = model(&baseline);
    let fit = model.fit();
    assert!(
        fit.misfit < 0.1 * fit.nominal_misfit,
        "{} {}",
        fit.misfit,
        fit.nominal_misfit
    );
    assert!((0.03..0.08).contains(&fit.unevenness), "{}", fit.unevenness);
    assert!((fit.gain * 1.1 - 1.0).abs() < 0.02, "{}", fit.gain);
    assert_eq!(fit.implausible, [0; 0]);
    let even = self::model(&readings(|_| 1.0, |_| 1.0));
    assert!(even.fit().unevenness < 0.02, "{}", even.fit().unevenness);
}

#[test]
fn contact_of_thirty_times_its_resistance_is_named() {
    let far = |electrode: usize| if electrode == 7 { 30.0 } else { 1.0 };
    let model = model(&readings(far, |_| 1.0));
    assert_eq!(model.fit().implausible, [7], "{:?}", model.fit().contacts);
}

#[test]
fn press_is_found_through_drift_with_an_error_that_holds() {
    let baseline = readings(spread, sprayed);
    let model = model(&baseline);
    let drifted = |electrode: usize| spread(electrode) * (1.0 + 0.1 * (electrode as f64).cos());
    let place = [0.080, 0.140];
    let frame = readings(drifted, |at| {
        let inside = (at[0] - place[0]).hypot(at[1] - place[1]) < 15e-3;
        0.97 * sprayed(at) * if inside { 0.5 } else { 1.0 }
    });
    let relative = model.relative(&frame).unwrap();
    assert_eq!(relative.rows.len(), 299);
    let assessed = model.assess(&relative.data, &relative.rows).unwrap();
    assert!(assessed.score > 1000.0);
    assert!(
        (0.03..0.25).contains(&assessed.sizes.contact),
        "{:?}",
        assessed.sizes
    );
    let fit = assessed.whitened.fit_disc(&model).unwrap();
    let off = (fit.disc.centre[0] - place[0]).hypot(fit.disc.centre[1] - place[1]);
    let sd = fit.covariance[0][0].max(fit.covariance[1][1]).sqrt();
    assert!(off < 0.6e-3 && off < 3.5 * sd, "{off} {sd} {fit:?}");
    assert!((fit.disc.diameter - 30e-3).abs() < 6e-3, "{fit:?}");
    let map = assessed.whitened.one_step(&model, 0.05).unwrap();
    let least = (0..map.len())
        .min_by(|a, b| map[*a].total_cmp(&map[*b]))
        .unwrap();
    let at = model.mesh().centroid(least);
    assert!((at[0] - place[0]).hypot(at[1] - place[1]) < 15e-3);
    assert!(map[least] < -0.1);
}

#[test]
fn empty_frame_with_drift_has_no_load() {
    let baseline = readings(spread, |_| 1.0);
    let model = model(&baseline);
    let frame = readings(|e| spread(e) * (1.0 + 0.1 * (e as f64).sin()), |_| 0.95);
    let relative = model.relative(&frame).unwrap();
    let assessed = model.assess(&relative.data, &relative.rows).unwrap();
    assert!(assessed.score < 45.0, "{}", assessed.score);
}

/// Root mean square over the pairs, V.
fn rms(data: &DVector<f64>) -> f64 {
    (data.norm_squared() / data.len() as f64).sqrt()
}

#[test]
fn drift_of_one_frame_is_separated_from_its_load() {
    let baseline = readings(spread, |_| 1.0);
    let model = model(&baseline);
    let drifted = |electrode: usize| spread(electrode) * (1.0 + 0.1 * (electrode as f64).cos());
    let disc = |[x, y]: [f64; 2]| (x - 0.080).hypot(y - 0.140) < 15e-3;
    let bar = |[x, y]: [f64; 2]| (0.05..0.12).contains(&x) && (0.10..0.13).contains(&y);
    let nothing = |_: [f64; 2]| false;
    let frame = |load: &dyn Fn([f64; 2]) -> bool| {
        let frame = readings(drifted, |at| 0.97 * if load(at) { 0.5 } else { 1.0 });
        model.relative(&frame).unwrap()
    };
    let truth = frame(&nothing).data;
    for (load, is_disc, share) in [
        (&disc as &dyn Fn([f64; 2]) -> bool, true, 0.05),
        (&bar, false, 0.05),
        (&nothing, true, 0.02),
    ] {
        let relative = frame(load);
        let drift = model.frame_drift(&relative.data, &relative.rows).unwrap();
        let left = rms(&(&drift.change - &truth)) / rms(&truth);
        println!("{left} {}", drift.is_disc);
        assert!(left < share, "{left}");
        if rms(&(&relative.data - &truth)) > 0.0 {
            assert_eq!(drift.is_disc, is_disc);
        }
    }
}

#[test]
fn deviation_of_a_map_grows_with_noise_and_lost_rows() {
    let model = model(&readings(|_| 1.0, |_| 1.0));
    let drift = drift::FrameDrift {
        sizes: drift::Sizes {
            gain: 0.1,
            contact: 0.1,
            field: 1e-3,
            local: 0.1,
        },
        change: nalgebra::DVector::zeros(299),
        is_disc: true,
        load: 0.1,
    };
    let mesh = model.mesh();
    let nearest = |place: [f64; 2]| {
        let away = |triangle: &usize| {
            let at = mesh.centroid(*triangle);
            (at[0] - place[0]).hypot(at[1] - place[1])
        };
        (0..mesh.triangles().len())
            .min_by(|a, b| away(a).total_cmp(&away(b)))
            .unwrap()
    };
    let (middle, edge) = (nearest([0.107, 0.115]), nearest([0.030, 0.115]));
    let all: Vec<usize> = (0..299).collect();
    let whole = model.map_deviation(&drift, &all).unwrap();
    // the deviation is smaller near the electrodes, and nowhere larger than before the frame
    assert!(whole.deviation[edge] < 0.8 * whole.deviation[middle]);
    assert!(whole.deviation.iter().all(|sd| (0.0..=0.1).contains(sd)));
    let half: Vec<usize> = (0..150).collect();
    let fewer = model.map_deviation(&drift, &half).unwrap();
    let resolved = |deviation: &drift::MapDeviation| {
        deviation
            .resolved
            .iter()
            .filter(|resolved| **resolved)
            .count()
    };
    assert!(
        resolved(&fewer) < resolved(&whole),
        "{} {}",
        resolved(&fewer),
        resolved(&whole)
    );
    assert!(
        whole
            .deviation
            .iter()
            .zip(&fewer.deviation)
            .all(|(a, b)| *a <= b + 1e-9)
    );
}

#[test]
fn rows_of_drift_have_its_covariance() {
    let baseline = readings(spread, |_| 1.0);
    let model = model(&baseline);
    let rows = model.drift_rows(&drift::Sizes::MONTHS, 0.0).unwrap();
    let data: Vec<DVector<f64>> = rows
        .iter()
        .map(|row| {
            let volts = row.iter().zip(&baseline);
            let frame: Vec<Reading> = volts
                .map(|(change, before)| {
                    Reading::Ok(survey::Volts(before.volts().unwrap().0 + change))
                })
                .collect();
            model.relative(&frame).unwrap().data
        })
        .collect();
    let rows = nalgebra::DMatrix::from_columns(&data);
    let wants = model.drift(&drift::Sizes::MONTHS);
    assert!((&rows * rows.transpose() - &wants).amax() < 1e-6 * wants.amax());
    let fewer = model.drift_rows(&drift::Sizes::MONTHS, 1e-6).unwrap();
    assert!((27..150).contains(&fewer.len()), "{}", fewer.len());
}

#[test]
fn whitening_undoes_the_covariance_and_drops_rows() {
    let baseline = readings(|_| 1.0, |_| 1.0);
    let model = model(&baseline);
    let sizes = drift::Sizes {
        gain: 0.1,
        contact: 0.1,
        field: 1e-3,
        local: 0.0,
    };
    let covariance = model.noise() + model.drift(&sizes);
    let data = DVector::from_fn(299, |k, _| 1e-5 * (k as f64).sin());
    let all: Vec<usize> = (0..299).collect();
    let white = Whitened::new(&covariance, &data, &all).unwrap();
    let identity = white.sensitivity(&covariance);
    // L^-1 S = L': squared columns give the covariance again
    let again = identity.tr_mul(&identity);
    assert!((again - &covariance).amax() < 1e-9 * covariance.amax());
    let rows: Vec<usize> = (0..299).filter(|row| row % 10 != 0).collect();
    let fewer = Whitened::new(&covariance, &data, &rows).unwrap();
    assert_eq!(fewer.data().len(), rows.len());
    let inside = covariance.select_rows(&rows).select_columns(&rows);
    let direct = inside.cholesky().unwrap().solve(&data.select_rows(&rows));
    let chi = direct.dot(&data.select_rows(&rows));
    assert!((fewer.data().norm_squared() - chi).abs() < 1e-6 * chi);
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let baseline = readings(spread, |_| 1.0);
    let frame = readings(spread, |at| if at[0] < 0.05 { 0.9 } else { 1.0 });
    let bits = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let model = model(&baseline);
            let relative = model.relative(&frame).unwrap();
            let assessed = model.assess(&relative.data, &relative.rows).unwrap();
            let fit = assessed.whitened.fit_disc(&model).unwrap();
            [fit.disc.centre[0], fit.load, assessed.score].map(f64::to_bits)
        })
    };
    let one = bits(1);
    assert_eq!((one, one), (bits(2), bits(8)));
}
