//! From relative loss of conductance to pressure: a monotone curve, and a gain over the position.
//!
//! A method's map of a press depends on the press, on the place and on the method: it is blurred, and weaker where the
//! readings see less. So a calibration belongs to one mesh and one method, and is fitted to that method's own maps of presses
//! whose mass and area are known. The curve is linear between knots with increments that are not negative, which makes both
//! what a map says in all (newtons) and what it says under the press (kPa) linear in the increments: a least-squares problem
//! with bounds, small enough for coordinate descent. The gain is a second-degree polynomial over the region, found from the
//! ratio of what presses of all places say to what they should; curve and gain are found in turns.

mod fit;

use serde::{Deserialize, Serialize};
use survey::{Map, MapUnit};

use crate::Mesh;

/// What a calibration file begins with.
pub const CALIBRATION_KIND: &str = "tactus-calibration-1";
/// Fewer presses say nothing about a curve.
pub const FEWEST_PRESSES: usize = 6;
/// Fewer different pressures make no curve.
pub const FEWEST_PRESSURES: usize = 3;
/// Presses that differ from the fitted curve by more than this share (rms) contradict each other.
pub const CONTRADICTION: f64 = 0.35;
/// Terms of the gain: x, y, x^2, x y, y^2 over the region's half extents.
const TERMS: usize = 5;
/// How far a gain may go from one.
const GAIN: [f64; 2] = [0.2, 5.0];

/// A press whose mass is known, as a method shows it.
#[derive(Debug, Clone)]
pub struct KnownPress {
    /// What a person calls it.
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
    /// Knots: relative loss of conductance over the gain, ascending, the first one where pressure begins.
    pub loss: Vec<f64>,
    /// Pressure at the knots, kPa, never falling.
    pub kpa: Vec<f64>,
    /// Centre of the region and its half extents, m: what the gain's x and y are measured in.
    pub frame: [f64; 4],
    /// Gain: exp of these times x, y, x^2, x y, y^2.
    pub gain: [f64; TERMS],
    /// Presses it was fitted to.
    pub presses: usize,
    /// Root mean square of (found - true) / true force over them.
    pub rms: f64,
}

/// Why there is no calibration.
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
    /// All presses of nearly the same pressure.
    #[error(
        "the presses have {found} different pressures; a curve needs {FEWEST_PRESSURES} (two within 5 % count as one)"
    )]
    OnePressure {
        /// How many there are.
        found: usize,
    },
    /// A press that is none.
    #[error("press '{name}': {what} is {value}, it must be a positive number")]
    Measure {
        /// Its name.
        name: String,
        /// Which measure.
        what: &'static str,
        /// What it is.
        value: f64,
    },
    /// A press that leaves no trace in its map.
    #[error(
        "press '{name}' ({newtons:.1} N) leaves no loss in its map: is it the right frame, and is the press inside the region?"
    )]
    Unseen {
        /// Its name.
        name: String,
        /// Its force.
        newtons: f64,
    },
    /// No one curve serves them.
    #[error(
        "the presses contradict each other: no one curve serves them within {limit:.0} % (rms {rms:.0} %); the worst is '{worst}', \
         {found:.1} N by the curve and {newtons:.1} N by its mass. Check masses, areas and places"
    )]
    Contradictory {
        /// Share that is allowed, %.
        limit: f64,
        /// Share that remains, %.
        rms: f64,
        /// The press that fits worst.
        worst: String,
        /// What the curve says.
        found: f64,
        /// What its mass says.
        newtons: f64,
    },
    /// A file that is no calibration, or a map of another mesh or method.
    #[error("the calibration does not fit: {0}")]
    Other(String),
}

impl Calibration {
    /// Fits curve and gain to presses of one method on one mesh.
    ///
    /// # Errors
    /// Too few presses or pressures, a measure that is not positive, a press that its map does not show, presses that
    /// contradict each other.
    pub fn fit(mesh: &Mesh, presses: &[KnownPress]) -> Result<Self, CalibrationError> {
        fit::fit(mesh, presses)
    }

    /// Whether the numbers of a file make a calibration.
    ///
    /// # Errors
    /// What is wrong with them.
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
        if self.kpa[0] < 0.0 || !self.kpa.windows(2).all(|pair| pair[0] <= pair[1]) {
            return refuse("kpa must never fall, from 0 or more");
        }
        if !(self.frame[2] > 0.0 && self.frame[3] > 0.0) {
            return refuse("the half extents in frame must be positive");
        }
        Ok(())
    }

    /// A relative map as pressure, kPa; gains of conductance are no pressure.
    ///
    /// # Errors
    /// A map of another mesh, of another method, or that is no relative change.
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

    /// The curve; beyond its last knot it goes on as its last piece.
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

/// A map as pressure.
#[derive(Debug, Clone, PartialEq)]
pub struct Pressure {
    /// One value a triangle of the region, kPa.
    pub kpa: Vec<f64>,
    /// Total load, N.
    pub newtons: f64,
}

impl Pressure {
    /// The largest of its values, kPa.
    pub fn largest_kpa(&self) -> f64 {
        self.kpa.iter().copied().fold(0.0, f64::max)
    }

    /// The relative map that it was made from, in kPa: for pictures.
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
            "a map of {} is no relative change",
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
