//! One-step difference reconstruction: the linear least-squares map, precomputed.
//!
//! x = argmin |W (J x - dv)|^2 + lambda^2 x'Rx  with x = dsigma / sigma0 on the triangles of the region, J the
//! sensitivity to it, R the [`Prior`] and W optional weights of the readings. A frame costs one matrix-vector product.

mod fixed;
mod noise_figure;

use std::sync::{Arc, OnceLock};

use nalgebra::{DMatrix, DVector};
use survey::{Map, Protocol, Reading};

use self::fixed::Fixed;
use crate::inverse::box_constrained::Bounded;
use crate::inverse::error::OneStepError;
use crate::inverse::frame_rule::FrameRule;
use crate::inverse::learned::linear::Linear;
use crate::inverse::learned::novelty;
use crate::inverse::low_rank::Quick;
use crate::inverse::options::{Hyper, OneStepOptions, Scale};
use crate::inverse::reciprocity::Seen;
use crate::linear_algebra::dense;
use crate::{Mesh, Novelty, ReconstructError, Reconstructor};

/// Suffix of the method's name if the bounded problem could not be solved and the map is the unbounded one clipped to
/// -1 <= x <= 0.
pub const CLIPPED: &str = " (unbounded map, clipped)";

/// Suffix of the name of maps that are bounded to losses.
const LOSS_ONLY: &str = ", loss only";

/// Root mean square over the region of the relative change that a map is expected to have: a disc of 10 mm with half
/// its conductance lost, anywhere on the region of the paper's sheet (0.5 sqrt(78.5 mm^2 / 33,870 mm^2)). It is the
/// only constant in the rule that derives lambda from the noise:
///
/// lambda = s / g, with s = sqrt(2) volts / current, the noise of a difference at 1 A, and g such that the prior
/// N(0, g^2 R^-1) has this root mean square over the region: the maximum a posteriori estimate for that noise.
///
/// The rule uses noise, geometry and prior, never a frame. Half or double the constant changes Test #1 by less than
/// half a millimetre.
pub const EXPECTED_CHANGE: f64 = 0.024;

/// Share of the model's size (the Frobenius norm of J R^-1/2) that is the lower limit of a lambda derived from the
/// noise: the linear model is not more accurate than that, however small the noise is. On the paper's sheet it
/// corresponds to a noise of about 0.2 uV at 1 mA. A lambda given explicitly is used unchanged.
pub const MODEL_SHARE: f64 = 3e-4;

/// The one-step reconstructor.
pub struct OneStep {
    mesh: Arc<Mesh>,
    mesh_hash: String,
    protocol: Protocol,
    /// Names of the method and of its unbounded maps.
    method: String,
    unbounded_method: String,
    linear: Linear,
    solver: Solver,
    /// Standard deviation of a change due to noise, if known.
    deviation: Option<f64>,
    sensitivity: DMatrix<f64>,
    /// Directions of the data that maps change; computed when novelty is first queried.
    directions: OnceLock<Option<DMatrix<f64>>>,
    bounded: Option<Bounded>,
    most_gain: Option<f64>,
}

/// Solvers that convert a change to an unbounded map.
enum Solver {
    Fixed(Box<Fixed>),
    Frame(Box<FrameRule>),
}

impl OneStep {
    /// Solves the forward model at `sigma0` (S per square, one per triangle of the mesh) and factors once.
    ///
    /// # Errors
    /// See [`OneStepError`].
    pub fn new(
        mesh: Arc<Mesh>,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        protocol: &Protocol,
        options: OneStepOptions,
    ) -> Result<Self, OneStepError> {
        let (linear, sensitivity, penalty) =
            Linear::new(&mesh, contact_ohm_m, sigma0, protocol, &options)?;
        let deviation = deviation(options.hyper, &options.scale)?;
        match options.map_error {
            Some(error) if !(error > 0.0 && error < 1.0) => {
                return Err(OneStepError::MapError { error });
            }
            Some(_) if matches!(options.hyper, Hyper::Frame { .. }) => {
                return Err(OneStepError::MapErrorPerFrame);
            }
            _ => {}
        }
        let solver = match options.hyper {
            Hyper::Frame { rule, .. } => Solver::Frame(Box::new(FrameRule::new(
                rule,
                deviation,
                &linear,
                sensitivity.clone(),
                &penalty,
            )?)),
            _ => Solver::Fixed(Box::new(Fixed::new(
                &mesh,
                &linear,
                &sensitivity,
                &penalty,
                &options,
                deviation,
            )?)),
        };
        let bounded = match options.loss_only {
            false => None,
            true => Some(Bounded::new(sensitivity.clone(), penalty).ok_or(OneStepError::Prior)?),
        };
        let unbounded_method = format!("one-step {}", options.prior.name());
        let method = match (options.loss_only, options.most_gain) {
            (false, _) => unbounded_method.clone(),
            (true, None) => format!("{unbounded_method}{LOSS_ONLY}"),
            (true, Some(_)) => format!("{unbounded_method}, loss only unless the frame shows gain"),
        };
        Ok(Self {
            method,
            unbounded_method,
            mesh_hash: mesh.hash().to_owned(),
            mesh,
            protocol: protocol.clone(),
            linear,
            solver,
            deviation,
            sensitivity,
            directions: OnceLock::new(),
            bounded,
            most_gain: options.most_gain,
        })
    }

    fn fixed(&self) -> Option<&Fixed> {
        match &self.solver {
            Solver::Fixed(fixed) => Some(fixed),
            Solver::Frame(_) => None,
        }
    }

    /// The hyper-parameter of all frames; `None` if each frame has its own.
    pub fn lambda(&self) -> Option<f64> {
        Some(self.fixed()?.lambda)
    }

    /// Effective degrees of freedom of the linear map: how many independent components of the readings it uses.
    /// Reciprocal twins count once.
    ///
    /// # Errors
    /// [`OneStepError::PerFrame`].
    pub fn degrees_of_freedom(&self) -> Result<f64, OneStepError> {
        let fixed = self.fixed().ok_or(OneStepError::PerFrame)?;
        Ok(fixed.degrees)
    }

    /// Whether lambda was raised: the noise alone would give a smaller one than [`MODEL_SHARE`] allows.
    pub fn raised(&self) -> bool {
        self.fixed().is_some_and(|fixed| fixed.raised)
    }

    /// The reconstruction matrix: region x readings, from a difference at the model's scale to the map. The difference
    /// is in V at 1 A, or in V if currents are known, and multiplied by the reading's weight if readings are weighted.
    ///
    /// # Errors
    /// [`OneStepError::PerFrame`].
    pub fn matrix(&self) -> Result<DMatrix<f64>, OneStepError> {
        let fixed = self.fixed().ok_or(OneStepError::PerFrame)?;
        let matrix = fixed.solution.matrix();
        Ok(self.linear.fold.unfold(&matrix.transpose()).transpose())
    }

    /// The map of a change, and the name of its method.
    fn values(
        &self,
        change: &mut [f64],
        missing: &[usize],
    ) -> Result<(Vec<f64>, String), OneStepError> {
        let fold = &self.linear.fold;
        let seen = fold.seen(change, missing);
        let (lambda, unbounded) = match &self.solver {
            Solver::Fixed(fixed) => (fixed.lambda, fixed.map(&self.linear, change, missing)?),
            Solver::Frame(rule) => rule.map(&seen, missing)?,
        };
        let Some(bounded) = &self.bounded else {
            return Ok((unbounded, self.unbounded_method.clone()));
        };
        let mut method = format!("{}{LOSS_ONLY}", self.unbounded_method);
        let values = bounded.solve(&seen, lambda).unwrap_or_else(|| {
            method.push_str(CLIPPED);
            let clipped = unbounded.iter().map(|value| value.clamp(-1.0, 0.0));
            clipped.collect()
        });
        if let Some(most) = self.most_gain
            && self.gain(&seen, &values, &unbounded) > most
        {
            return Ok((unbounded, self.unbounded_method.clone()));
        }
        Ok((values, method))
    }

    /// Share of the squared change that the bounded map leaves unexplained, in addition to the share left by the
    /// unbounded map.
    fn gain(&self, seen: &Seen, bounded: &[f64], unbounded: &[f64]) -> f64 {
        let rows = seen.rows(&self.sensitivity);
        let left = |map: &[f64]| {
            let explained = dense::times(&rows, &DVector::from_column_slice(map));
            (DVector::from_vec(explained) - &seen.data).norm_squared()
        };
        let all = seen.data.norm_squared();
        match all > 0.0 {
            true => (left(bounded) - left(unbounded)) / all,
            false => 0.0,
        }
    }
}

/// Standard deviation of a change due to the noise stated by the hyper-parameter, in the unit of the data.
fn deviation(hyper: Hyper, scale: &Scale) -> Result<Option<f64>, OneStepError> {
    let (volts, current) = match hyper {
        Hyper::Noise { volts, current }
        | Hyper::Frame {
            volts: Some(volts),
            current,
            ..
        } => (volts, current),
        _ => return Ok(None),
    };
    OneStepError::positive("noise", volts)?;
    OneStepError::positive("current", current)?;
    Ok(Some(scale.deviation(volts, current)))
}

impl Reconstructor for OneStep {
    fn method(&self) -> &str {
        &self.method
    }

    fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    fn mesh(&self) -> &Arc<Mesh> {
        &self.mesh
    }

    fn assumptions(&self) -> Vec<String> {
        let mut notes = vec![match &self.solver {
            Solver::Fixed(fixed) => format!(
                "{}, lambda {:.3e}: linear in the change of conductance, one matrix",
                self.method, fixed.lambda
            ),
            Solver::Frame(rule) => format!(
                "{}, lambda of each frame chosen {}",
                self.method,
                rule.description()
            ),
        }];
        notes.push(match self.deviation {
            Some(deviation) => format!(
                "white noise of {:.2e} (V, or V at 1 A) on each reading, on baseline and frame alike",
                deviation / std::f64::consts::SQRT_2
            ),
            None => "the noise of the readings was not stated".to_owned(),
        });
        if let Some(fixed) = self.fixed() {
            notes.push(format!(
                "{:.1} degrees of freedom of {} different readings",
                fixed.degrees,
                self.sensitivity.nrows()
            ));
            if fixed.degrees < 1.0 {
                notes.push(
                    "less than one degree of freedom: with this hyper-parameter the map is empty, whatever the load"
                        .to_owned(),
                );
            }
        }
        if self.raised() {
            notes.push(format!(
                "the noise permits a smaller lambda, but a linear model is not accurate enough for less than {MODEL_SHARE:e} of its size"
            ));
        }
        if let (Some(_), Some(most)) = (&self.bounded, self.most_gain) {
            notes.push(format!(
                "loads only reduce conductance (-1 <= dsigma/sigma0 <= 0), unless that leaves more than {:.0} % of a frame's \
                 change unexplained",
                100.0 * most
            ));
        } else if self.bounded.is_some() {
            notes.push("loads only reduce conductance: -1 <= dsigma/sigma0 <= 0".to_owned());
        }
        let quick = self.fixed().and_then(|fixed| fixed.quick.as_ref());
        notes.extend(quick.map(Quick::description));
        notes
    }

    /// Noise figure of the linear map; `None` if maps are bounded to losses or have a lambda for each frame, because
    /// such maps are not linear.
    fn noise_figure(&self) -> Option<f64> {
        let fixed = self.fixed()?;
        self.bounded.is_none().then_some(fixed.noise_figure)
    }

    fn novelty(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Option<Novelty>, ReconstructError> {
        let (mut change, missing) = self.linear.change(baseline, frame, &self.method)?;
        let Some(deviation) = self.deviation else {
            return Ok(None); // the noise is unknown
        };
        for value in &mut change {
            *value /= deviation;
        }
        let directions = self.directions.get_or_init(|| {
            let directions = novelty::directions(&(&self.sensitivity / deviation))?;
            Some(self.linear.fold.unfold(&directions))
        });
        Ok(directions
            .as_ref()
            .and_then(|directions| novelty::unexplained(directions, &change, &missing)))
    }

    fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let (mut change, missing) = self.linear.change(baseline, frame, &self.method)?;
        let numerical = |cause: &str| ReconstructError::Numerical {
            method: self.method.clone(),
            cause: cause.to_owned(),
        };
        let (values, method) = self
            .values(&mut change, &missing)
            .map_err(|fault| numerical(&fault.to_string()))?;
        if values.iter().any(|value| !value.is_finite()) {
            return Err(numerical("the map is not finite"));
        }
        Ok(Map {
            masked: missing.len(),
            ..Map::relative(self.mesh_hash.clone(), values, method)
        })
    }
}
