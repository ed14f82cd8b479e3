//! The best map of the whole sheet in the eigenbasis of its data: sizes of map and errors by maximum likelihood.

use nalgebra::{DMatrix, DVector};

use crate::linear_algebra::dense;

/// Ratios of the variance of errors to the largest eigenvalue that are tried: four a decade.
const STEPS_A_DECADE: i32 = 4;
const DECADES: std::ops::Range<i32> = -10..1;

/// The covariance of the data of a white map, decomposed.
pub(super) struct Spectrum {
    vectors: DMatrix<f64>,
    /// Contact directions in the eigenbasis.
    contacts: DMatrix<f64>,
    /// Reciprocal variances for each ratio.
    weights: Vec<DVector<f64>>,
    /// Ratio, and the sum of the logarithms of the variances.
    ratios: Vec<(f64, f64)>,
}

/// The fit of one frame.
pub(super) struct Fit {
    /// Components of the data in the eigenbasis.
    along: DVector<f64>,
    /// Index of the ratio.
    at: usize,
    /// Variance of a map of size 1.
    scale: f64,
    /// Standard deviation of the errors.
    pub(super) error: f64,
}

impl Spectrum {
    /// `None` if the decomposition fails.
    pub(super) fn new(gram: &DMatrix<f64>, contacts: &DMatrix<f64>) -> Option<Self> {
        let (values, vectors) = dense::symmetric_eigen(gram)?;
        let top = values.iter().copied().fold(0.0, f64::max);
        let (mut weights, mut ratios) = (Vec::new(), Vec::new());
        for step in DECADES.start * STEPS_A_DECADE..DECADES.end * STEPS_A_DECADE {
            let ratio = top * 10_f64.powf(f64::from(step) / f64::from(STEPS_A_DECADE));
            let variances = values.iter().map(|value| value.max(0.0) + ratio);
            let logs = variances.clone().map(f64::ln).sum();
            weights.push(DVector::from_iterator(
                values.len(),
                variances.map(f64::recip),
            ));
            ratios.push((ratio, logs));
        }
        Some(Self {
            contacts: vectors.tr_mul(contacts),
            vectors,
            weights,
            ratios,
        })
    }

    pub(super) fn fit(&self, data: &DVector<f64>) -> Fit {
        let along = DVector::from_vec(
            dense::transposed_times(&self.vectors, data)
                .as_slice()
                .to_vec(),
        );
        let squares = along.map(|value| value * value);
        let count = squares.len() as f64;
        let (mut at, mut scale, mut least) = (0, 0.0, f64::INFINITY);
        for (k, (weights, (_, logs))) in self.weights.iter().zip(&self.ratios).enumerate() {
            let variance = squares.dot(weights) / count;
            let surprise = count * variance.ln() + logs;
            if surprise < least {
                (at, scale, least) = (k, variance, surprise);
            }
        }
        Fit {
            error: (scale * self.ratios[at].0).sqrt(),
            along,
            at,
            scale,
        }
    }

    /// The electrode whose contact impedance improves the fit most, and the improvement in chi squared; `noise` is the
    /// smallest standard deviation of the errors.
    pub(super) fn contact(&self, fit: &Fit, noise: f64) -> (usize, f64) {
        let floor = noise.powi(2) / fit.scale - self.ratios[fit.at].0;
        let weights = self.weights[fit.at].map(|weight| match floor > 0.0 {
            true => 1.0 / (1.0 / weight + floor),
            false => weight,
        });
        let weighted = fit.along.component_mul(&weights);
        let improvements = self.contacts.column_iter().map(|direction| {
            let (mut along, mut square) = (0.0, 0.0);
            for ((c, data), weight) in direction.iter().zip(&weighted).zip(&weights) {
                along += c * data;
                square += c * c * weight;
            }
            match square > 0.0 {
                true => along * along / (square * fit.scale),
                false => 0.0,
            }
        });
        improvements.enumerate().fold(
            (0, 0.0),
            |best, next| if next.1 > best.1 { next } else { best },
        )
    }
}
