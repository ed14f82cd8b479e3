//! Positions of loads that are not discs: three discs in a row, with the centre of the middle one. Readings are from a
//! finer mesh.

use std::sync::Arc;

use drift::{DiscFit, Whitened};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use survey::{Reading, Volts};

use crate::sheet::{Fine, Sheet};

const LOADS: usize = 40;
/// Square root of the 95 % quantile of chi squared with two degrees of freedom, and of one.
const REGION: f64 = 2.448;
const INTERVAL: f64 = 1.96;

/// Whether the 95 % ellipse of a fit contains the true centre, and the error of its centre, mm.
fn judged(fit: &DiscFit, centre: [f64; 2]) -> (bool, f64) {
    let [x, y] = [0, 1].map(|axis| fit.disc.centre[axis] - centre[axis]);
    let [[xx, xy], [_, yy]] = fit.covariance;
    let square = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy);
    (square < REGION * REGION, 1e3 * x.hypot(y))
}

#[test]
fn place_of_an_oblong_load_has_an_error_that_holds() {
    let fine = Fine::of(1.5);
    let empty = fine.volts(|_| 1.0);
    let of = |volts: &[f64]| volts.iter().map(|v| Reading::Ok(Volts(*v))).collect();
    let model = Arc::new(Sheet::of(of(&empty)).model_on(1.0, 2e-6));
    let mut random = ChaCha8Rng::seed_from_u64(33);
    let (mut of_disc, mut of_place, mut loads) = (Vec::new(), Vec::new(), 0);
    for _ in 0..LOADS {
        let centre = [0, 1].map(|_| random.random_range(0.04..0.17));
        let angle: f64 = random.random_range(0.0..std::f64::consts::PI);
        let radius = random.random_range(4e-3..12e-3);
        let apart = radius * random.random_range(0.5..1.2);
        let lost = random.random_range(0.1..0.6);
        let ends = [-apart, apart].map(|along| {
            [
                centre[0] + along * angle.cos(),
                centre[1] + along * angle.sin(),
            ]
        });
        let volts = fine.volts(|share| {
            let covered = [centre, ends[0], ends[1]].map(|at| share(at, radius));
            1.0 - lost * covered.iter().sum::<f64>().min(1.0)
        });
        let noisy: Vec<f64> = volts
            .iter()
            .map(|volts| {
                let normal: f64 = StandardNormal.sample(&mut random);
                volts + 2e-6 * normal
            })
            .collect();
        let relative = model.relative(&of(&noisy)).unwrap();
        let errors = model.noise() * 2.0;
        let white = Whitened::new(&errors, &relative.data, &relative.rows).unwrap();
        let disc = white.fit_disc(&model).unwrap();
        let place = white.fit_place(&model, &disc).unwrap();
        of_disc.push(judged(&disc, centre));
        of_place.push(judged(&place, centre));
        // lower bound of the area of the row of discs; `twice` bounds the overlap of its two ends
        let segment = |half: f64| {
            let angle = 2.0 * (half / radius).min(1.0).acos();
            radius * radius * (angle - angle.sin())
        };
        let disc_area = std::f64::consts::PI * radius * radius;
        let area = 3.0 * disc_area - 2.0 * segment(0.5 * apart);
        let twice = segment(apart); // of the two ends with each other
        let linear = 2.0 * lost / (2.0 - lost);
        let stated = std::f64::consts::FRAC_PI_4 * place.load / linear;
        let error = INTERVAL * place.load_sd * stated;
        loads += usize::from((area - error..=area + twice + error).contains(&stated));
    }
    let holds = |of: &[(bool, f64)]| of.iter().filter(|(holds, _)| *holds).count();
    let middle = |of: &[(bool, f64)]| {
        let mut errors: Vec<f64> = of.iter().map(|(_, error)| *error).collect();
        errors.sort_by(f64::total_cmp);
        errors[LOADS / 2]
    };
    println!(
        "disc: {} of {LOADS} hold, median {:.2} mm; place: {} hold, median {:.2} mm, {loads} loads",
        holds(&of_disc),
        middle(&of_disc),
        holds(&of_place),
        middle(&of_place)
    );
    assert!(10 * holds(&of_place) >= 9 * LOADS);
    assert!(10 * loads >= 9 * LOADS);
    // the regions of disc fits contain the centre too rarely
    assert!(4 * holds(&of_disc) < 3 * LOADS);
    assert!(middle(&of_place) < middle(&of_disc));
}
