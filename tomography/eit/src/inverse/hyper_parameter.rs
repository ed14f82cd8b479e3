//! The hyper-parameter of a linear method from recorded frames, for recordings of unknown noise.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use survey::{Protocol, Reading};

use crate::Mesh;
use crate::inverse::error::OneStepError;
use crate::inverse::evidence::Evidence;
use crate::inverse::learned::linear::Linear;
use crate::inverse::options::OneStepOptions;
use crate::inverse::prior::Penalty;
use crate::linear_algebra::dense;

/// Values of lambda squared to try, per decade.
const STEPS_A_DECADE: i32 = 10;
/// Decades of lambda squared below the largest eigenvalue: the linear model is not more exact than that (MODEL_SHARE).
const DECADES: i32 = -7;

/// Frames in the eigenbasis of J R^-1 J'.
struct Spectrum {
    /// Of J R^-1 J', the null space of R fitted first.
    evidence: Evidence,
    /// Squared components of each frame.
    squares: Vec<DVector<f64>>,
    /// Squared norm of each frame in the directions that no map changes, and the number of those.
    beside: Vec<f64>,
    unseen: usize,
}

impl Spectrum {
    /// `fitted`: whether the null space of R is fitted first.
    fn new(
        (linear, mut sensitivity, penalty): (Linear, DMatrix<f64>, Penalty),
        baseline: &[Reading],
        frames: &[&[Reading]],
        fitted: bool,
    ) -> Result<Self, OneStepError> {
        let mut beside_null = None;
        if fitted && let Some(null) = penalty.null_space() {
            let q = (&sensitivity * null).qr().q();
            sensitivity -= &q * q.tr_mul(&sensitivity);
            beside_null = Some(q);
        }
        let spread = penalty
            .inverse_times_transposed(&sensitivity)
            .ok_or(OneStepError::Prior)?;
        let gram = dense::product(dense::view(&sensitivity), dense::view(&spread));
        let gram = 0.5 * (&gram + gram.transpose());
        let steps = DECADES * STEPS_A_DECADE..=0;
        let evidence = Evidence::new(&gram, steps, STEPS_A_DECADE).ok_or(OneStepError::Prior)?;
        let (mut squares, mut beside) = (Vec::new(), Vec::new());
        for frame in frames {
            // a reading that contradicts its twin is masked in maps; here it counts as noise
            let Ok((change, missing)) = linear.change_as_read(baseline, frame, "one-step") else {
                continue;
            };
            if !missing.is_empty() || change.iter().all(|c| *c == 0.0) {
                continue;
            }
            let mut folded = linear.fold.data(&change);
            let all: f64 = change.iter().map(|c| c * c).sum();
            beside.push((all - folded.norm_squared()).max(0.0));
            if let Some(q) = &beside_null {
                folded -= q * q.tr_mul(&folded);
            }
            squares.push(evidence.along(&folded).map(|along| along * along));
        }
        Ok(Self {
            unseen: linear.fold.readings() - linear.fold.rows(),
            evidence,
            squares,
            beside,
        })
    }
}

/// The lambda that makes recorded frames most probable: with x ~ N(0, g^2 R^-1) and white noise s, a change is N(0, g^2
/// J R^-1 J' + s^2 I); each frame has its own g, all share lambda = s / g. The part of a frame that the model does not
/// explain counts as noise. Frames with missing readings or without any change are skipped; `None` if no frame is left.
/// The search covers 3e-4 of the largest singular value of J R^-1/2 and above.
///
/// # Errors
/// As [`crate::OneStep::new`]; `options.hyper` is ignored.
pub fn probable_lambda(
    mesh: &Arc<Mesh>,
    contact_ohm_m: &[f64],
    sigma0: &[f64],
    protocol: &Protocol,
    options: &OneStepOptions,
    baseline: &[Reading],
    frames: &[&[Reading]],
) -> Result<Option<f64>, OneStepError> {
    let model = Linear::new(mesh, contact_ohm_m, sigma0, protocol, options)?;
    let spectrum = Spectrum::new(model, baseline, frames, false)?;
    if spectrum.squares.is_empty() {
        return Ok(None);
    }
    // all frames share the ratio, each has the best g of its own
    let mut surprises: Vec<(f64, f64)> = spectrum
        .evidence
        .ratios()
        .map(|square| (square, 0.0))
        .collect();
    for (squares, beside) in spectrum.squares.iter().zip(&spectrum.beside) {
        let fits = spectrum.evidence.fits(squares, *beside, spectrum.unseen);
        for ((_, surprise), fit) in surprises.iter_mut().zip(fits) {
            *surprise += fit.surprise;
        }
    }
    let best = surprises.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
    Ok(best.map(|(square, _)| square.sqrt()))
}

/// The lambda at the corner of the L-curve of recorded frames (P. C. Hansen, SIAM Review 34 (1992) 561): the point of
/// largest curvature of log |J x - d| against log sqrt(x'Rx), both over all frames. `None` if no frame has a change, or
/// the curve has no corner between 3e-4 of the largest singular value of J R^-1/2 and that value.
///
/// # Errors
/// As [`crate::OneStep::new`]; `options.hyper` is ignored.
pub fn l_curve_lambda(
    mesh: &Arc<Mesh>,
    contact_ohm_m: &[f64],
    sigma0: &[f64],
    protocol: &Protocol,
    options: &OneStepOptions,
    baseline: &[Reading],
    frames: &[&[Reading]],
) -> Result<Option<f64>, OneStepError> {
    let model = Linear::new(mesh, contact_ohm_m, sigma0, protocol, options)?;
    let spectrum = Spectrum::new(model, baseline, frames, true)?;
    if spectrum.squares.is_empty() {
        return Ok(None);
    }
    let candidates: Vec<f64> = spectrum.evidence.ratios().collect();
    let curve: Vec<[f64; 2]> = candidates
        .iter()
        .map(|&square| {
            let (mut residual, mut size) = (0.0, 0.0);
            for (squares, beside) in spectrum.squares.iter().zip(&spectrum.beside) {
                residual += beside;
                for (c, v) in squares.iter().zip(&spectrum.evidence.values) {
                    residual += c * (square / (v + square)).powi(2);
                    size += c * v / (v + square).powi(2);
                }
            }
            [0.5 * residual.ln(), 0.5 * size.ln()]
        })
        .collect();
    Ok(corner(&curve).map(|at| candidates[at].sqrt()))
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
    use crate::inverse::hyper_parameter::*;

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
