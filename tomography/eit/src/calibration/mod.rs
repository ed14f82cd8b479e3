//! From relative loss of conductance to pressure: a monotone curve, and a gain over the position.
//!
//! A method's map of a press depends on the press, its position and the method: it is blurred, and weaker where the
//! readings are less sensitive. A calibration therefore belongs to one mesh and one method, and is fitted to that
//! method's maps of presses of known mass and area. The curve is piecewise linear with non-negative increments, so that
//! a map's total force (newtons) and its pressure under the press (kPa) are both linear in the increments: a bounded
//! least-squares problem, small enough for coordinate descent. The gain is a second-degree polynomial over the region,
//! fitted to the ratios of estimated to true force over the positions. Curve and gain are fitted alternately.

mod fit;

use serde::{Deserialize, Serialize};
use survey::{Map, MapUnit};

use crate::Mesh;

/// Value of the field `kind` of a calibration file.
pub const CALIBRATION_KIND: &str = "tactus-calibration-1";
/// Fewest presses for a calibration.
pub const FEWEST_PRESSES: usize = 6;
/// Fewest different pressures for a curve.
pub const FEWEST_PRESSURES: usize = 3;
/// Relative deviation (rms) from the fitted curve above which the presses contradict each other.
pub const CONTRADICTION: f64 = 0.35;
/// Terms of the gain: x, y, x^2, x y, y^2 over the region's half extents.
const TERMS: usize = 5;
/// Lowest and highest gain.
const GAIN: [f64; 2] = [0.2, 5.0];

/// A press of known mass, and a method's map of it.
#[derive(Debug, Clone)]
pub struct KnownPress {
    /// User-readable name.
    pub name: String,
    /// The map, relative.
    pub map: Map,
    /// Centre, m.
    pub centre: [f64; 2],
    /// Contact area, m2; taken as a disc.
    pub area: f64,
    /// Force, N.
    pub newtons: f64,
}

/// Relative loss to kPa, for one mesh and one method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// [`CALIBRATION_KIND`].
    pub kind: String,
    /// Hash of the mesh that it was fitted on.
    pub mesh: String,
    /// The method whose maps it was fitted to.
    pub method: String,
    /// Knots: relative loss of conductance over the gain, ascending; pressure begins at the first.
    pub loss: Vec<f64>,
    /// Pressure at the knots, kPa, non-decreasing.
    pub kpa: Vec<f64>,
    /// Centre of the region and its half extents, m: origin and units of the gain's x and y.
    pub frame: [f64; 4],
    /// Gain: exp of these times x, y, x^2, x y, y^2.
    pub gain: [f64; TERMS],
    /// Number of presses in the fit.
    pub presses: usize,
    /// Root mean square of (estimated - true) / true force over the presses.
    pub rms: f64,
}

/// Errors of a calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// Too few presses.
    #[error(
        "{found} presses are too few for a calibration; {FEWEST_PRESSES} are needed, at {FEWEST_PRESSURES} pressures or more"
    )]
    TooFew {
        /// How many there are.
        found: usize,
    },
    /// Too few different pressures.
    #[error(
        "the presses have {found} different pressures; a curve needs {FEWEST_PRESSURES} (two within 5 % count as one)"
    )]
    OnePressure {
        /// How many there are.
        found: usize,
    },
    /// A measure of a press that is not a positive number.
    #[error("press '{name}': {what} is {value}, it must be a positive number")]
    Measure {
        /// Its name.
        name: String,
        /// Which measure.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A press that its map does not show.
    #[error(
        "press '{name}' ({newtons:.1} N) shows no loss in its map: is it the right frame, and is the press inside the region?"
    )]
    Unseen {
        /// Its name.
        name: String,
        /// Its force.
        newtons: f64,
    },
    /// Maps of several methods.
    #[error(
        "the map of '{first}' is by '{method}', that of '{other}' by '{another}'; a calibration needs maps of one method: choose one that \
         does not change from frame to frame, such as one-step or tv"
    )]
    Methods {
        /// The first press.
        first: String,
        /// Its map's method.
        method: String,
        /// A press with a map of another method.
        other: String,
        /// That method.
        another: String,
    },
    /// The presses do not lie on one curve.
    #[error(
        "the presses contradict each other: no single curve fits them within {limit:.0} % (rms {rms:.0} %); the worst is '{worst}', \
         {found:.1} N by the curve and {newtons:.1} N by its mass. Check masses, areas and places"
    )]
    Contradictory {
        /// Largest deviation allowed, %.
        limit: f64,
        /// Deviation found, %.
        rms: f64,
        /// The press that fits worst.
        worst: String,
        /// Force by the curve, N.
        found: f64,
        /// Force by its mass, N.
        newtons: f64,
    },
    /// A file that is not a calibration, or a map of another mesh or method.
    #[error("the calibration does not fit: {0}")]
    Other(String),
}

impl Calibration {
    /// Fits curve and gain to presses of one method on one mesh.
    ///
    /// # Errors
    /// Too few presses or pressures, a measure that is not positive, a press that its map does not show, maps of
    /// several methods, presses that contradict each other.
    pub fn fit(mesh: &Mesh, presses: &[KnownPress]) -> Result<Self, CalibrationError> {
        fit::fit(mesh, presses)
    }

    /// Checks the values read from a file.
    ///
    /// # Errors
    /// The first fault found.
    pub fn check(&self) -> Result<(), CalibrationError> {
        let refuse = |why: &str| Err(CalibrationError::Other(why.to_owned()));
        if self.kind != CALIBRATION_KIND {
            return Err(CalibrationError::Other(format!(
                "kind is '{}', '{CALIBRATION_KIND}' is expected",
                self.kind
            )));
        }
        if self.loss.len() < 2 || self.loss.len() != self.kpa.len() {
            return refuse("loss and kpa must have the same number of knots, two or more");
        }
        let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
        if !(finite(&self.loss) && finite(&self.kpa) && finite(&self.frame) && finite(&self.gain)) {
            return refuse("a number is not finite");
        }
        if !self.loss.windows(2).all(|pair| pair[0] < pair[1]) || self.loss[0] < 0.0 {
            return refuse("the knots of loss must ascend from 0 or more");
        }
        if self.kpa[0] != 0.0 || !self.kpa.windows(2).all(|pair| pair[0] <= pair[1]) {
            return refuse("kpa must begin with 0, the pressure without a load, and never fall");
        }
        if !(self.frame[2] > 0.0 && self.frame[3] > 0.0) {
            return refuse("the half extents in frame must be positive");
        }
        Ok(())
    }

    /// Converts a relative map to pressure, kPa; gains of conductance give zero.
    ///
    /// # Errors
    /// A map of another mesh or method, or one that is not a relative change.
    pub fn pressure(&self, mesh: &Mesh, map: &Map) -> Result<Pressure, CalibrationError> {
        check(mesh, map)?;
        if map.mesh_hash != self.mesh {
            return Err(CalibrationError::Other(
                "it was fitted on another mesh".to_owned(),
            ));
        }
        if map.method != self.method {
            return Err(CalibrationError::Other(format!(
                "it was fitted to maps of '{}', this one is of '{}'",
                self.method, map.method
            )));
        }
        let centroids = mesh.region_centroids();
        let kpa: Vec<f64> = map
            .values
            .iter()
            .zip(&centroids)
            .map(|(value, centroid)| self.at(-value / gain_at(&self.gain, &self.frame, *centroid)))
            .collect();
        let newtons = kpa
            .iter()
            .zip(mesh.region_areas())
            .map(|(kpa, area)| 1e3 * kpa * area)
            .sum();
        Ok(Pressure { kpa, newtons })
    }

    /// The curve; beyond its last knot its last piece is extended.
    fn at(&self, loss: f64) -> f64 {
        let last = self.loss.len() - 1;
        let piece = (0..last).rev().find(|k| loss >= self.loss[*k]);
        match piece {
            Some(k) => {
                let along = (loss - self.loss[k]) / (self.loss[k + 1] - self.loss[k]);
                self.kpa[k] + along * (self.kpa[k + 1] - self.kpa[k])
            }
            None => self.kpa[0],
        }
    }
}

/// A pressure map.
#[derive(Debug, Clone, PartialEq)]
pub struct Pressure {
    /// One value per triangle of the region, kPa.
    pub kpa: Vec<f64>,
    /// Total load, N.
    pub newtons: f64,
}

impl Pressure {
    /// The largest pressure, kPa.
    pub fn largest_kpa(&self) -> f64 {
        self.kpa.iter().copied().fold(0.0, f64::max)
    }

    /// The relative map converted to kPa, for pictures.
    pub fn map(&self, relative: &Map) -> Map {
        Map {
            values: self.kpa.clone(),
            unit: MapUnit::Pressure,
            ..relative.clone()
        }
    }
}

fn check(mesh: &Mesh, map: &Map) -> Result<(), CalibrationError> {
    if map.unit != MapUnit::RelativeConductance {
        return Err(CalibrationError::Other(format!(
            "a map of {} is not a relative change",
            map.unit.label()
        )));
    }
    if map.mesh_hash != mesh.hash() || map.values.len() != mesh.region().len() {
        return Err(CalibrationError::Other(
            "the map is of another mesh".to_owned(),
        ));
    }
    Ok(())
}

fn terms(frame: &[f64; 4], at: [f64; 2]) -> [f64; TERMS] {
    let (x, y) = ((at[0] - frame[0]) / frame[2], (at[1] - frame[1]) / frame[3]);
    [x, y, x * x, x * y, y * y]
}

fn gain_at(gain: &[f64; TERMS], frame: &[f64; 4], at: [f64; 2]) -> f64 {
    let log: f64 = gain
        .iter()
        .zip(terms(frame, at))
        .map(|(g, term)| g * term)
        .sum();
    log.exp().clamp(GAIN[0], GAIN[1])
}

#[cfg(test)]
mod tests;
