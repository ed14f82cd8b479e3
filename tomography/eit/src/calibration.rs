//! From relative loss of conductance to pressure: a monotone curve, and a gain over the position.
//!
//! A method's map of a press depends on the press, on the place and on the method: it is blurred, and weaker where the
//! readings see less. So a calibration belongs to one mesh and one method, and is fitted to that method's own maps of presses
//! whose mass and area are known. The curve is linear between knots with increments that are not negative, which makes both
//! what a map says in all (newtons) and what it says under the press (kPa) linear in the increments: a least-squares problem
//! with bounds, small enough for coordinate descent. The gain is a second-degree polynomial over the region, found from the
//! ratio of what presses of all places say to what they should; curve and gain are found in turns.

use nalgebra::{DMatrix, DVector};
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
/// More presses than this are needed for a gain over the position.
const FOR_A_GAIN: usize = 9;
/// Knots of the curve.
const KNOTS: usize = 9;
/// Turns of curve and gain.
const TURNS: usize = 8;
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
        if presses.len() < FEWEST_PRESSES {
            return Err(CalibrationError::TooFew {
                found: presses.len(),
            });
        }
        let mut pressures = Vec::new();
        for press in presses {
            for (what, value) in [("area", press.area), ("force", press.newtons)] {
                if !(value > 0.0 && value.is_finite()) {
                    return Err(CalibrationError::Measure {
                        name: press.name.clone(),
                        what,
                        value,
                    });
                }
            }
            pressures.push(press.newtons / press.area);
        }
        pressures.sort_by(f64::total_cmp);
        let different = 1 + pressures
            .windows(2)
            .filter(|pair| pair[1] > 1.05 * pair[0])
            .count();
        if different < FEWEST_PRESSURES {
            return Err(CalibrationError::OnePressure { found: different });
        }
        let frame = frame(mesh);
        let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
        let mut largest = 0.0_f64;
        for press in presses {
            check(mesh, &press.map)?;
            match press.map.largest_loss() {
                Some((_, loss)) => largest = largest.max(loss),
                None => {
                    return Err(CalibrationError::Unseen {
                        name: press.name.clone(),
                        newtons: press.newtons,
                    });
                }
            }
        }
        let mut gain = [0.0; TERMS];
        let mut fitted = None;
        for _ in 0..TURNS {
            // the first knot: what is less is blur and noise
            let top = 1.05 * largest * widest(&gain);
            let loss: Vec<f64> = (0..KNOTS)
                .map(|k| top * (0.005 + 0.995 * (k as f64 / (KNOTS - 1) as f64).powf(1.5)))
                .collect();
            let mut rows = DMatrix::zeros(2 * presses.len(), KNOTS - 1);
            let mut wanted = DVector::zeros(2 * presses.len());
            for (k, press) in presses.iter().enumerate() {
                let radius = (press.area / std::f64::consts::PI).sqrt();
                let (mut under, mut covered) = (vec![0.0; KNOTS - 1], 0.0);
                for (t, value) in press.map.values.iter().enumerate() {
                    let share = increments(&loss, -value / gain_at(&gain, &frame, centroids[t]));
                    let inside = (centroids[t][0] - press.centre[0])
                        .hypot(centroids[t][1] - press.centre[1])
                        <= radius;
                    covered += if inside { areas[t] } else { 0.0 };
                    for (column, share) in share.into_iter().enumerate() {
                        // kPa times m2 are kN; every row is a share of what it should be
                        rows[(2 * k, column)] += 1e3 * share * areas[t] / press.newtons;
                        under[column] += if inside { share * areas[t] } else { 0.0 };
                    }
                }
                wanted[2 * k] = 1.0;
                if covered > 0.0 {
                    // what stands under the press counts less: blur takes from it at every place
                    let weight = 0.2;
                    for (column, under) in under.into_iter().enumerate() {
                        let kpa = 1e-3 * press.newtons / press.area;
                        rows[(2 * k + 1, column)] = weight * under / covered / kpa;
                    }
                    wanted[2 * k + 1] = weight;
                }
            }
            let steps = not_negative(&rows, &wanted);
            let mut kpa = vec![0.0];
            for step in steps.iter() {
                kpa.push(kpa[kpa.len() - 1] + step);
            }
            let ratios: Vec<f64> = (0..presses.len())
                .map(|k| (rows.row(2 * k) * &steps)[0])
                .collect();
            fitted = Some((loss, kpa, gain, ratios.clone()));
            if presses.len() < FOR_A_GAIN {
                break;
            }
            let places: Vec<[f64; TERMS]> = presses
                .iter()
                .map(|press| terms(&frame, press.centre))
                .collect();
            for (value, correction) in gain.iter_mut().zip(log_ratio(&places, &ratios)) {
                *value += correction;
            }
        }
        let Some((loss, kpa, gain, ratios)) = fitted else {
            unreachable!("there is at least one turn");
        };
        let rms = (ratios
            .iter()
            .map(|ratio| (ratio - 1.0).powi(2))
            .sum::<f64>()
            / ratios.len() as f64)
            .sqrt();
        if rms > CONTRADICTION {
            let off = |k: &usize| (ratios[*k] - 1.0).abs();
            let worst = (0..ratios.len())
                .max_by(|a, b| off(a).total_cmp(&off(b)))
                .unwrap_or(0);
            return Err(CalibrationError::Contradictory {
                limit: 100.0 * CONTRADICTION,
                rms: 100.0 * rms,
                worst: presses[worst].name.clone(),
                found: ratios[worst] * presses[worst].newtons,
                newtons: presses[worst].newtons,
            });
        }
        Ok(Self {
            kind: CALIBRATION_KIND.to_owned(),
            mesh: mesh.hash().to_owned(),
            method: presses[0].map.method.clone(),
            loss,
            kpa,
            frame,
            gain,
            presses: presses.len(),
            rms,
        })
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

/// Centre and half extents of the region's centroids, m.
fn frame(mesh: &Mesh) -> [f64; 4] {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for centroid in mesh.region_centroids() {
        for axis in 0..2 {
            low[axis] = low[axis].min(centroid[axis]);
            high[axis] = high[axis].max(centroid[axis]);
        }
    }
    [
        0.5 * (low[0] + high[0]),
        0.5 * (low[1] + high[1]),
        0.5 * (high[0] - low[0]),
        0.5 * (high[1] - low[1]),
    ]
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

/// The largest that 1 / gain can be within the region.
fn widest(gain: &[f64; TERMS]) -> f64 {
    let most: f64 = gain.iter().map(|g| g.abs()).sum();
    most.exp().min(GAIN[0].recip())
}

/// How much of each piece of the curve lies below a loss: 0 to 1, the last one on and on.
fn increments(knots: &[f64], loss: f64) -> Vec<f64> {
    let pieces = knots.len() - 1;
    (0..pieces)
        .map(|k| {
            let share = ((loss - knots[k]) / (knots[k + 1] - knots[k])).max(0.0);
            if k + 1 == pieces {
                share
            } else {
                share.min(1.0)
            }
        })
        .collect()
}

/// Least squares with unknowns of zero or more, by coordinate descent.
fn not_negative(rows: &DMatrix<f64>, wanted: &DVector<f64>) -> DVector<f64> {
    const ROUNDS: usize = 20_000;
    let mut normal = rows.transpose() * rows;
    let right = rows.transpose() * wanted;
    let size = normal.nrows();
    // pieces that no press reaches follow their neighbours instead of being free
    let little = 1e-9 * normal.trace().max(f64::MIN_POSITIVE);
    for k in 0..size {
        normal[(k, k)] += little;
    }
    let mut found = DVector::<f64>::zeros(size);
    for _ in 0..ROUNDS {
        let mut moved = 0.0_f64;
        for k in 0..size {
            let slope = right[k] - (normal.row(k) * &found)[0];
            let next = (found[k] + slope / normal[(k, k)]).max(0.0);
            moved = moved.max((next - found[k]).abs());
            found[k] = next;
        }
        if moved <= 1e-12 * found.amax() {
            break;
        }
    }
    found
}

/// The polynomial that the logarithms of the ratios follow, without its constant; a little ridge keeps it small where the
/// places do not tell.
fn log_ratio(places: &[[f64; TERMS]], ratios: &[f64]) -> [f64; TERMS] {
    let count = places.len();
    let design = DMatrix::from_fn(count, TERMS + 1, |i, j| {
        if j == TERMS { 1.0 } else { places[i][j] }
    });
    let logs = DVector::from_fn(count, |i, _| ratios[i].max(1e-3).ln());
    let mut normal = design.transpose() * &design;
    for k in 0..TERMS {
        normal[(k, k)] += 0.02 * count as f64;
    }
    match normal.cholesky() {
        Some(factor) => {
            let found = factor.solve(&(design.transpose() * logs));
            std::array::from_fn(|k| found[k])
        }
        None => [0.0; TERMS],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DiscTank;

    /// Presses on a tank whose method shows a smooth bump: its height follows the pressure and the place.
    fn presses(mesh: &Mesh, wrong: f64) -> Vec<KnownPress> {
        let frame = frame(mesh);
        let centroids = mesh.region_centroids();
        let mut presses = Vec::new();
        for (k, (kpa, x, y)) in [
            (5.0, 0.0, 0.0),
            (5.0, 0.5, 0.0),
            (10.0, 0.0, 0.4),
            (10.0, -0.5, 0.1),
            (20.0, 0.0, 0.0),
            (20.0, 0.4, 0.4),
            (40.0, -0.3, -0.4),
            (40.0, 0.1, 0.5),
            (40.0, 0.0, 0.0),
            (30.0, 0.45, -0.2),
            (15.0, -0.45, -0.1),
            (25.0, 0.2, 0.2),
        ]
        .into_iter()
        .enumerate()
        {
            let centre = [frame[0] + x * frame[2], frame[1] + y * frame[3]];
            let area = 4e-3;
            let radius = (area / std::f64::consts::PI).sqrt();
            let seen = 1.0 + 0.6 * (x * x + y * y);
            let top = kpa / (kpa + 25.0) * seen;
            let values = centroids
                .iter()
                .map(|p| {
                    let d = (p[0] - centre[0]).hypot(p[1] - centre[1]) / radius;
                    if d <= 1.0 {
                        -top
                    } else {
                        -top * (-4.0 * (d - 1.0)).exp()
                    }
                })
                .collect();
            presses.push(KnownPress {
                name: format!("press {}", k + 1),
                map: Map {
                    mesh_hash: mesh.hash().to_owned(),
                    values,
                    unit: MapUnit::RelativeConductance,
                    method: "bump".to_owned(),
                    masked: 0,
                },
                centre,
                area,
                newtons: 1e3 * kpa * area * if k % 3 == 0 { wrong } else { 1.0 },
            });
        }
        presses
    }

    fn tank() -> Mesh {
        DiscTank::default().mesh().unwrap()
    }

    #[test]
    fn known_presses_come_back_within_a_tenth() {
        let mesh = tank();
        let presses = presses(&mesh, 1.0);
        let calibration = Calibration::fit(&mesh, &presses).unwrap();
        calibration.check().unwrap();
        assert!(calibration.rms < 0.1, "{calibration:?}");
        assert!(calibration.kpa.windows(2).all(|pair| pair[0] <= pair[1]));
        for press in &presses {
            let found = calibration.pressure(&mesh, &press.map).unwrap();
            let off = found.newtons / press.newtons - 1.0;
            assert!(off.abs() < 0.2, "{}: {off}", press.name);
        }
        // without a gain over the position the outer presses read too much
        let flat = Calibration {
            gain: [0.0; TERMS],
            ..calibration.clone()
        };
        let outer = presses[1].clone();
        let (with, without) = (
            calibration.pressure(&mesh, &outer.map).unwrap().newtons,
            flat.pressure(&mesh, &outer.map).unwrap().newtons,
        );
        assert!((without - outer.newtons).abs() > (with - outer.newtons).abs());
    }

    #[test]
    fn too_few_alike_contradictory_and_unseen_presses_are_refused() {
        let mesh = tank();
        let good = presses(&mesh, 1.0);
        assert!(matches!(
            Calibration::fit(&mesh, &good[..5]),
            Err(CalibrationError::TooFew { found: 5 })
        ));
        let alike: Vec<KnownPress> = good
            .iter()
            .map(|press| KnownPress {
                newtons: good[0].newtons,
                ..press.clone()
            })
            .collect();
        assert!(matches!(
            Calibration::fit(&mesh, &alike),
            Err(CalibrationError::OnePressure { found: 1 })
        ));
        assert!(matches!(
            Calibration::fit(&mesh, &presses(&mesh, 8.0)),
            Err(CalibrationError::Contradictory { .. })
        ));
        let mut unseen = good.clone();
        unseen[2].map.values.fill(0.0);
        let refused = Calibration::fit(&mesh, &unseen).unwrap_err();
        assert!(refused.to_string().contains("press 3"), "{refused}");
        let mut weightless = good.clone();
        weightless[4].newtons = 0.0;
        assert!(matches!(
            Calibration::fit(&mesh, &weightless),
            Err(CalibrationError::Measure { what: "force", .. })
        ));
    }

    #[test]
    fn another_method_mesh_or_file_is_refused() {
        let mesh = tank();
        let good = presses(&mesh, 1.0);
        let calibration = Calibration::fit(&mesh, &good).unwrap();
        let mut other = good[0].map.clone();
        other.method = "another".to_owned();
        assert!(calibration.pressure(&mesh, &other).is_err());
        let falling = Calibration {
            kpa: calibration.kpa.iter().rev().copied().collect(),
            ..calibration.clone()
        };
        assert!(falling.check().is_err());
        let foreign = Calibration {
            kind: "something".to_owned(),
            ..calibration
        };
        assert!(foreign.check().is_err());
    }
}
