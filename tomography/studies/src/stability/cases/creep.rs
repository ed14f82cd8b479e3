//! Hard case 40: a viscoelastic step of any length.

use phantom::PronyStep;

use crate::failure::Failure;
use crate::stability::outcome::{Check, Naive, Outcome, worst};

const SHARE: f64 = 0.4;

/// x - (1 - exp(-x)); for small x by its series, to avoid cancellation.
fn lag(x: f64) -> f64 {
    if x > 0.1 {
        return x + (-x).exp_m1();
    }
    let (mut term, mut sum) = (0.5 * x * x, 0.0);
    for n in 3..14 {
        sum += term;
        term *= -x / f64::from(n);
    }
    sum
}

/// 40: the input rises to 1 within x time constants and is constant for x more, x from 1e-9 to 1e9.
pub(crate) fn any_step() -> Result<Outcome, Failure> {
    let (mut ours, mut euler, mut careless) = (0.0, 0.0, 0.0);
    for exponent in -9..=9 {
        let x = 10f64.powi(exponent);
        let risen = SHARE * (1.0 - lag(x) / x);
        let rested = risen * (-x).exp();
        let term = PronyStep::new(SHARE, x);
        let first = term.held(0.0, 1.0);
        ours = worst(ours, (first - risen).abs());
        ours = worst(ours, (term.held(first, 0.0) - rested).abs());
        // explicit Euler scheme of h' = -h / tau + g e'
        euler = worst(euler, (SHARE * (1.0 - x) - rested).abs());
        careless = worst(careless, (SHARE * (1.0 - (-x).exp()) / x - risen).abs());
    }
    let what = "what is held back, x from 1e-9 to 1e9, of a step of 1";
    Ok(Outcome::of([
        Check::at_most(what, Naive::Error(euler), ours, 1e-10),
        Check::at_most(
            "the same; naive: exact form without series for small x",
            Naive::Error(careless),
            ours,
            1e-10,
        ),
    ]))
}
