//! One-step difference reconstruction: the linear least-squares map, precomputed.
//!
//! x = argmin |W (J x - dv)|^2 + lambda^2 x'Rx  with x = dsigma / sigma0 on the triangles of the region, J the
//! sensitivity to it, R the [`Prior`] and W optional weights of the readings. A frame costs one matrix-vector product.

use std::sync::{Arc, OnceLock};

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use survey::{Map, MapUnit, Protocol, Reading};

use crate::bounded::Bounded;
use crate::data_space::DataSpace;
use crate::linear::Linear;
use crate::prior::{Penalty, Prior};
use crate::{ForwardError, Mesh, Novelty, ReconstructError, Reconstructor, novelty};

/// Where the hyper-parameter comes from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Hyper {
    /// lambda of the formula, given.
    Lambda(f64),
    /// alpha of the paper's Eq. 4 with dv over v-hat, the largest magnitude of the model's readings, and dsigma over
    /// sigma0: lambda = v-hat sqrt(alpha). The paper does not say how it scales either; this is our reading.
    Paper(f64),
    /// From the noise of a single reading, by [`EXPECTED_CHANGE`]'s rule.
    Noise {
        /// Standard deviation of one reading, V, the same on baseline and frame.
        volts: f64,
        /// Injected current, A, at which that noise is met.
        current: f64,
    },
}

/// How the baseline's own scale enters.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Scale {
    /// A factor for each distance round the ring between driving and sensing pair, by least squares: besides what
    /// [`Scale::Uniform`] takes up, the decay with distance of a sheet or tank that is not the model's plane one (depth,
    /// coating, a conductive back). Many readings share each factor, so offsets and noise of single ones do not enter.
    /// A distance that the model does not explain within a factor of [`UNEXPLAINED`] keeps the uniform one.
    #[default]
    ByDistance,
    /// One factor for all readings, by least squares: a uniform fit of sigma0, or of an unknown current.
    Uniform,
    /// Conductance and currents are known: the formula as it stands, with these currents (A), one a reading.
    Currents(Vec<f64>),
}

/// Beyond this factor from the uniform fit a distance is not scaled on its own.
pub const UNEXPLAINED: f64 = 4.0;

/// What the method of a map ends with where the bounded problem could not be solved, and the map is the unbounded one
/// clipped to -1 <= x <= 0.
pub const CLIPPED: &str = " (unbounded map, clipped)";

/// Settings of a [`OneStep`].
#[derive(Debug, Clone, PartialEq)]
pub struct OneStepOptions {
    /// The prior.
    pub prior: Prior,
    /// The hyper-parameter.
    pub hyper: Hyper,
    /// Bounds the map to -1 <= x <= 0: loads only take conductance away. Diagonal priors only.
    pub loss_only: bool,
    /// The baseline's scale.
    pub scale: Scale,
    /// Relative standard deviation of each reading (any common factor), where they differ; readings are divided by it
    /// after scaling it to a root mean square of 1.
    pub deviations: Option<Vec<f64>>,
}

impl Default for OneStepOptions {
    /// NOSER with p = 0.25, which finds presses of 10 mm with the least bias (p = 0.5 draws them by 2 mm towards the
    /// middle of the sheet), for 2 uV of noise at 1 mA.
    fn default() -> Self {
        Self {
            prior: Prior::Noser { p: 0.25 },
            hyper: Hyper::Noise {
                volts: 2e-6,
                current: 1e-3,
            },
            loss_only: false,
            scale: Scale::default(),
            deviations: None,
        }
    }
}

/// Why a one-step reconstruction cannot be prepared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OneStepError {
    /// The forward model refused.
    #[error("the forward model of the reconstruction")]
    Forward(#[from] ForwardError),
    /// The hyper-parameter is not positive, or vanishes beside the sensitivities.
    #[error(
        "the hyper-parameter lambda is {lambda:e}; it must be a finite number above {floor:.1e} for this geometry"
    )]
    Lambda {
        /// As given or chosen.
        lambda: f64,
        /// The smallest that double precision can tell from zero here.
        floor: f64,
    },
    /// A noise or a current that is not a positive number.
    #[error("the {what} is {value:e}; it must be a positive number")]
    NotPositive {
        /// Which setting.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A list does not have one entry a reading.
    #[error("{has} {what} for {wants} readings")]
    Count {
        /// Which list.
        what: &'static str,
        /// Entries it has.
        has: usize,
        /// Entries it needs.
        wants: usize,
    },
    /// The prior could not be inverted, or the readings do not determine its null space.
    #[error(
        "the prior cannot be inverted on this geometry: some part of the region is seen by no reading"
    )]
    Prior,
    /// Bounds are only there for diagonal priors.
    #[error("loss_only needs a diagonal prior (tikhonov or noser), not laplace")]
    BoundedPrior,
}

/// Root mean square over the region of the relative change that a map is expected to have: a disc of 10 mm with half its
/// conductance lost, somewhere on the region of the paper's sheet (0.5 sqrt(78.5 mm^2 / 33,870 mm^2)). It is the one
/// constant of the rule that turns noise into lambda:
///
/// lambda = s / g, with s = sqrt(2) volts / current, the noise of a difference at 1 A, and g such that the prior
/// N(0, g^2 R^-1) has this root mean square over the region: the maximum a posteriori estimate for that noise.
///
/// The rule looks at noise, geometry and prior, never at a frame. Half or double the constant changes Test #1 by less
/// than half a millimetre.
pub const EXPECTED_CHANGE: f64 = 0.024;

/// Share of the model's size (the Frobenius norm of J R^-1/2) below which lambda is not taken from the noise: the linear
/// model is not exact to more than that, however quiet the readings are. On the paper's sheet it is the noise of some
/// 0.2 uV at 1 mA. A lambda that is given is used as it is.
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
    noise_figure: f64,
    sensitivity: DMatrix<f64>,
    /// Directions of the data that maps move; found when novelty is first asked for.
    directions: OnceLock<Option<DMatrix<f64>>>,
    solution: DataSpace,
    bounded: Option<Bounded>,
}

impl OneStep {
    /// Solves the forward model at `sigma0` (S per square, one a triangle of the mesh) and factors once.
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
        let amplitude = penalty.amplitude(EXPECTED_CHANGE)?;
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
                let spread = penalty
                    .inverse_times_transposed(&sensitivity)
                    .ok_or(OneStepError::Prior)?;
                let size = sensitivity.transpose().dot(&spread).sqrt();
                let least = MODEL_SHARE * size;
                (lambda.max(least), lambda < least)
            }
        };
        let solution = DataSpace::new(&sensitivity, &penalty, lambda)?;
        let deviation = match (options.hyper, &options.scale) {
            (Hyper::Noise { volts, .. }, Scale::Currents(_)) => Some(volts),
            (Hyper::Noise { volts, current }, _) => Some(volts / current),
            _ => None,
        }
        .map(|noise| std::f64::consts::SQRT_2 * noise);
        let noise_figure = figure(&mesh, &sensitivity, solution.matrix());
        let kept = sensitivity.clone();
        let bounded = match (options.loss_only, penalty) {
            (false, _) => None,
            (true, Penalty::Diagonal(entries)) => {
                Some(Bounded::new(sensitivity, entries, lambda).ok_or(OneStepError::Prior)?)
            }
            (true, Penalty::Laplacian { .. }) => return Err(OneStepError::BoundedPrior),
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
            noise_figure,
            sensitivity: kept,
            directions: OnceLock::new(),
            solution,
            bounded,
        })
    }

    /// The hyper-parameter in use.
    pub fn lambda(&self) -> f64 {
        self.lambda
    }

    /// The noise of one reading for which the rule of [`EXPECTED_CHANGE`] gives this hyper-parameter: V with
    /// [`Scale::Currents`], else V at 1 A.
    pub fn noise(&self) -> f64 {
        self.lambda * self.amplitude / std::f64::consts::SQRT_2
    }

    /// Whether the noise asked for a smaller lambda than [`MODEL_SHARE`] allows.
    pub fn raised(&self) -> bool {
        self.raised
    }

    /// The reconstruction matrix: region x readings, from a difference at the model's scale to the map.
    pub fn matrix(&self) -> &DMatrix<f64> {
        self.solution.matrix()
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
        let mut told = vec![
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
        if self.raised {
            told.push(format!(
                "the noise asked for less: a linear model is not exact to more than {MODEL_SHARE:e} of its size"
            ));
        }
        if self.bounded.is_some() {
            told.push("loads only take conductance away: -1 <= dsigma/sigma0 <= 0".to_owned());
        }
        told
    }

    /// Of the linear map; where maps are bounded to losses, of the map before the bound.
    fn noise_figure(&self) -> Option<f64> {
        Some(self.noise_figure)
    }

    fn novelty(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Option<Novelty>, ReconstructError> {
        let (mut change, missing) = self.linear.change(baseline, frame, &self.method)?;
        let Some(deviation) = self.deviation else {
            return Ok(None); // nobody said what the noise is
        };
        for value in &mut change {
            *value /= deviation;
        }
        let directions = self
            .directions
            .get_or_init(|| novelty::directions(&(&self.sensitivity / deviation)));
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
            .and_then(|bounded| bounded.solve(&change, &missing));
        let mut method = self.method.clone();
        let values = match bounded {
            Some(values) => values,
            None => {
                self.solution
                    .impute(&mut change, &missing)
                    .map_err(|fault| numerical(&fault.to_string()))?;
                let mut values = self.solution.apply(&change);
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
        })
    }
}

/// Diameter of the load that a noise figure is told for, as a share of the square root of the region's area.
const FIGURE_LOAD: f64 = 0.0543;

/// The noise figure of the linear map M (A. Adler, R. Guardo, IEEE Trans. Med. Imaging 15 (1996) 170): mean |y| over the
/// noise of a reading, over mean |a M y| over the root mean square of its noise, a the areas, y the readings of a small
/// disc in the middle of the region.
fn figure(mesh: &Mesh, sensitivity: &DMatrix<f64>, map: &DMatrix<f64>) -> f64 {
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    let area: f64 = areas.iter().sum();
    let middle = [0, 1].map(|axis| {
        centroids
            .iter()
            .zip(&areas)
            .map(|(at, a)| at[axis] * a)
            .sum::<f64>()
            / area
    });
    let away = |at: &[f64; 2]| (at[0] - middle[0]).hypot(at[1] - middle[1]);
    let radius = (0.5 * FIGURE_LOAD * area.sqrt())
        .max(centroids.iter().map(away).fold(f64::INFINITY, f64::min));
    let load = DVector::from_iterator(
        centroids.len(),
        centroids
            .iter()
            .map(|at| f64::from(u8::from(away(at) <= radius))),
    );
    let seen = sensitivity * load;
    let answer = map * &seen;
    let mut noise = vec![0.0; areas.len()];
    for column in map.column_iter() {
        for (sum, value) in noise.iter_mut().zip(&column) {
            *sum += value * value;
        }
    }
    let readings = seen.iter().map(|y| y.abs()).sum::<f64>() / seen.len() as f64;
    let unknowns = areas.len() as f64;
    let signal = answer
        .iter()
        .zip(&areas)
        .map(|(x, a)| (x * a).abs())
        .sum::<f64>()
        / unknowns;
    let spread = noise
        .iter()
        .zip(&areas)
        .map(|(n, a)| n * a * a)
        .sum::<f64>()
        / unknowns;
    readings * spread.sqrt() / signal
}
