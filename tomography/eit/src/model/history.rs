//! How a network was trained, as its model file keeps it: settings, jitter, and what the training found. Where the paper's
//! text leaves a choice it is a setting ([`OpenReadings`]). The training itself is in the crate `training`.

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
    /// P: at most so many polygons a case.
    pub polygons: usize,
    /// R_p: largest radius of the circle round a polygon, m.
    pub radius_m: f64,
    /// K_p: at most so many vertices.
    pub vertices: usize,
    /// The jitter.
    pub jitter: Jitter,
    /// N: neurons.
    pub neurons: usize,
    /// Width of the neurons in times of Eq. 13's spread.
    #[serde(skip_serializing_if = "is_one")]
    pub spread_times: f64,
    /// The same seed gives the same network.
    pub seed: u64,
    /// How the paper's text is read where it is open.
    #[serde(skip_serializing_if = "OpenReadings::is_default")]
    pub open: OpenReadings,
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
            open: OpenReadings::default(),
        }
    }
}

fn is_one(value: &f64) -> bool {
    *value == 1.0
}

/// What a training found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainingReport {
    /// Cases in which no triangle changed.
    pub unchanged: usize,
    /// Standard deviation of the jitter, in units of the normalised input.
    pub jitter: f64,
    /// Rounds of k-means.
    pub rounds: usize,
    /// Clusters that ran empty and were begun again.
    pub reseeded: usize,
    /// b of Eq. 13.
    pub spread: f64,
    /// b over the median distance of two samples; above 10 a few samples rule it.
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

/// What the paper's text leaves open, each with the reading that is taken where nothing is said.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OpenReadings {
    /// What R_p measures.
    pub size: SizeReading,
    /// How many points are drawn on a circle.
    pub points: PointsReading,
    /// How often a loss is drawn.
    pub loss: LossReading,
    /// Where centres lie.
    pub centres: CentresReading,
    /// What Eq. 7 divides by.
    pub change: ChangeReading,
    /// What the second argument of N(0, .) in Eq. 9 is.
    pub spread: SpreadReading,
    /// Which samples Eq. 13 takes distances of.
    pub distances: DistancesReading,
}

impl OpenReadings {
    /// Whether every reading is the default.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// R_p = 70 mm: "radius size of a circumference" (section 4.1) or "maximum size of the polygons" (section 5.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SizeReading {
    /// The circle's largest radius (default).
    #[default]
    Radius,
    /// The polygon's largest size: the circle's diameter.
    Diameter,
}

/// Algorithm 1 draws a number of edges, then says "select K_p random points".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PointsReading {
    /// As many points as edges were drawn, 0 to K_p; under three make no polygon (default).
    #[default]
    Drawn,
    /// K_p points always.
    All,
}

/// "Reduce the conductivity of each polygonal region of a random value", and "by a random value ... for each case".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LossReading {
    /// One for each polygon; where polygons overlap, what is left multiplies (default).
    #[default]
    Polygon,
    /// One for all polygons of a case; overlaps lose no more.
    Case,
}

/// "A random location on the sensing surface", and "random polygons within a rectangular region of interest".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CentresReading {
    /// Uniform over the region of interest (default).
    #[default]
    Region,
    /// Uniform over the whole sheet; the loss still ends at the region's border.
    Sheet,
}

/// Eq. 7 is a difference of conductivities; figures and Eq. 6 suggest a relative one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ChangeReading {
    /// dsigma / sigma0 of each triangle (default).
    #[default]
    Relative,
    /// dsigma over the mean sigma0 of the region: absolute but for one factor. The same on a uniform sheet.
    Absolute,
}

/// N(0, gamma std(v0 / v-hat)).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SpreadReading {
    /// A standard deviation (default).
    #[default]
    Deviation,
    /// A variance: the deviation is its root.
    Variance,
}

/// "Distances between all the possible combinations" of delta v-tilde.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DistancesReading {
    /// Of samples with jitter, as the tilde says (default).
    #[default]
    Jittered,
    /// Of samples without.
    Clean,
}

/// The noise that training adds to the inputs (Eq. 8).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "profile", rename_all = "snake_case")]
pub enum Jitter {
    /// Eq. 9: a standard deviation of gamma times that of the normalised baseline, on every reading alike.
    Paper {
        /// gamma, 0.01 in the paper.
        gamma: f64,
    },
    /// As the noise is: white, on baseline and frame.
    Matched {
        /// Standard deviation of one reading, V.
        noise_v: f64,
        /// Injected current at which it is met, A.
        current_a: f64,
    },
    /// Several levels of [`Jitter::Matched`]: the copies of a case take them in turn.
    Levels {
        /// Standard deviations of one reading, V.
        noise_v: Vec<f64>,
        /// Injected current at which they are met, A.
        current_a: f64,
    },
    /// The measured covariance of repeats of the baseline: a copy's noise is a random combination of the repeats'
    /// deviations from their mean, on baseline and frame. It has the repeats' sample covariance.
    Measured {
        /// How many repeats were measured, each one a row of readings, V.
        volts: Vec<Vec<f64>>,
        /// Injected current at which they were measured, A.
        current_a: f64,
    },
}

impl Jitter {
    /// The paper's value.
    pub fn paper() -> Self {
        Self::Paper { gamma: 0.01 }
    }

    /// 2 uV at 1 mA.
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
        }
    }
}
