//! One load: a disc, or a polygon on a circle as in Algorithm 1, with its loss; as free parameters with a prior.

use std::f64::consts::{PI, TAU};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Largest radius, m.
pub(crate) const LARGEST: f64 = 0.070;
/// Lengths are in centimetres.
const UNIT: f64 = 0.01;
/// Deviation of the logit of a number uniform over 0 to 1.
const LOGIT: f64 = 1.8138;
/// Corners of the polygon that approximates a circle.
const ROUND: usize = 32;

/// Kind of outline.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A circle.
    Disc,
    /// A polygon with this many corners.
    Polygon(usize),
}

/// Parameters: x, y (cm), logit of radius over the largest, angles of the corners, logit of the loss.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shape {
    pub(crate) kind: Kind,
    pub(crate) theta: Vec<f64>,
}

fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

fn logit(p: f64) -> f64 {
    let p = p.clamp(1e-4, 1.0 - 1e-4);
    (p / (1.0 - p)).ln()
}

impl Shape {
    /// A draw from the prior, with the centre in the box.
    pub(crate) fn draw([low, high]: [[f64; 2]; 2], random: &mut ChaCha8Rng) -> Self {
        let kind = match random.random_range(0..10) {
            0..=2 => Kind::Disc,
            3..=5 => Kind::Polygon(3),
            6..=7 => Kind::Polygon(4),
            _ => Kind::Polygon(5),
        };
        let mut theta: Vec<f64> = (0..2)
            .map(|axis| (low[axis] + random.random::<f64>() * (high[axis] - low[axis])) / UNIT)
            .collect();
        theta.push(logit(random.random()));
        if let Kind::Polygon(corners) = kind {
            theta.extend((0..corners).map(|_| random.random::<f64>() * TAU));
        }
        theta.push(logit(random.random()));
        Self { kind, theta }
    }

    /// Share of the conductance that is lost, 0 to 1.
    pub(crate) fn loss(&self) -> f64 {
        logistic(self.theta[self.theta.len() - 1]).min(0.9999)
    }

    /// Sets the loss, limited to stay away from 0 and 1, where the gradient vanishes.
    pub(crate) fn set_loss(&mut self, loss: f64) {
        let last = self.theta.len() - 1;
        self.theta[last] = logit(loss.clamp(0.02, 0.98));
    }

    /// Radius of the circle, m.
    fn radius(&self) -> f64 {
        LARGEST * logistic(self.theta[2])
    }

    /// Counter-clockwise, convex.
    pub(crate) fn outline(&self) -> Vec<[f64; 2]> {
        let (x, y, radius) = (self.theta[0] * UNIT, self.theta[1] * UNIT, self.radius());
        match self.kind {
            Kind::Disc => {
                let step = TAU / ROUND as f64;
                let radius = radius * (step / step.sin()).sqrt();
                (0..ROUND)
                    .map(|k| {
                        let (sin, cos) = (step * k as f64).sin_cos();
                        [x + radius * cos, y + radius * sin]
                    })
                    .collect()
            }
            Kind::Polygon(corners) => {
                let mut angles: Vec<f64> = self.theta[3..3 + corners]
                    .iter()
                    .map(|a| a.rem_euclid(TAU))
                    .collect();
                angles.sort_by(f64::total_cmp);
                angles
                    .iter()
                    .map(|a| [x + radius * a.cos(), y + radius * a.sin()])
                    .collect()
            }
        }
    }

    /// (penalty's weight, centre) of each parameter: the logarithm of the prior is -w (theta - c)^2 / 2.
    pub(crate) fn prior(&self, parameter: usize) -> (f64, f64) {
        let last = self.theta.len() - 1;
        if parameter == 2 || parameter == last {
            (1.0 / (LOGIT * LOGIT), 0.0)
        } else {
            (0.0, 0.0)
        }
    }

    /// Logarithm of the prior's density at its centre, over all parameters; `area` of the region in m2.
    pub(crate) fn log_prior(&self, area: f64) -> f64 {
        let logits = -2.0 * (LOGIT * (2.0 * PI).sqrt()).ln();
        let place = -(area / (UNIT * UNIT)).ln();
        let (angles, share) = match self.kind {
            // the order of the corners does not matter
            Kind::Polygon(n) => {
                let orders: f64 = (1..=n).map(|k| (k as f64).ln()).sum();
                (orders - n as f64 * TAU.ln(), 0.25_f64)
            }
            Kind::Disc => (0.0, 0.25),
        };
        logits + place + angles + share.ln()
    }
}
