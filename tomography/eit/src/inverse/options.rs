//! Settings of the linear methods: prior, hyper-parameter, scale of the baseline.

use serde::{Deserialize, Serialize};

use crate::inverse::prior::{ONE_STEP_NOSER, Prior};

/// Default standard deviation of one reading, V: a bench multimeter on its 1 V range at one power-line cycle.
pub const DEFAULT_NOISE_V: f64 = 2e-6;

/// Source of the hyper-parameter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Hyper {
    /// A given lambda.
    Lambda(f64),
    /// alpha of the paper's Eq. 4 with dv over v-hat, the largest magnitude of the model's readings, and dsigma over
    /// sigma0: lambda = v-hat sqrt(alpha). The paper does not state either scaling; these are our choices.
    Paper(f64),
    /// From the noise of a single reading, by the rule of [`EXPECTED_CHANGE`](crate::EXPECTED_CHANGE).
    Noise {
        /// Standard deviation of one reading, V, the same in baseline and frame.
        volts: f64,
        /// Injected current to which `volts` refers, A.
        current: f64,
    },
    /// The lambda at which the linear map has this noise figure, see
    /// [`Reconstructor::noise_figure`](crate::Reconstructor::noise_figure).
    NoiseFigure(f64),
    /// A lambda for each frame, from the frame itself.
    Frame {
        /// Rule that derives lambda from the frame.
        rule: HyperRule,
        /// Standard deviation of one reading, V, the same in baseline and frame: lower limit of the estimated errors of
        /// a frame. `None` if unknown.
        volts: Option<f64>,
        /// Injected current to which `volts` refers, A.
        current: f64,
    },
}

/// Rule that derives lambda from a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HyperRule {
    /// The most probable lambda: with x ~ N(0, g^2 R^-1) and white errors s, a change is N(0, g^2 J R^-1 J' + s^2 I),
    /// and lambda = s / g. The errors are at least the noise and the linear model's error, which is 1 % of the change,
    /// and more if the change is not small compared with the readings.
    #[default]
    Evidence,
    /// The corner of the frame's L-curve (P. C. Hansen, SIAM Review 34 (1992) 561); if it has no corner,
    /// [`Self::Evidence`].
    LCurve,
}

/// How the baseline is scaled to the model.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Scale {
    /// A factor for each distance round the ring between driving and sensing pair, by least squares. Besides the factor
    /// of [`Scale::Uniform`] it corrects a decay with distance that differs from the plane model's (depth of a tank, a
    /// coating, a conductive back). Many readings share each factor, so single offsets and noise hardly matter. A
    /// distance whose factor differs from the uniform one by more than [`LARGEST_SCALE_RATIO`](crate::LARGEST_SCALE_RATIO) keeps the
    /// uniform one.
    #[default]
    ByDistance,
    /// One factor for all readings, by least squares: corrects sigma0, or an unknown current.
    Uniform,
    /// No scaling: conductance and currents (A, one per reading) are known.
    Currents(Vec<f64>),
}

impl Scale {
    /// Standard deviation of a reading's change, in the unit of the data, from the standard deviation of one reading
    /// (V) at a current (A).
    pub(crate) fn deviation(&self, volts: f64, current: f64) -> f64 {
        std::f64::consts::SQRT_2
            * match self {
                Self::ByDistance | Self::Uniform => volts / current,
                Self::Currents(_) => volts,
            }
    }
}

/// Settings of a [`OneStep`](crate::OneStep).
#[derive(Debug, Clone, PartialEq)]
pub struct OneStepOptions {
    /// The prior.
    pub prior: Prior,
    /// The hyper-parameter.
    pub hyper: Hyper,
    /// Bounds the map to -1 <= x <= 0: loads only reduce conductance.
    pub loss_only: bool,
    /// With `loss_only`, the largest share of a frame's squared change that the bounded map may leave unexplained, in
    /// addition to the share left by the unbounded map. A frame that exceeds it shows gains, and its map is not
    /// bounded. `None`: every map is bounded.
    pub most_gain: Option<f64>,
    /// The baseline's scale.
    pub scale: Scale,
    /// Relative standard deviation of each reading (any common factor) if they differ; each reading is divided by its
    /// deviation, scaled to root mean square 1.
    pub deviations: Option<Vec<f64>>,
    /// Largest allowed error of a map, as a share of its largest value (1e-3 is invisible), for faster frames by a
    /// low-rank factor in f32. A frame that is not proven to meet it uses the full matrix. `None`: always the full
    /// matrix. Maps bounded to losses are not linear and ignore it.
    pub map_error: Option<f64>,
    /// The unknowns that maps show, as indices into the mesh's region; the rules for the hyper-parameter use only
    /// these. `None`: all of them. See [`WholeSheet`](crate::WholeSheet).
    pub shown: Option<Vec<usize>>,
}

impl Default for OneStepOptions {
    /// For 2 uV of noise at 1 mA: NOSER with p = 0.25, which locates presses of 10 mm with the least bias (p = 0.5
    /// shifts them by 2 mm towards the middle of the sheet).
    fn default() -> Self {
        Self {
            prior: ONE_STEP_NOSER,
            hyper: Hyper::Noise {
                volts: DEFAULT_NOISE_V,
                current: 1e-3,
            },
            loss_only: false,
            most_gain: None,
            scale: Scale::default(),
            deviations: None,
            map_error: None,
            shown: None,
        }
    }
}
