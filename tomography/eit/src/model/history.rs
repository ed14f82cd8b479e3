//! Training record of a network, as stored in its model file: settings, jitter and results. Choices that the paper
//! leaves open are settings ([`OpenChoices`]). The training itself is in the crate `training`.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Settings of a training; the defaults are the paper's (section 5.3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainingSettings {
    /// C: simulated cases.
    pub cases: usize,
    /// S: jittered copies of each.
    pub repeats: usize,
    /// P: maximum number of polygons per case.
    pub polygons: usize,
    /// R_p: largest radius of the circle round a polygon, m.
    pub radius_m: f64,
    /// K_p: maximum number of vertices.
    pub vertices: usize,
    /// The jitter.
    pub jitter: Jitter,
    /// N: neurons.
    pub neurons: usize,
    /// Width of the neurons as a multiple of Eq. 13's spread.
    #[serde(skip_serializing_if = "is_one")]
    pub spread_times: f64,
    /// The same seed gives the same network.
    pub seed: u64,
    /// Choices that the paper leaves open.
    #[serde(skip_serializing_if = "OpenChoices::is_default")]
    pub open: OpenChoices,
}

impl Default for TrainingSettings {
    fn default() -> Self {
        Self {
            cases: 15_000,
            repeats: 5,
            polygons: 4,
            radius_m: 0.070,
            vertices: 5,
            jitter: Jitter::paper(),
            neurons: 100,
            spread_times: 1.0,
            seed: 1,
            open: OpenChoices::default(),
        }
    }
}

fn is_one(value: &f64) -> bool {
    *value == 1.0
}

/// Results of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainingReport {
    /// Cases in which no triangle changed.
    pub unchanged: usize,
    /// Standard deviation of the jitter, in units of the normalised input.
    pub jitter: f64,
    /// Rounds of k-means.
    pub rounds: usize,
    /// Clusters that became empty and were re-initialised.
    pub reseeded: usize,
    /// b of Eq. 13.
    pub spread: f64,
    /// b over the median distance of two samples; above 10, a few samples dominate it.
    pub spread_over_median: f64,
    /// Distance from the nearest centre, in spreads, within which 99.9 % of the samples lie.
    pub familiar: f64,
    /// Directions of Phi that were kept.
    pub rank: usize,
    /// Condition number of Phi.
    pub condition: f64,
    /// Largest entry of W.
    pub largest_weight: f64,
}

/// Choices that the paper leaves open, each with its default.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OpenChoices {
    /// What R_p measures.
    pub size: SizeChoice,
    /// How many points are drawn on a circle.
    pub points: PointsChoice,
    /// How often a loss is drawn.
    pub loss: LossChoice,
    /// Where centres lie.
    pub centres: CentresChoice,
    /// The divisor of Eq. 7.
    pub change: ChangeChoice,
    /// The meaning of the second argument of N(0, .) in Eq. 9.
    pub spread: SpreadChoice,
    /// The samples whose distances enter Eq. 13.
    pub distances: DistancesChoice,
}

impl OpenChoices {
    /// Whether every choice is the default.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// R_p = 70 mm: "radius size of a circumference" (section 4.1) or "maximum size of the polygons" (section 5.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SizeChoice {
    /// The circle's largest radius (default).
    #[default]
    Radius,
    /// The polygon's largest size: the circle's diameter.
    Diameter,
}

/// Algorithm 1 draws a number of edges and then selects "K_p random points".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PointsChoice {
    /// As many points as edges drawn, 0 to K_p; fewer than three give no polygon (default).
    #[default]
    Drawn,
    /// Always K_p points.
    All,
}

/// "Reduce the conductivity of each polygonal region of a random value", and "by a random value ... for each case".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LossChoice {
    /// One per polygon; the remaining conductances multiply where polygons overlap (default).
    #[default]
    Polygon,
    /// One for all polygons of a case; overlaps do not increase the loss.
    Case,
}

/// "A random location on the sensing surface", and "random polygons within a rectangular region of interest".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CentresChoice {
    /// Uniform over the region of interest (default).
    #[default]
    Region,
    /// Uniform over the whole sheet; the loss still ends at the border of the region.
    Sheet,
}

/// Eq. 7 is a difference of conductivities; figures and Eq. 6 suggest a relative one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ChangeChoice {
    /// dsigma / sigma0 of each triangle (default).
    #[default]
    Relative,
    /// dsigma over the mean sigma0 of the region: absolute up to one factor. The same on a uniform sheet.
    Absolute,
}

/// N(0, gamma std(v0 / v-hat)).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SpreadChoice {
    /// A standard deviation (default).
    #[default]
    Deviation,
    /// A variance.
    Variance,
}

/// "Distances between all the possible combinations" of delta v-tilde.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DistancesChoice {
    /// Of samples with jitter, as the tilde indicates (default).
    #[default]
    Jittered,
    /// Of samples without jitter.
    Clean,
}

/// The noise added to the inputs in training (Eq. 8).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "profile", rename_all = "snake_case")]
pub enum Jitter {
    /// Eq. 9: a standard deviation of gamma times that of the normalised baseline, the same for every reading.
    Paper {
        /// gamma, 0.01 in the paper.
        gamma: f64,
    },
    /// Noise of a measurement: white, on baseline and frame.
    Matched {
        /// Standard deviation of one reading, V.
        noise_v: f64,
        /// Injected current to which `noise_v` refers, A.
        current_a: f64,
    },
    /// Several levels of [`Jitter::Matched`]: the copies of a case use them in turn.
    Levels {
        /// Standard deviations of one reading, V.
        noise_v: Vec<f64>,
        /// Injected current to which `noise_v` refers, A.
        current_a: f64,
    },
    /// The measured covariance of repeats of the baseline: a copy's noise is a random combination of the repeats'
    /// deviations from their mean, on baseline and frame. It has the repeats' sample covariance.
    Measured {
        /// The measured repeats, each a row of readings, V.
        volts: Vec<Vec<f64>>,
        /// Injected current of the measurement, A.
        current_a: f64,
    },
    /// White noise on baseline and frame, and drift of the sheet between them: a copy's drift is a random combination of rows.
    Drift {
        /// Standard deviation of one reading due to noise, V.
        noise_v: f64,
        /// Injected current to which noise and drift refer, A.
        current_a: f64,
        /// The rows, each a change of the readings, V: the sum of their products with themselves is the drift's covariance.
        drift_v: Vec<Vec<f64>>,
    },
}

impl Jitter {
    /// Eq. 9 with the paper's gamma.
    pub fn paper() -> Self {
        Self::Paper { gamma: 0.01 }
    }

    /// White noise of 2 uV at 1 mA.
    pub fn matched() -> Self {
        Self::Matched {
            noise_v: 2e-6,
            current_a: 1e-3,
        }
    }
}

impl fmt::Display for Jitter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let microvolts = |volts: &f64| format!("{:.3} uV", 1e6 * volts);
        match self {
            Self::Paper { gamma } => write!(f, "the paper's, gamma {gamma}"),
            Self::Matched { noise_v, current_a } => {
                write!(
                    f,
                    "{} white at {:.3} mA",
                    microvolts(noise_v),
                    1e3 * current_a
                )
            }
            Self::Levels { noise_v, current_a } => {
                let levels: Vec<String> = noise_v.iter().map(microvolts).collect();
                write!(
                    f,
                    "{} white at {:.3} mA",
                    levels.join(", "),
                    1e3 * current_a
                )
            }
            Self::Measured { volts, .. } => write!(f, "as measured on {} repeats", volts.len()),
            Self::Drift {
                noise_v,
                current_a,
                drift_v,
            } => write!(
                f,
                "{} white at {:.3} mA, with drift of {} independent kinds",
                microvolts(noise_v),
                1e3 * current_a,
                drift_v.len()
            ),
        }
    }
}
