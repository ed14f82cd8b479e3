//! The linear inverse problem with a separate hyper-parameter for each frame.
//!
//! In the eigenbasis V of J R^-1 J' = V diag(v) V', the map for lambda^2 = q is  x = R^-1 J' V w,  w = V'd / (v + q),
//! so a frame costs two matrix-vector products for any q. If R has a null space n, the data in the range of b = J n
//! determine that part of the map, and the rest is solved in the orthogonal complement.

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{DMatrix, DVector};

use crate::inverse::error::OneStepError;
use crate::inverse::evidence::Evidence;
use crate::inverse::learned::linear::Linear;
use crate::inverse::options::HyperRule;
use crate::inverse::prior::Penalty;
use crate::inverse::reciprocity::Seen;
use crate::linear_algebra::dense;

/// Values of lambda squared to try, per decade.
const STEPS_A_DECADE: i32 = 10;
/// Decades of lambda squared to try below and above the largest eigenvalue: the lower limit is the accuracy of the
/// linear model ([`MODEL_SHARE`](crate::MODEL_SHARE)); at the upper limit maps vanish.
const DECADES: [i32; 2] = [-7, 2];
/// Standard deviation of the linear model's error as a share of the change, which every frame has in addition to noise:
/// a constant share, and the factor of a share that grows with the ratio of the change to the readings (root mean
/// squares).
const MODEL_ERROR: f64 = 0.01;
const MODEL_ERROR_OF_CHANGE: f64 = 0.8;

/// [`FrameRule::preference`] above which a change is more than noise: noise alone exceeds it less than once in a thousand
/// frames.
pub(crate) const SIGNIFICANT: f64 = 12.0;

/// A one-step problem whose hyper-parameter follows from each frame.
pub(crate) struct FrameRule {
    rule: HyperRule,
    /// Standard deviation of a reading's change due to noise; 0 if unknown.
    noise: f64,
    /// Root mean square of the model's readings, folded.
    readings: f64,
    sensitivity: DMatrix<f64>,
    /// R^-1 J', unknowns x rows.
    spread: DMatrix<f64>,
    null: Option<DMatrix<f64>>,
    complete: Prepared,
    /// Prepared for the missing readings of the last frame that had any; they seldom change.
    kept: Mutex<Option<Arc<Prepared>>>,
}

/// Quantities that depend only on which readings are missing.
struct Prepared {
    missing: Vec<usize>,
    evidence: Evidence,
    /// x = back w, without the direct contribution of the null space.
    back: DMatrix<f64>,
    null: Option<NullPart>,
}

/// The null space's part of the solution.
struct NullPart {
    /// Orthonormal basis of the range of b = J n.
    range: DMatrix<f64>,
    /// Matrix from the data to this part of the map.
    level: DMatrix<f64>,
}

/// The hyper-parameter of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
struct FrameHyper {
    /// lambda of the one-step problem.
    lambda: f64,
    /// Standard deviation of noise and model errors that corresponds to lambda, in the unit of the data.
    error: f64,
}

impl FrameRule {
    /// `noise`: standard deviation of a reading's change due to noise, in the unit of the data; `None` if unknown.
    ///
    /// # Errors
    /// A prior that cannot be factored.
    pub(crate) fn new(
        rule: HyperRule,
        noise: Option<f64>,
        linear: &Linear,
        sensitivity: DMatrix<f64>,
        penalty: &Penalty,
    ) -> Result<Self, OneStepError> {
        let spread = penalty
            .inverse_times_transposed(&sensitivity)
            .ok_or(OneStepError::Prior)?;
        let null = penalty.null_space();
        let complete = Prepared::new(&sensitivity, &spread, null.as_ref(), &[])?;
        Ok(Self {
            rule,
            noise: noise.unwrap_or(0.0),
            readings: rms(&linear.fold.data(&linear.readings())),
            sensitivity,
            spread,
            null,
            complete,
            kept: Mutex::new(None),
        })
    }

    /// User-readable description of the choice of lambda.
    pub(crate) fn description(&self) -> &'static str {
        match self.rule {
            HyperRule::Evidence => "by its evidence",
            HyperRule::LCurve => "at the corner of its L-curve",
        }
    }

    /// lambda of a frame, and its map; `seen`: the change at the model's scale, without the `missing` readings.
    ///
    /// # Errors
    /// As [`FrameRule::new`], for the readings that are left.
    pub(crate) fn map(
        &self,
        seen: &Seen,
        missing: &[usize],
    ) -> Result<(f64, Vec<f64>), OneStepError> {
        self.with(seen, missing, |prepared| {
            let along = prepared.along(&seen.data);
            let hyper = self.hyper(prepared, &along, &seen.data);
            let ratio = hyper.lambda * hyper.lambda;
            let weights = DVector::from_iterator(
                along.len(),
                along
                    .iter()
                    .zip(&prepared.evidence.values)
                    .map(|(along, value)| along / (value + ratio)),
            );
            let mut map = dense::times(&prepared.back, &weights);
            if let Some(null) = &prepared.null {
                for (value, level) in map.iter_mut().zip(dense::times(&null.level, &seen.data)) {
                    *value += level;
                }
            }
            (hyper.lambda, map)
        })
    }

    /// Standard deviation of noise and model errors in a frame.
    ///
    /// # Errors
    /// As [`FrameRule::map`].
    pub(crate) fn error(&self, seen: &Seen, missing: &[usize]) -> Result<f64, OneStepError> {
        self.with(seen, missing, |prepared| {
            let along = prepared.along(&seen.data);
            self.hyper(prepared, &along, &seen.data).error
        })
    }

    /// Twice the logarithm of how much better a map explains the change of a frame than noise does; 0 if it does not.
    ///
    /// # Errors
    /// As [`FrameRule::map`].
    pub(crate) fn preference(&self, seen: &Seen, missing: &[usize]) -> Result<f64, OneStepError> {
        self.with(seen, missing, |prepared| {
            let squares = prepared.along(&seen.data).map(|value| value * value);
            let floor = self.least(&seen.data);
            let fit = prepared.evidence.best(&squares, floor);
            fit.map_or(0.0, |fit| {
                prepared.evidence.preference(&squares, floor, &fit)
            })
        })
    }

    /// Lower limit of the standard deviation of a frame's errors.
    fn least(&self, data: &DVector<f64>) -> f64 {
        let size = rms(data);
        let model = size * (MODEL_ERROR + MODEL_ERROR_OF_CHANGE * size / self.readings);
        self.noise.hypot(model)
    }

    fn with<T>(
        &self,
        seen: &Seen,
        missing: &[usize],
        then: impl FnOnce(&Prepared) -> T,
    ) -> Result<T, OneStepError> {
        if seen.complete() {
            return Ok(then(&self.complete));
        }
        let kept = {
            let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
            kept.clone().filter(|kept| kept.missing == missing)
        };
        let kept = match kept {
            Some(kept) => kept,
            None => {
                let rows = seen.rows(&self.sensitivity);
                let spread = seen.rows(&self.spread.transpose()).transpose();
                let prepared = Prepared::new(&rows, &spread, self.null.as_ref(), missing)?;
                let new = Arc::new(prepared);
                *self.kept.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&new));
                new
            }
        };
        Ok(then(&kept))
    }

    fn hyper(&self, prepared: &Prepared, along: &DVector<f64>, data: &DVector<f64>) -> FrameHyper {
        let squares = along.map(|value| value * value);
        let beside = || (data.norm_squared() - squares.sum()).max(0.0);
        if self.rule == HyperRule::LCurve
            && let Some(ratio) = corner_ratio(&prepared.evidence, &squares, beside())
        {
            let scale = prepared.evidence.scale(&squares, ratio);
            return FrameHyper {
                lambda: ratio.sqrt(),
                error: (scale * ratio).sqrt(),
            };
        }
        let floor = self.least(data);
        match prepared.evidence.best(&squares, floor) {
            Some(fit) => FrameHyper {
                lambda: fit.ratio.sqrt(),
                error: fit.error(),
            },
            // no change at all: any lambda gives the same map
            None => FrameHyper {
                lambda: prepared.evidence.values.iter().sum::<f64>().sqrt(),
                error: floor,
            },
        }
    }
}

impl Prepared {
    fn new(
        sensitivity: &DMatrix<f64>,
        spread: &DMatrix<f64>,
        null: Option<&DMatrix<f64>>,
        missing: &[usize],
    ) -> Result<Self, OneStepError> {
        let missing = missing.to_vec();
        let gram = dense::product(dense::view(sensitivity), dense::view(spread));
        let gram = 0.5 * (&gram + gram.transpose());
        let steps = DECADES[0] * STEPS_A_DECADE..=DECADES[1] * STEPS_A_DECADE;
        let decomposed = |gram: &DMatrix<f64>| {
            Evidence::new(gram, steps.clone(), STEPS_A_DECADE).ok_or(OneStepError::Prior)
        };
        let Some(null) = null else {
            let evidence = decomposed(&gram)?;
            let back = dense::product(dense::view(spread), dense::view(evidence.vectors()));
            return Ok(Self {
                missing,
                evidence,
                back,
                null: None,
            });
        };
        let qr = (sensitivity * null).qr();
        let (range, r) = (qr.q(), qr.r());
        let inverse = r.try_inverse().ok_or(OneStepError::Prior)?;
        let level = null * inverse * range.transpose();
        let beside = DMatrix::identity(gram.nrows(), gram.nrows()) - &range * range.transpose();
        let projected = &beside * &gram * &beside;
        let evidence = decomposed(&(0.5 * (&projected + projected.transpose())))?;
        let spread = spread - &level * &gram;
        let back = dense::product(dense::view(&spread), dense::view(evidence.vectors()));
        Ok(Self {
            missing,
            evidence,
            back,
            null: Some(NullPart { range, level }),
        })
    }

    /// Data in the eigenbasis, without the part that the null space explains.
    fn along(&self, data: &DVector<f64>) -> DVector<f64> {
        match &self.null {
            None => self.evidence.along(data),
            Some(null) => self
                .evidence
                .along(&(data - &null.range * null.range.tr_mul(data))),
        }
    }
}

fn rms(data: &DVector<f64>) -> f64 {
    (data.norm_squared() / data.len() as f64).sqrt()
}

/// q at the corner of the L-curve (P. C. Hansen, SIAM Review 34 (1992) 561): the point of largest curvature of
/// log |J x - d| against log sqrt(x'Rx). `beside`: squared norm of the part of the data that no map changes. `None` if
/// the curve has no corner.
fn corner_ratio(evidence: &Evidence, squares: &DVector<f64>, beside: f64) -> Option<f64> {
    let candidates: Vec<f64> = evidence.ratios().collect();
    let curve: Vec<[f64; 2]> = candidates
        .iter()
        .map(|&ratio| {
            let (mut residual, mut size) = (beside, 0.0);
            for (c, v) in squares.iter().zip(&evidence.values) {
                residual += c * (ratio / (v + ratio)).powi(2);
                size += c * v / (v + ratio).powi(2);
            }
            [0.5 * residual.ln(), 0.5 * size.ln()]
        })
        .collect();
    corner(&curve).map(|at| candidates[at])
}

/// The point of largest curvature towards the origin, on a curve with evenly spaced parameter.
fn corner(curve: &[[f64; 2]]) -> Option<usize> {
    let bend = |k: usize| {
        let [p, q, r] = [curve[k - 1], curve[k], curve[k + 1]];
        let (dx, dy) = (0.5 * (r[0] - p[0]), 0.5 * (r[1] - p[1]));
        let (ddx, ddy) = (r[0] - 2.0 * q[0] + p[0], r[1] - 2.0 * q[1] + p[1]);
        (dx * ddy - dy * ddx) / (dx * dx + dy * dy).powf(1.5)
    };
    (1..curve.len().saturating_sub(1))
        .map(|k| (k, bend(k)))
        .filter(|(_, bend)| bend.is_finite() && *bend > 0.0)
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(k, _)| k)
}

#[cfg(test)]
mod tests {
    use crate::inverse::frame_rule::*;

    #[test]
    fn the_corner_of_an_l_is_found() {
        // down, then to the right, in the order of the parameter
        let curve: Vec<[f64; 2]> = (0..41)
            .map(|k| {
                let t = f64::from(k - 20) / 4.0;
                [(1.0 + t.exp()).ln(), (1.0 + (-t).exp()).ln()]
            })
            .collect();
        assert_eq!(corner(&curve), Some(20));
        let straight: Vec<[f64; 2]> = (0..9).map(|k| [f64::from(k), -f64::from(k)]).collect();
        assert_eq!(corner(&straight), None);
    }
}
