//! Symmetries of a sheet: the mirror image of a training case is another case, which needs no forward solution.

use std::collections::BTreeMap;

use eit::{Case, bounding_box};
use survey::Dipole;

use crate::samples::{Sample, SampleError, Samples};

/// Tolerance for mirrored points, relative to the sheet's size.
const SAME: f64 = 1e-9;

/// A symmetry as a permutation of readings and of triangles of the region.
struct SymmetryPermutation {
    /// For each reading: the reading that replaces it, and its sign.
    readings: Vec<(usize, f32)>,
    /// For each triangle of the region: the triangle that replaces it.
    region: Vec<u32>,
}

/// A set extended by every symmetry of its sheet.
pub struct Symmetric<'s> {
    inner: &'s dyn Samples,
    turns: Vec<SymmetryPermutation>,
}

impl<'s> Symmetric<'s> {
    /// Finds the mirror symmetries about both middle lines and the half turn that preserve mesh, contacts, conductance
    /// and protocol; without any, the set is unchanged.
    pub fn new(inner: &'s dyn Samples, case: &Case, sigma0: &[f64]) -> Self {
        let turns = [[-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]]
            .into_iter()
            .filter_map(|signs| turn(case, sigma0, signs))
            .collect();
        Self { inner, turns }
    }

    /// Number of symmetric copies of each case, including the original.
    pub fn views(&self) -> usize {
        self.turns.len() + 1
    }
}

impl Samples for Symmetric<'_> {
    fn len(&self) -> usize {
        self.inner.len() * self.views()
    }

    fn outputs(&self) -> usize {
        self.inner.outputs()
    }

    fn baseline(&self) -> &[f64] {
        self.inner.baseline()
    }

    fn sample(&self, case: usize) -> Result<Sample, SampleError> {
        let sample = self.inner.sample(case / self.views())?;
        let Some(turn) = (case % self.views())
            .checked_sub(1)
            .map(|turn| &self.turns[turn])
        else {
            return Ok(sample);
        };
        let mut input = vec![0.0; sample.input.len()];
        for (value, &(reading, sign)) in sample.input.iter().zip(&turn.readings) {
            input[reading] = sign * value;
        }
        let mut target: Vec<(u32, f32)> = sample
            .target
            .iter()
            .map(|&(unknown, change)| (turn.region[unknown as usize], change))
            .collect();
        target.sort_by_key(|(unknown, _)| *unknown);
        Ok(Sample { input, target })
    }
}

/// The symmetry with these signs of the coordinates about the middle of the bounding box, if the sheet has it.
fn turn(case: &Case, sigma0: &[f64], signs: [f64; 2]) -> Option<SymmetryPermutation> {
    let mesh = &case.mesh;
    let [low, high] = bounding_box(mesh.nodes().iter().copied());
    let size = (high[0] - low[0]).max(high[1] - low[1]);
    let image = |p: [f64; 2]| {
        [0, 1].map(|axis| {
            let middle = 0.5 * (low[axis] + high[axis]);
            middle + signs[axis] * (p[axis] - middle)
        })
    };
    let electrodes = met(&mesh.electrode_centres(), image, SAME * size)?;
    let all: Vec<[f64; 2]> = (0..mesh.triangles().len())
        .map(|t| mesh.centroid(t))
        .collect();
    let triangles = met(&all, image, SAME * size)?;
    let same = |a: f64, b: f64| (a - b).abs() <= 1e-9 * a.abs();
    let alike = electrodes
        .iter()
        .enumerate()
        .all(|(from, &to)| same(case.contact_ohm_m[from], case.contact_ohm_m[to]))
        && triangles.iter().enumerate().all(|(from, &to)| {
            same(sigma0[from], sigma0[to]) && same(mesh.area(from), mesh.area(to))
        });
    if !alike {
        return None;
    }
    let place: BTreeMap<usize, u32> = mesh
        .region()
        .iter()
        .enumerate()
        .map(|(k, &t)| (t, k as u32))
        .collect();
    let region = mesh
        .region()
        .iter()
        .map(|&t| place.get(&triangles[t]).copied())
        .collect::<Option<_>>()?;
    let requested: BTreeMap<(Dipole, Dipole), usize> = case
        .protocol
        .measurements()
        .iter()
        .enumerate()
        .map(|(k, q)| ((q.drive, q.sense), k))
        .collect();
    let moved = |d: Dipole| Dipole {
        plus: survey::Electrode(electrodes[d.plus.0]),
        minus: survey::Electrode(electrodes[d.minus.0]),
    };
    let reversed = |d: Dipole| Dipole {
        plus: d.minus,
        minus: d.plus,
    };
    let readings = case
        .protocol
        .measurements()
        .iter()
        .map(|q| {
            let (drive, sense) = (moved(q.drive), moved(q.sense));
            [
                (drive, sense, 1.0),
                (reversed(drive), sense, -1.0),
                (drive, reversed(sense), -1.0),
                (reversed(drive), reversed(sense), 1.0),
            ]
            .into_iter()
            .find_map(|(drive, sense, sign)| Some((*requested.get(&(drive, sense))?, sign)))
        })
        .collect::<Option<Vec<(usize, f32)>>>()?;
    let currents = readings
        .iter()
        .enumerate()
        .all(|(from, (to, _))| same(case.currents[from], case.currents[*to]));
    currents.then_some(SymmetryPermutation { readings, region })
}

/// For each point the index of the point at its image, within the distance `within`; `None` if a point has none.
fn met(
    points: &[[f64; 2]],
    image: impl Fn([f64; 2]) -> [f64; 2],
    within: f64,
) -> Option<Vec<usize>> {
    let cell = |p: [f64; 2]| p.map(|x| (x / (10.0 * within)).floor() as i64);
    let mut cells: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for (k, &p) in points.iter().enumerate() {
        cells.entry(cell(p)).or_default().push(k);
    }
    points
        .iter()
        .map(|&p| {
            let q = image(p);
            let [i, j] = cell(q);
            (-1..=1)
                .flat_map(|di| (-1..=1).map(move |dj| [i + di, j + dj]))
                .filter_map(|at| cells.get(&at))
                .flatten()
                .copied()
                .find(|&k| (points[k][0] - q[0]).hypot(points[k][1] - q[1]) <= within)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use eit::{Preset, TrainingSettings};
    use survey::Protocol;

    use super::*;
    use crate::samples::Simulation;

    /// The paper's sheet with the Sheffield protocol, and its uniform conductance.
    fn sheet() -> (Case, Vec<f64>) {
        let preset = Preset::default();
        let mesh = preset.mesh().unwrap();
        let protocol = Protocol::sheffield(mesh.electrodes()).unwrap();
        let sigma0 = vec![preset.conductance(); mesh.triangles().len()];
        let case = Case {
            contact_ohm_m: preset.contact_ohm_m(),
            currents: vec![1e-3; protocol.len()],
            has_region: mesh.region().len() < mesh.triangles().len(),
            protocol,
            sigma: BTreeMap::new(),
            mesh: Arc::new(mesh),
        };
        (case, sigma0)
    }

    /// Mirrored readings equal the readings solved for the mirrored conductance.
    #[test]
    fn a_case_in_the_mirror_is_what_the_model_solves() {
        let (case, sigma0) = sheet();
        let settings = TrainingSettings {
            cases: 6,
            neurons: 1,
            ..TrainingSettings::default()
        };
        let simulation = Simulation::new(
            &case.mesh,
            &case.contact_ohm_m,
            &sigma0,
            &case.protocol,
            &settings,
        )
        .unwrap();
        let set = Symmetric::new(&simulation, &case, &sigma0);
        assert_eq!((set.views(), set.len()), (4, 24));
        let forward = eit::Forward::new(Arc::clone(&case.mesh), &case.contact_ohm_m).unwrap();
        let chosen = (0..6).find(|&c| !simulation.target(c).is_empty()).unwrap();
        for view in 0..4 {
            let sample = set.sample(4 * chosen + view).unwrap();
            let mut sigma = sigma0.clone();
            for (unknown, change) in &sample.target {
                sigma[case.mesh.region()[*unknown as usize]] *= 1.0 + f64::from(*change);
            }
            let volts = forward.readings(&sigma, &case.protocol).unwrap();
            for (k, value) in sample.input.iter().enumerate() {
                let solved = (volts[k] - simulation.baseline()[k]) / simulation.top();
                assert!(
                    (solved - f64::from(*value)).abs() < 1e-7,
                    "view {view}, reading {k}"
                );
            }
        }
        // one contact that differs breaks the symmetry
        let mut other = case.clone();
        other.contact_ohm_m[0] *= 2.0;
        assert_eq!(Symmetric::new(&simulation, &other, &sigma0).views(), 1);
    }
}
