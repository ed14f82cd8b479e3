//! One load with few parameters and a prior: a disc, or a disc modified by one or two more parameters.

use std::f64::consts::TAU;
use std::sync::LazyLock;

/// Largest radius, m.
pub(crate) const LARGEST: f64 = 0.070;
/// Unit of lengths in the parameters, m: a centimetre.
const UNIT: f64 = 0.01;
/// Standard deviation of the logit of a number that is uniform over 0 to 1.
const LOGIT: f64 = 1.8138;
/// Prior standard deviation of each coordinate of a bar's half axis, cm.
const REACH: f64 = 5.0;
/// Corners of the polygon that approximates a circle: a multiple of 2.
const ROUND: usize = 32;
/// Sine and cosine of the angle of each corner.
static CORNERS: LazyLock<[(f64, f64); ROUND]> =
    LazyLock::new(|| std::array::from_fn(|k| (TAU / ROUND as f64 * k as f64).sin_cos()));
/// Number of concentric discs that approximate a soft edge.
const LAYERS: usize = 5;
/// Index of the parameter that is the logit of the loss.
pub(crate) const LOSS: usize = 3;

/// Kinds of shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A disc.
    Disc,
    /// A disc with a soft edge, across which the logarithm of the conductance changes linearly. One more parameter: the
    /// logit of the ratio of half the edge's width to the radius.
    Soft,
    /// A ring. One more parameter: the logit of the ratio of inner to outer radius.
    Ring,
    /// All points within the radius of a line segment. Two more parameters: x and y (cm) from its middle to its end.
    Bar,
}

/// Parameters: x, y (cm), logit of the ratio of the radius to the largest one, logit of the loss, and the parameters of
/// the kind.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shape {
    pub(crate) kind: Kind,
    pub(crate) theta: Vec<f64>,
}

fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

fn logit(p: f64) -> f64 {
    let p = p.clamp(0.02, 0.98);
    (p / (1.0 - p)).ln()
}

impl Kind {
    /// Name of `count` shapes of this kind; only discs occur several times.
    pub(crate) fn name(self, count: usize) -> String {
        match self {
            Self::Disc => format!("discs ({count})"),
            Self::Soft => "disc with a soft edge".to_owned(),
            Self::Ring => "ring".to_owned(),
            Self::Bar => "bar".to_owned(),
        }
    }
}

impl Shape {
    /// Creates a disc; radius and loss are kept away from their limits, where the gradient vanishes.
    pub(crate) fn disc(centre: [f64; 2], radius: f64, loss: f64) -> Self {
        let [x, y] = centre.map(|x| x / UNIT);
        Self {
            kind: Kind::Disc,
            theta: vec![x, y, logit(radius / LARGEST), logit(loss)],
        }
    }

    /// A bar; `axis`: from its middle to its end, m.
    pub(crate) fn bar(centre: [f64; 2], axis: [f64; 2], radius: f64, loss: f64) -> Self {
        let mut shape = Self::disc(centre, radius, loss);
        shape.kind = Kind::Bar;
        shape.theta.extend(axis.map(|x| x / UNIT));
        shape
    }

    /// A disc with a soft edge at the same position.
    pub(crate) fn soft(&self) -> Self {
        let mut theta = self.theta.clone();
        theta.push(logit(0.4));
        Self {
            kind: Kind::Soft,
            theta,
        }
    }

    /// A slightly larger ring at the same position.
    pub(crate) fn ring(&self) -> Self {
        let mut ring = Self::disc(self.centre(), 1.15 * self.radius(), 1.2 * self.loss());
        ring.kind = Kind::Ring;
        ring.theta.push(logit(0.5));
        ring
    }

    /// Ratio of inner to outer radius of a ring.
    pub(super) fn hole(&self) -> f64 {
        logistic(self.theta[4])
    }

    /// Centre, m.
    pub(super) fn centre(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.theta[axis] * UNIT)
    }

    /// Radius, m.
    pub(crate) fn radius(&self) -> f64 {
        LARGEST * logistic(self.theta[2])
    }

    /// Share of the conductance that is lost, 0 to 1.
    pub(crate) fn loss(&self) -> f64 {
        logistic(self.theta[LOSS]).min(0.9999)
    }

    /// Convex, counter-clockwise outlines, each with the share of the loss's logarithm that applies within it.
    pub(crate) fn layers(&self) -> Vec<(Vec<[f64; 2]>, f64)> {
        let centre = [0, 1].map(|axis| self.theta[axis] * UNIT);
        let radius = self.radius();
        let line = |radius: f64, axis: [f64; 2]| outline(centre, radius, axis);
        match self.kind {
            Kind::Disc => vec![(line(radius, [0.0; 2]), 1.0)],
            Kind::Soft => {
                let soft = logistic(self.theta[4]);
                let layer = |k: usize| {
                    let out = (2.0 * k as f64 + 1.0) / LAYERS as f64 - 1.0;
                    let outline = line(radius * (1.0 + soft * out), [0.0; 2]);
                    (outline, 1.0 / LAYERS as f64)
                };
                (0..LAYERS).map(layer).collect()
            }
            Kind::Ring => {
                let inner = radius * logistic(self.theta[4]);
                vec![(line(radius, [0.0; 2]), 1.0), (line(inner, [0.0; 2]), -1.0)]
            }
            Kind::Bar => vec![(line(radius, [4, 5].map(|k| self.theta[k] * UNIT)), 1.0)],
        }
    }

    /// (penalty's weight, centre) of a parameter: the logarithm of the prior is -w (theta - c)^2 / 2.
    pub(crate) fn prior(&self, parameter: usize) -> (f64, f64) {
        match (self.kind, parameter) {
            (_, 0 | 1) => (0.0, 0.0),
            (Kind::Bar, 4 | 5) => (1.0 / (REACH * REACH), 0.0),
            _ => (1.0 / (LOGIT * LOGIT), 0.0),
        }
    }

    /// Keeps logits away from values at which the gradient vanishes.
    pub(crate) fn limit(&mut self) {
        self.theta[2] = self.theta[2].clamp(-4.5, 6.0);
        self.theta[LOSS] = self.theta[LOSS].clamp(-5.0, 7.0);
        if matches!(self.kind, Kind::Soft | Kind::Ring) {
            self.theta[4] = self.theta[4].clamp(-4.0, 4.0);
        }
    }
}

/// The points within a radius of a line segment, as a polygon with the area of the shape with round ends.
fn outline(centre: [f64; 2], radius: f64, [x, y]: [f64; 2]) -> Vec<[f64; 2]> {
    let step = TAU / ROUND as f64;
    let radius = radius * (step / step.sin()).sqrt();
    // each corner turned by an angle
    let place = |k: usize, end: f64, (sin, cos): (f64, f64)| {
        let (own_sin, own_cos) = CORNERS[k];
        let (sin, cos) = (sin * own_cos + cos * own_sin, cos * own_cos - sin * own_sin);
        [
            centre[0] + end * x + radius * cos,
            centre[1] + end * y + radius * sin,
        ]
    };
    if x == 0.0 && y == 0.0 {
        return (0..ROUND).map(|k| place(k, 0.0, (0.0, 1.0))).collect();
    }
    // the ends begin at right angles to the line
    let [sin, cos] = [-x, y].map(|part| part / x.hypot(y));
    let half = 0..=ROUND / 2;
    let ends = [(1.0, (sin, cos)), (-1.0, (-sin, -cos))].map(|(end, angle)| {
        half.clone()
            .map(move |k| place(k, end, angle))
            .collect::<Vec<_>>()
    });
    ends.concat()
}
