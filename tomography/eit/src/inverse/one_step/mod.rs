//! One-step difference reconstruction: the linear least-squares map, precomputed.
//!
//! x = argmin |W (J x - dv)|^2 + lambda^2 x'Rx  with x = dsigma / sigma0 on the triangles of the region, J the
//! sensitivity to it, R the [`Prior`] and W optional weights of the readings. A frame costs one matrix-vector product.

mod noise_figure;

use std::sync::{Arc, OnceLock};

use nalgebra::DMatrix;
use survey::{Map, MapUnit, Protocol, Reading};

use crate::inverse::box_constrained::Bounded;
use crate::inverse::data_space::DataSpace;
use crate::inverse::error::OneStepError;
use crate::inverse::learned::linear::Linear;
use crate::inverse::learned::novelty;
use crate::inverse::low_rank::Quick;
use crate::inverse::options::{Hyper, OneStepOptions, Scale};
use crate::{Mesh, Novelty, ReconstructError, Reconstructor};

/// Suffix of the method's name if the bounded problem could not be solved and the map is the unbounded one clipped to
/// -1 <= x <= 0.
pub const CLIPPED: &str = " (unbounded map, clipped)";

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

/// Share of the model's size (the Frobenius norm of J R^-1/2) below which lambda is not derived from the noise: the
/// linear model is not more exact than that, however quiet the readings are. On the paper's sheet it corresponds to a
/// noise of about 0.2 uV at 1 mA. A lambda given explicitly is used unchanged.
pub const MODEL_SHARE: f64 = 3e-4;

/// The one-step reconstructor.
pub struct OneStep {
    mesh: Arc<Mesh>,
    mesh_hash: String,
    protocol: Protocol,
    method: String,
    linear: Linear,
    lambda: f64,
    amplitude: f64,
    raised: bool,
    deviation: Option<f64>,
    degrees: f64,
    noise_figure: f64,
    sensitivity: DMatrix<f64>,
    /// Directions of the data that maps change; computed when novelty is first queried.
    directions: OnceLock<Option<DMatrix<f64>>>,
    solution: DataSpace,
    quick: Option<Quick>,
    bounded: Option<Bounded>,
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
        let amplitude = penalty.amplitude(EXPECTED_CHANGE, options.shown.as_deref())?;
        let (lambda, raised) = match options.hyper {
            Hyper::Lambda(lambda) => (lambda, false),
            Hyper::Paper(alpha) => (alpha.sqrt() * linear.largest(), false),
            Hyper::Noise { volts, current } => {
                for (what, value) in [("noise", volts), ("current", current)] {
                    if !(value > 0.0 && value.is_finite()) {
                        return Err(OneStepError::NotPositive { what, value });
                    }
                }
                let at = match &options.scale {
                    Scale::ByDistance | Scale::Uniform => volts / current,
                    Scale::Currents(_) => volts,
                };
                let lambda = std::f64::consts::SQRT_2 * at / amplitude;
                let least = MODEL_SHARE * penalty.size(&sensitivity).ok_or(OneStepError::Prior)?;
                (lambda.max(least), lambda < least)
            }
            Hyper::NoiseFigure(wanted) => {
                let size = penalty.size(&sensitivity).ok_or(OneStepError::Prior)?;
                let at = |lambda| {
                    let solution = DataSpace::new(&sensitivity, &penalty, lambda)?;
                    Ok(noise_figure::of(
                        &mesh,
                        &linear.fold,
                        &sensitivity,
                        solution.matrix(),
                        options.shown.as_deref(),
                    ))
                };
                (noise_figure::lambda(wanted, size, at)?, false)
            }
        };
        let solution = DataSpace::new(&sensitivity, &penalty, lambda)?;
        let deviation = match (options.hyper, &options.scale) {
            (Hyper::Noise { volts, .. }, Scale::Currents(_)) => Some(volts),
            (Hyper::Noise { volts, current }, _) => Some(volts / current),
            _ => None,
        }
        .map(|noise| std::f64::consts::SQRT_2 * noise);
        let noise_figure = noise_figure::of(
            &mesh,
            &linear.fold,
            &sensitivity,
            solution.matrix(),
            options.shown.as_deref(),
        );
        // the trace of the matrix from readings to the readings of their map
        let degrees = sensitivity
            .row_iter()
            .zip(solution.matrix().column_iter())
            .map(|(row, column)| {
                row.iter()
                    .zip(column.iter())
                    .map(|(j, m)| j * m)
                    .sum::<f64>()
            })
            .sum();
        let quick = match options.map_error {
            Some(error) if !(error > 0.0 && error < 1.0) => {
                return Err(OneStepError::MapError { error });
            }
            Some(error) if !options.loss_only => {
                let noise = lambda * amplitude;
                let typical = typical(&mesh.region_areas(), &sensitivity, noise);
                let quick = Quick::new(solution.matrix(), &typical, error);
                Some(quick.ok_or(OneStepError::Prior)?)
            }
            _ => None,
        };
        let kept = sensitivity.clone();
        let bounded = match options.loss_only {
            false => None,
            true => Some(Bounded::new(sensitivity, penalty, lambda).ok_or(OneStepError::Prior)?),
        };
        let loss = if options.loss_only { ", loss only" } else { "" };
        Ok(Self {
            method: format!("one-step {}{loss}", options.prior.name()),
            mesh_hash: mesh.hash().to_owned(),
            mesh,
            protocol: protocol.clone(),
            linear,
            lambda,
            amplitude,
            raised,
            deviation,
            degrees,
            noise_figure,
            sensitivity: kept,
            directions: OnceLock::new(),
            solution,
            quick,
            bounded,
        })
    }

    /// The hyper-parameter in use.
    pub fn lambda(&self) -> f64 {
        self.lambda
    }

    /// The noise of one reading for which the rule of [`EXPECTED_CHANGE`] gives this hyper-parameter: V with
    /// [`Scale::Currents`], otherwise V at 1 A.
    pub fn noise(&self) -> f64 {
        self.lambda * self.amplitude / std::f64::consts::SQRT_2
    }

    /// Effective degrees of freedom of the linear map: how many independent components of the readings it uses.
    /// Reciprocal twins count once.
    pub fn degrees_of_freedom(&self) -> f64 {
        self.degrees
    }

    /// Whether the noise would give a smaller lambda than [`MODEL_SHARE`] allows.
    pub fn raised(&self) -> bool {
        self.raised
    }

    /// The reconstruction matrix: region x readings, from a difference at the model's scale to the map. The difference
    /// is in V at 1 A, or in V if currents are known, and multiplied by the reading's weight if readings are weighted.
    pub fn matrix(&self) -> DMatrix<f64> {
        self.linear
            .fold
            .unfold(&self.solution.matrix().transpose())
            .transpose()
    }
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
        let mut notes = vec![
            format!(
                "{}, lambda {:.3e}: linear in the change of conductance, one matrix",
                self.method, self.lambda
            ),
            match self.deviation {
                Some(deviation) => format!(
                    "white noise of {:.2e} (V, or V at 1 A) on each reading, on baseline and frame alike",
                    deviation / std::f64::consts::SQRT_2
                ),
                None => "the hyper-parameter was given; what the noise is was not said".to_owned(),
            },
        ];
        notes.push(format!(
            "{:.1} degrees of freedom of {} different readings",
            self.degrees,
            self.sensitivity.nrows()
        ));
        if self.degrees < 1.0 {
            notes.push(
                "less than one degree of freedom: the hyper-parameter leaves a map of nothing, whatever is pressed".to_owned(),
            );
        }
        if self.raised {
            notes.push(format!(
                "the noise asked for less: a linear model is not exact to more than {MODEL_SHARE:e} of its size"
            ));
        }
        if self.bounded.is_some() {
            notes.push("loads only take conductance away: -1 <= dsigma/sigma0 <= 0".to_owned());
        }
        notes.extend(self.quick.as_ref().map(Quick::description));
        notes
    }

    /// Of the linear map; `None` if maps are bounded to losses, which is not linear.
    fn noise_figure(&self) -> Option<f64> {
        self.bounded.is_none().then_some(self.noise_figure)
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
        let bounded = self
            .bounded
            .as_ref()
            .and_then(|bounded| bounded.solve(&self.linear.fold.seen(&change, &missing)));
        let mut method = self.method.clone();
        let values = match bounded {
            Some(values) => values,
            None => {
                let fold = &self.linear.fold;
                self.solution
                    .impute(fold, &mut change, &missing)
                    .map_err(|fault| numerical(&fault.to_string()))?;
                let data = fold.data(&change);
                let quick = self.quick.as_ref().and_then(|quick| quick.map(&data));
                let mut values =
                    quick.map_or_else(|| self.solution.apply(&data), |(values, _)| values);
                if self.bounded.is_some() {
                    method.push_str(CLIPPED);
                    for value in &mut values {
                        *value = value.clamp(-1.0, 0.0);
                    }
                }
                values
            }
        };
        if values.iter().any(|value| !value.is_finite()) {
            return Err(numerical("the map is not finite"));
        }
        Ok(Map {
            mesh_hash: self.mesh_hash.clone(),
            values,
            unit: MapUnit::RelativeConductance,
            method,
            masked: missing.len(),
            quality: None,
        })
    }
}

/// Typical data for the choice of a rank: some single triangles, each as strong as a small disc with half its
/// conductance lost, with the noise of a difference on every row.
fn typical(areas: &[f64], sensitivity: &DMatrix<f64>, noise: f64) -> DMatrix<f64> {
    const LOADS: usize = 48;
    let area: f64 = areas.iter().sum();
    let disc = (0.5 * noise_figure::LOAD).powi(2) * std::f64::consts::PI * area;
    DMatrix::from_fn(sensitivity.nrows(), LOADS, |row, load| {
        let unknown = (2 * load + 1) * areas.len() / (2 * LOADS);
        // with root mean square 1
        let shake = (1.7 * row as f64 + 2.3 * load as f64).sin() * std::f64::consts::SQRT_2;
        -0.5 * disc / areas[unknown] * sensitivity[(row, unknown)] + noise * shake
    })
}
