//! One load: a disc with its loss, as free parameters with a prior.

use std::f64::consts::TAU;

/// Largest radius, m.
pub(crate) const LARGEST: f64 = 0.070;
/// Lengths are in centimetres.
const UNIT: f64 = 0.01;
/// Deviation of the logit of a number uniform over 0 to 1.
const LOGIT: f64 = 1.8138;
/// Corners of the polygon that approximates a circle.
const ROUND: usize = 32;
/// Parameters of a disc.
pub(crate) const PARAMETERS: usize = 4;

/// Parameters: x, y (cm), logit of radius over the largest, logit of the loss.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Disc {
    pub(crate) theta: [f64; PARAMETERS],
}

fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

fn logit(p: f64) -> f64 {
    let p = p.clamp(0.02, 0.98);
    (p / (1.0 - p)).ln()
}

impl Disc {
    /// Radius and loss are limited to stay away from their ends, where the gradient vanishes.
    pub(crate) fn new(centre: [f64; 2], radius: f64, loss: f64) -> Self {
        let [x, y] = centre.map(|x| x / UNIT);
        Self {
            theta: [x, y, logit(radius / LARGEST), logit(loss)],
        }
    }

    /// Share of the conductance that is lost, 0 to 1.
    pub(crate) fn loss(&self) -> f64 {
        logistic(self.theta[3]).min(0.9999)
    }

    /// Counter-clockwise, convex, of the area of the disc.
    pub(crate) fn outline(&self) -> Vec<[f64; 2]> {
        let (x, y) = (self.theta[0] * UNIT, self.theta[1] * UNIT);
        let step = TAU / ROUND as f64;
        let radius = LARGEST * logistic(self.theta[2]) * (step / step.sin()).sqrt();
        (0..ROUND)
            .map(|k| {
                let (sin, cos) = (step * k as f64).sin_cos();
                [x + radius * cos, y + radius * sin]
            })
            .collect()
    }

    /// (penalty's weight, centre) of each parameter: the logarithm of the prior is -w (theta - c)^2 / 2.
    pub(crate) fn prior(parameter: usize) -> (f64, f64) {
        match parameter {
            2 | 3 => (1.0 / (LOGIT * LOGIT), 0.0),
            _ => (0.0, 0.0),
        }
    }
}
