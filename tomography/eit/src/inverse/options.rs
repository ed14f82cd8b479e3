//! Settings of the linear methods: prior, hyper-parameter, scale of the baseline.

use serde::{Deserialize, Serialize};

use crate::inverse::prior::{ONE_STEP_NOSER, Prior};

/// Where the hyper-parameter comes from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Hyper {
    /// lambda of the formula, given.
    Lambda(f64),
    /// alpha of the paper's Eq. 4 with dv over v-hat, the largest magnitude of the model's readings, and dsigma over
    /// sigma0: lambda = v-hat sqrt(alpha). The paper does not say how it scales either; this is our reading.
    Paper(f64),
    /// From the noise of a single reading, by [`EXPECTED_CHANGE`](crate::EXPECTED_CHANGE)'s rule.
    Noise {
        /// Standard deviation of one reading, V, the same on baseline and frame.
        volts: f64,
        /// Injected current, A, at which that noise is met.
        current: f64,
    },
    /// The lambda at which the linear map has this noise figure, see [`Reconstructor::noise_figure`](crate::Reconstructor::noise_figure).
    NoiseFigure(f64),
}

/// How the baseline's own scale enters.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Scale {
    /// A factor for each distance round the ring between driving and sensing pair, by least squares: besides what
    /// [`Scale::Uniform`] takes up, the decay with distance of a sheet or tank that is not the model's plane one (depth,
    /// coating, a conductive back). Many readings share each factor, so offsets and noise of single ones do not enter.
    /// A distance that the model does not explain within a factor of [`UNEXPLAINED`](crate::UNEXPLAINED) keeps the uniform one.
    #[default]
    ByDistance,
    /// One factor for all readings, by least squares: a uniform fit of sigma0, or of an unknown current.
    Uniform,
    /// Conductance and currents are known: the formula as it stands, with these currents (A), one a reading.
    Currents(Vec<f64>),
}

/// Settings of a [`OneStep`](crate::OneStep).
#[derive(Debug, Clone, PartialEq)]
pub struct OneStepOptions {
    /// The prior.
    pub prior: Prior,
    /// The hyper-parameter.
    pub hyper: Hyper,
    /// Bounds the map to -1 <= x <= 0: loads only take conductance away.
    pub loss_only: bool,
    /// The baseline's scale.
    pub scale: Scale,
    /// Relative standard deviation of each reading (any common factor), where they differ; readings are divided by it
    /// after scaling it to a root mean square of 1.
    pub deviations: Option<Vec<f64>>,
    /// A quicker frame, by a factor of low rank in f32: the largest error of a map that it may cost, as a share of the
    /// map's largest value (1e-3 is invisible). Frames that cannot be proved to keep it get the whole matrix. `None`: the
    /// whole matrix always. Maps bounded to losses are not linear and do not use it.
    pub map_error: Option<f64>,
}

impl Default for OneStepOptions {
    /// NOSER with p = 0.25, which finds presses of 10 mm with the least bias (p = 0.5 draws them by 2 mm towards the
    /// middle of the sheet), for 2 uV of noise at 1 mA.
    fn default() -> Self {
        Self {
            prior: ONE_STEP_NOSER,
            hyper: Hyper::Noise {
                volts: 2e-6,
                current: 1e-3,
            },
            loss_only: false,
            scale: Scale::default(),
            deviations: None,
            map_error: None,
        }
    }
}
