//! From relative loss of conductance to pressure: a monotone curve, and a gain over the position.
//!
//! A method's map of a press depends on the press, its position and the method: it is blurred, and weaker where the
//! readings are less sensitive. A calibration therefore belongs to one mesh and one method, and is fitted to that
//! method's maps of presses of known mass and area. The curve is piecewise linear with non-negative increments, so that
//! a map's total force (newtons) and its pressure under the press (kPa) are both linear in the increments: a bounded
//! least-squares problem, small enough for coordinate descent. The gain is a second-degree polynomial over the region,
//! fitted to the ratios of estimated to true force over the positions. Curve and gain are fitted alternately.

mod fit;

use std::fmt::Display;

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

/// Why presses give no calibration, or why a calibration does not fit a map, in words.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct CalibrationError(String);

impl CalibrationError {
    /// A file that is not a calibration, or a map of another mesh or method.
    fn unfit(why: impl Display) -> Self {
        Self(format!("the calibration does not fit: {why}"))
    }
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
        let refuse = |why: &str| Err(CalibrationError::unfit(why));
        if self.kind != CALIBRATION_KIND {
            let kind = &self.kind;
            return refuse(&format!(
                "kind is '{kind}', '{CALIBRATION_KIND}' is expected"
            ));
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
            return Err(CalibrationError::unfit("it was fitted on another mesh"));
        }
        if map.method != self.method {
            return Err(CalibrationError::unfit(format_args!(
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
        return Err(CalibrationError::unfit(format_args!(
            "a map of {} is not a relative change",
            map.unit.label()
        )));
    }
    if map.mesh_hash != mesh.hash() || map.values.len() != mesh.region().len() {
        return Err(CalibrationError::unfit("the map is of another mesh"));
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
