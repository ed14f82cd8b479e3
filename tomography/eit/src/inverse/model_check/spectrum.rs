//! The best map of the whole sheet, and the contact impedance that improves the fit most.

use std::ops::RangeInclusive;

use nalgebra::{DMatrix, DVector};

use crate::inverse::evidence::{self, Evidence};

/// Ratios of the variance of errors to that of maps: steps from the largest eigenvalue, four per decade.
const STEPS: RangeInclusive<i32> = -40..=3;
const STEPS_A_DECADE: i32 = 4;

/// The covariance of the data of a white map, decomposed.
pub(super) struct Spectrum {
    evidence: Evidence,
    /// Contact directions in the eigenbasis.
    contacts: DMatrix<f64>,
}

/// The fit of one frame.
pub(super) struct Fit {
    /// Components of the data in the eigenbasis.
    along: DVector<f64>,
    best: evidence::Fit,
    /// Standard deviation of the errors.
    pub(super) error: f64,
}

/// The change explained by the best map.
pub(super) struct Explained {
    /// u: the map is x = J'u / area.
    pub(super) dual: DVector<f64>,
    /// The data J x of the map.
    pub(super) data: DVector<f64>,
}

impl Spectrum {
    /// `None` if the decomposition fails.
    pub(super) fn new(gram: &DMatrix<f64>, contacts: &DMatrix<f64>) -> Option<Self> {
        let evidence = Evidence::new(gram, STEPS, STEPS_A_DECADE)?;
        Some(Self {
            contacts: evidence.along(contacts),
            evidence,
        })
    }

    /// `None` without data.
    pub(super) fn fit(&self, data: &DVector<f64>) -> Option<Fit> {
        let along = self.evidence.along(data);
        let squares = along.map(|value| value * value);
        let best = self.evidence.best(&squares, 0.0)?;
        Some(Fit {
            error: best.error(),
            along,
            best,
        })
    }

    /// The best map's coefficients u (x = J'u / area), and the data that it explains.
    pub(super) fn explained(&self, fit: &Fit) -> Explained {
        let values = &self.evidence.values;
        let weights = DVector::from_fn(values.len(), |k, _| {
            fit.along[k] / (values[k] + fit.best.ratio)
        });
        let data = DVector::from_fn(values.len(), |k, _| values[k] * weights[k]);
        Explained {
            dual: self.evidence.vectors() * weights,
            data: self.evidence.vectors() * data,
        }
    }

    /// The electrode whose contact impedance improves the fit most, and the improvement in chi squared; `noise` is the
    /// smallest standard deviation of the errors.
    pub(super) fn contact(&self, fit: &Fit, noise: f64) -> (usize, f64) {
        let ratio = fit.best.ratio.max(noise.powi(2) / fit.best.scale);
        let weights: Vec<f64> = self
            .evidence
            .values
            .iter()
            .map(|value| 1.0 / (value + ratio))
            .collect();
        let improvements = self.contacts.column_iter().map(|direction| {
            let (mut along, mut square) = (0.0, 0.0);
            for ((c, data), weight) in direction.iter().zip(&fit.along).zip(&weights) {
                along += c * data * weight;
                square += c * c * weight;
            }
            match square > 0.0 {
                true => along * along / (square * fit.best.scale),
                false => 0.0,
            }
        });
        improvements.enumerate().fold(
            (0, 0.0),
            |best, next| if next.1 > best.1 { next } else { best },
        )
    }
}
