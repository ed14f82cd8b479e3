//! Algorithm 1: random polygons of lost conductance, and the resulting readings.

use std::f64::consts::TAU;
use std::sync::Arc;

use eit::{
    Case, CentresChoice, ChangeChoice, Forward, LossChoice, Mesh, PointsChoice, SizeChoice,
    TrainingSettings, polygon_contains,
};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use survey::Protocol;

use super::{Purpose, Sample, SampleError, Samples, Sparse, TrainError, check, stream};

/// Cases of Algorithm 1 on a mesh, solved on demand.
///
/// Case c depends on the settings and c only, so parts of a set have the same bits on any machine.
pub struct Simulation {
    forward: Forward,
    protocol: Protocol,
    sigma0: Vec<f64>,
    /// Factor of the relative change of each triangle of the region ([`ChangeChoice`]).
    units: Vec<f64>,
    baseline: Vec<f64>,
    top: f64,
    region: Region,
    settings: TrainingSettings,
}

impl Simulation {
    /// A simulation with the unloaded conductance of `case`.
    ///
    /// # Errors
    /// As [`Simulation::new`].
    pub fn of_case(case: &Case, settings: &TrainingSettings) -> Result<Self, TrainError> {
        let sigma0 = case.unloaded_conductance();
        Self::new(
            &case.mesh,
            &case.contact_ohm_m,
            &sigma0,
            &case.protocol,
            settings,
        )
    }

    /// Solves the baseline at `sigma0` (S per square, one per triangle).
    ///
    /// # Errors
    /// Invalid settings, or a sheet that the forward model refuses.
    pub fn new(
        mesh: &Arc<Mesh>,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        protocol: &Protocol,
        settings: &TrainingSettings,
    ) -> Result<Self, TrainError> {
        check(settings)?;
        let forward = Forward::new(Arc::clone(mesh), contact_ohm_m)?;
        forward.check_changes()?;
        let baseline = forward.readings(sigma0, protocol)?.as_slice().to_vec();
        let top = baseline.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
        let unknowns = mesh.region();
        let units = match settings.open.change {
            ChangeChoice::Relative => vec![1.0; unknowns.len()],
            ChangeChoice::Absolute => {
                let mean = unknowns.iter().map(|&t| sigma0[t]).sum::<f64>() / unknowns.len() as f64;
                unknowns.iter().map(|&t| sigma0[t] / mean).collect()
            }
        };
        Ok(Self {
            region: Region::new(mesh, settings.open.centres),
            forward,
            protocol: protocol.clone(),
            sigma0: sigma0.to_vec(),
            units,
            baseline,
            top,
            settings: settings.clone(),
        })
    }

    /// The largest reading of the baseline, v-hat of Eq. 6, V at 1 A.
    pub fn top(&self) -> f64 {
        self.top
    }

    /// The target of a case ([`Sample::target`]), without solving it.
    pub fn target(&self, case: usize) -> Sparse {
        self.scaled(self.region.case(&self.settings, case))
    }

    /// Relative changes of triangles in the unit of the targets.
    fn scaled(&self, mut changes: Sparse) -> Sparse {
        for (unknown, change) in &mut changes {
            *change *= self.units[*unknown as usize] as f32;
        }
        changes
    }

    /// Solves one case.
    ///
    /// # Errors
    /// A case that the forward model refuses.
    pub fn solve(&self, case: usize) -> Result<Sample, TrainError> {
        let changes = self.region.case(&self.settings, case);
        let mesh = self.forward.mesh();
        let mut sigma = self.sigma0.clone();
        for &(unknown, change) in &changes {
            sigma[mesh.region()[unknown as usize]] *= 1.0 + f64::from(change);
        }
        let input: Vec<f32> = if changes.is_empty() {
            vec![0.0; self.baseline.len()]
        } else {
            self.forward
                .readings(&sigma, &self.protocol)?
                .iter()
                .zip(&self.baseline)
                .map(|(volts, zero)| ((volts - zero) / self.top) as f32)
                .collect()
        };
        let target = self.scaled(changes);
        Ok(Sample { input, target })
    }
}

impl Samples for Simulation {
    fn len(&self) -> usize {
        self.settings.cases
    }

    fn outputs(&self) -> usize {
        self.region.centroids.len()
    }

    fn baseline(&self) -> &[f64] {
        &self.baseline
    }

    fn sample(&self, case: usize) -> Result<Sample, SampleError> {
        let sample = self.solve(case).map_err(|cause| SampleError::Unsolved {
            case,
            cause: Box::new(cause),
        })?;
        sample.check("the simulation", case)?;
        Ok(sample)
    }
}

/// The region of interest, for drawing cases.
pub(super) struct Region {
    /// Corners of the triangles from which centres are drawn, m. `areas`: cumulative sums of their areas, m2.
    corners: Vec<[[f64; 2]; 3]>,
    areas: Vec<f64>,
    /// Centroids of the region's triangles, m.
    centroids: Vec<[f64; 2]>,
}

impl Region {
    pub(super) fn new(mesh: &Mesh, centres: CentresChoice) -> Self {
        let from: Vec<usize> = match centres {
            CentresChoice::Region => mesh.region().to_vec(),
            CentresChoice::Sheet => (0..mesh.triangles().len()).collect(),
        };
        let mut sum = 0.0;
        Self {
            corners: from.iter().map(|&t| mesh.corners(t)).collect(),
            areas: from
                .iter()
                .map(|&t| {
                    sum += mesh.area(t);
                    sum
                })
                .collect(),
            centroids: mesh.region_centroids(),
        }
    }

    /// A uniformly distributed point within the triangles from which centres are drawn.
    fn point(&self, random: &mut ChaCha8Rng) -> [f64; 2] {
        let total = self.areas.last().copied().unwrap_or_default();
        let at = random.random::<f64>() * total;
        let triangle = self
            .areas
            .partition_point(|sum| *sum <= at)
            .min(self.areas.len() - 1);
        let (mut p, mut q) = (random.random::<f64>(), random.random::<f64>());
        if p + q > 1.0 {
            (p, q) = (1.0 - p, 1.0 - q);
        }
        let [a, b, c] = self.corners[triangle];
        [0, 1].map(|axis| a[axis] + p * (b[axis] - a[axis]) + q * (c[axis] - a[axis]))
    }

    /// One case of Algorithm 1.
    pub(super) fn case(&self, settings: &TrainingSettings, case: usize) -> Sparse {
        let random = &mut stream(settings.seed, Purpose::Case, case);
        let mut kept = vec![1.0_f64; self.centroids.len()];
        let largest = match settings.open.size {
            SizeChoice::Radius => settings.radius_m,
            SizeChoice::Diameter => 0.5 * settings.radius_m,
        };
        let mut shared = None;
        for _ in 0..random.random_range(0..=settings.polygons) {
            let centre = self.point(random);
            let radius = random.random::<f64>() * largest;
            let drawn = random.random_range(0..=settings.vertices);
            let points = match settings.open.points {
                PointsChoice::Drawn => drawn,
                PointsChoice::All => settings.vertices,
            };
            let mut angles: Vec<f64> = (0..points).map(|_| random.random::<f64>() * TAU).collect();
            let own = random.random::<f64>();
            let loss = match settings.open.loss {
                LossChoice::Polygon => own,
                LossChoice::Case => *shared.get_or_insert(own),
            };
            angles.sort_by(f64::total_cmp);
            let polygon: Vec<[f64; 2]> = angles
                .iter()
                .map(|angle| {
                    [
                        centre[0] + radius * angle.cos(),
                        centre[1] + radius * angle.sin(),
                    ]
                })
                .collect();
            for (kept, centroid) in kept.iter_mut().zip(&self.centroids) {
                if (centroid[0] - centre[0]).abs() <= radius
                    && polygon_contains(&polygon, *centroid)
                {
                    match settings.open.loss {
                        LossChoice::Polygon => *kept *= 1.0 - loss,
                        LossChoice::Case => *kept = 1.0 - loss,
                    }
                }
            }
        }
        kept.iter()
            .enumerate()
            .filter(|(_, kept)| **kept < 1.0)
            .map(|(unknown, kept)| (unknown as u32, (kept - 1.0) as f32))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use eit::{DiscTank, OpenChoices, PaperSheet};

    #[test]
    fn a_polygon_of_fewer_than_three_vertices_holds_nothing() {
        assert!(!polygon_contains(&[], [0.0, 0.0]));
        assert!(!polygon_contains(&[[0.0, 0.0], [1.0, 1.0]], [0.5, 0.5]));
        let square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        assert!(polygon_contains(&square, [0.5, 0.5]));
        assert!(!polygon_contains(&square, [1.5, 0.5]));
    }

    #[test]
    fn ten_thousand_cases_are_drawn_and_some_are_unchanged() {
        let mesh = DiscTank::default().mesh().unwrap();
        let region = Region::new(&mesh, CentresChoice::Region);
        let settings = TrainingSettings::default();
        let unchanged = (0..10_000)
            .filter(|&case| {
                let target = region.case(&settings, case);
                assert!(
                    target
                        .iter()
                        .all(|(_, change)| (-1.0..0.0).contains(change))
                );
                target.is_empty()
            })
            .count();
        // 1/5 of the cases have no polygon, and half of all polygons have fewer than three vertices
        assert!((3500..5000).contains(&unchanged), "{unchanged}");
    }

    #[test]
    fn every_open_reading_changes_what_is_drawn() {
        let mesh = PaperSheet::default().mesh().unwrap();
        let drawn = |open: OpenChoices| {
            let region = Region::new(&mesh, open.centres);
            let settings = TrainingSettings {
                open,
                ..TrainingSettings::default()
            };
            let cases: Vec<Sparse> = (0..400).map(|case| region.case(&settings, case)).collect();
            let size: usize = cases.iter().map(Vec::len).sum();
            let empty = cases.iter().filter(|case| case.is_empty()).count();
            let losses = |case: &Sparse| {
                let mut values: Vec<u32> = case.iter().map(|(_, x)| x.to_bits()).collect();
                values.sort_unstable();
                values.dedup();
                values.len()
            };
            (size, empty, cases.iter().map(losses).max().unwrap_or(0))
        };
        let usual = drawn(OpenChoices::default());
        let of = |change: fn(&mut OpenChoices)| {
            let mut open = OpenChoices::default();
            change(&mut open);
            drawn(open)
        };
        assert!(of(|open| open.size = SizeChoice::Diameter).0 * 3 < usual.0);
        // only a case without any polygon is empty: a fifth
        let all = of(|open| open.points = PointsChoice::All);
        assert!((60..100).contains(&all.1), "{all:?}");
        assert!(usual.2 > 2);
        assert_eq!(of(|open| open.loss = LossChoice::Case).2, 1);
        // polygons with centres outside of the region cover less of it
        assert!(of(|open| open.centres = CentresChoice::Sheet).0 < usual.0);
    }

    #[test]
    fn target_of_an_unsolved_case_is_that_of_its_sample() {
        let mesh = Arc::new(DiscTank::default().mesh().unwrap());
        let triangles = mesh.triangles().len();
        let sigma0: Vec<f64> = (0..triangles)
            .map(|t| 1e-3 * (1.0 + t as f64 / triangles as f64))
            .collect();
        let settings = TrainingSettings {
            open: OpenChoices {
                change: ChangeChoice::Absolute,
                ..OpenChoices::default()
            },
            ..TrainingSettings::default()
        };
        let protocol = Protocol::sheffield(mesh.electrodes()).unwrap();
        let contacts = vec![1e-3; mesh.electrodes()];
        let simulation = Simulation::new(&mesh, &contacts, &sigma0, &protocol, &settings).unwrap();
        let loaded = (0..100).find(|&case| !simulation.target(case).is_empty());
        let case = loaded.unwrap();
        assert_eq!(
            simulation.target(case),
            simulation.solve(case).unwrap().target
        );
    }
}
