//! Alternating fit: bounded least squares for the curve, a polynomial for the gain.

use nalgebra::{DMatrix, DVector};

use super::{
    CALIBRATION_KIND, CONTRADICTION, Calibration, CalibrationError, FEWEST_PRESSES,
    FEWEST_PRESSURES, GAIN, KnownPress, TERMS, check, gain_at, terms,
};
use crate::{Mesh, bounding_box};

/// More presses than this are needed for a gain over the position.
const FOR_A_GAIN: usize = 9;
/// Knots of the curve.
const KNOTS: usize = 9;
/// Alternations of curve and gain.
const TURNS: usize = 8;
/// Weight of the pressure under a press relative to its total force: blur lowers the pressure everywhere.
const UNDER: f64 = 0.2;

pub(super) fn fit(mesh: &Mesh, presses: &[KnownPress]) -> Result<Calibration, CalibrationError> {
    plausible(presses)?;
    one_method(presses)?;
    let largest = largest_loss(mesh, presses)?;
    let frame = frame(mesh);
    let mut gain = [0.0; TERMS];
    let mut turn = Turn::new(mesh, presses, &frame, gain, largest);
    if presses.len() >= FOR_A_GAIN {
        let places: Vec<[f64; TERMS]> = presses
            .iter()
            .map(|press| terms(&frame, press.centre))
            .collect();
        for _ in 1..TURNS {
            for (value, correction) in gain.iter_mut().zip(log_ratio(&places, &turn.ratios)) {
                *value += correction;
            }
            turn = Turn::new(mesh, presses, &frame, gain, largest);
        }
    }
    let Turn {
        loss,
        kpa,
        gain,
        ratios,
    } = turn;
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
        let KnownPress { name, newtons, .. } = &presses[worst];
        return Err(CalibrationError(format!(
            "the presses contradict each other: no single curve fits them within {:.0} % (rms {:.0} %); the worst is '{name}', \
             {:.1} N by the curve and {newtons:.1} N by its mass. Check masses, areas and places",
            100.0 * CONTRADICTION,
            100.0 * rms,
            ratios[worst] * newtons
        )));
    }
    Ok(Calibration {
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

/// Checks that there are enough presses, that every measure is a positive number, and that the pressures differ.
fn plausible(presses: &[KnownPress]) -> Result<(), CalibrationError> {
    if presses.len() < FEWEST_PRESSES {
        return Err(CalibrationError(format!(
            "{} presses are too few for a calibration; {FEWEST_PRESSES} are needed, at {FEWEST_PRESSURES} pressures or more",
            presses.len()
        )));
    }
    let mut pressures = Vec::new();
    for press in presses {
        for (what, value) in [("area", press.area), ("force", press.newtons)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(CalibrationError(format!(
                    "press '{}': {what} is {value}, it must be a positive number",
                    press.name
                )));
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
        return Err(CalibrationError(format!(
            "the presses have {different} different pressures; a curve needs {FEWEST_PRESSURES} (two within 5 % count as one)"
        )));
    }
    Ok(())
}

/// Checks that all maps are by one method: losses of two methods do not lie on one curve.
fn one_method(presses: &[KnownPress]) -> Result<(), CalibrationError> {
    let first = &presses[0];
    match presses
        .iter()
        .find(|press| press.map.method != first.map.method)
    {
        Some(other) => Err(CalibrationError(format!(
            "the map of '{}' is by '{}', that of '{}' by '{}'; a calibration needs maps of one method: choose one that \
             does not change from frame to frame, such as one-step or tv",
            first.name, first.map.method, other.name, other.map.method
        ))),
        None => Ok(()),
    }
}

/// The largest loss in any of the maps. Checks that every map is of this mesh and shows its press.
fn largest_loss(mesh: &Mesh, presses: &[KnownPress]) -> Result<f64, CalibrationError> {
    let mut largest = 0.0_f64;
    for press in presses {
        check(mesh, &press.map)?;
        match press.map.largest_loss() {
            Some((_, loss)) => largest = largest.max(loss),
            None => {
                return Err(CalibrationError(format!(
                    "press '{}' ({:.1} N) shows no loss in its map: is it the right frame, and is the press inside the region?",
                    press.name, press.newtons
                )));
            }
        }
    }
    Ok(largest)
}

/// A curve for a given gain, and its prediction for every press.
struct Turn {
    loss: Vec<f64>,
    kpa: Vec<f64>,
    gain: [f64; TERMS],
    /// Estimated over true force.
    ratios: Vec<f64>,
}

impl Turn {
    fn new(
        mesh: &Mesh,
        presses: &[KnownPress],
        frame: &[f64; 4],
        gain: [f64; TERMS],
        largest: f64,
    ) -> Self {
        let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
        // the first knot: smaller losses are blur and noise
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
                let share = increments(&loss, -value / gain_at(&gain, frame, centroids[t]));
                let inside = (centroids[t][0] - press.centre[0])
                    .hypot(centroids[t][1] - press.centre[1])
                    <= radius;
                covered += if inside { areas[t] } else { 0.0 };
                for (column, share) in share.into_iter().enumerate() {
                    // kPa times m2 are kN; every row is divided by its true value
                    rows[(2 * k, column)] += 1e3 * share * areas[t] / press.newtons;
                    under[column] += if inside { share * areas[t] } else { 0.0 };
                }
            }
            wanted[2 * k] = 1.0;
            if covered > 0.0 {
                for (column, under) in under.into_iter().enumerate() {
                    let kpa = 1e-3 * press.newtons / press.area;
                    rows[(2 * k + 1, column)] = UNDER * under / covered / kpa;
                }
                wanted[2 * k + 1] = UNDER;
            }
        }
        let steps = not_negative(&rows, &wanted);
        let mut kpa = vec![0.0];
        for step in steps.iter() {
            kpa.push(kpa[kpa.len() - 1] + step);
        }
        let ratios = (0..presses.len())
            .map(|k| (rows.row(2 * k) * &steps)[0])
            .collect();
        Self {
            loss,
            kpa,
            gain,
            ratios,
        }
    }
}

/// Centre and half extents of the region's centroids, m.
pub(super) fn frame(mesh: &Mesh) -> [f64; 4] {
    let [low, high] = bounding_box(mesh.region_centroids());
    [
        0.5 * (low[0] + high[0]),
        0.5 * (low[1] + high[1]),
        0.5 * (high[0] - low[0]),
        0.5 * (high[1] - low[1]),
    ]
}

/// The largest that 1 / gain can be within the region.
fn widest(gain: &[f64; TERMS]) -> f64 {
    let most: f64 = gain.iter().map(|g| g.abs()).sum();
    most.exp().min(GAIN[0].recip())
}

/// How much of each piece of the curve lies below a loss: 0 to 1; the last piece has no upper end.
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

/// Non-negative least squares, by coordinate descent.
fn not_negative(rows: &DMatrix<f64>, wanted: &DVector<f64>) -> DVector<f64> {
    const ROUNDS: usize = 20_000;
    let mut normal = rows.transpose() * rows;
    let right = rows.transpose() * wanted;
    let size = normal.nrows();
    // pieces that no press reaches follow their neighbours
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

/// The polynomial that fits the logarithms of the ratios, without its constant. A small ridge term keeps it small where
/// the positions do not determine it.
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
