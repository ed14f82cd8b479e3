//! Reconstructs loads as a few convex shapes.
//!
//! A frame of few presses has few unknowns: position, size, corners and loss of each. They are fitted with the full
//! forward model, so large losses cause no linearisation error. The residual of the fit tells whether a few shapes
//! explain the frame ([`Shapes`]).
//!
//! - [`shape`]: a disc, or a polygon on a circle as Algorithm 1 of the paper draws it, as free parameters with a prior
//! - [`coverage`]: the share of each triangle that an outline covers; [`model`]: readings and their derivatives
//! - [`fit`]: Levenberg and Marquardt; [`search`]: a beam of joint fits; [`posterior`]: the mean over what is probable

mod coverage;
mod fit;
mod model;
mod posterior;
mod search;
mod shape;

use std::sync::Arc;

use crate::{Case, ForwardError, Mesh, ReconstructError, Reconstructor};
use nalgebra::DVector;
use survey::{Map, MapUnit, Protocol, Reading};

use coverage::Cover;
use fit::{Data, Problem};
use model::SheetModel;
use search::{Library, Settings};

/// Model error (mainly of the mesh) as a share of each change and of their root mean square. Measured: the preset's
/// mesh and one of 2.25 times the triangles differ by 1 to 3 % of a change's norm.
const MODEL_ERROR: f64 = 0.01;
/// Mean square of the residual, in units of noise and model error, above which a frame is not explained by shapes.
const EXPLAINED: f64 = 9.0;
/// The evidence is raised to 1 / this: errors of the model are correlated between readings.
const TEMPER: f64 = 4.0;
/// Number of precomputed single shapes.
const LIBRARY: usize = 800;
/// Draws for the posterior mean.
const DRAWS: usize = 100;
const SEED: u64 = 5;

/// Reconstructs maps of few shapes, and uses another method for frames that these do not explain.
pub struct Shapes {
    model: SheetModel,
    cover: Cover,
    library: Library,
    /// Deviation of one reading, V.
    noise_v: f64,
    protocol: Protocol,
    otherwise: Arc<dyn Reconstructor>,
}

impl Shapes {
    /// `sigma0`: S per square, one per triangle of the mesh; `noise_v`: standard deviation of one reading, V;
    /// `otherwise` reconstructs frames that shapes do not explain.
    ///
    /// # Errors
    /// The forward model cannot be solved.
    pub fn new(
        case: &Case,
        sigma0: &[f64],
        noise_v: f64,
        otherwise: Arc<dyn Reconstructor>,
    ) -> Result<Self, ForwardError> {
        let model = SheetModel::new(
            &case.mesh,
            &case.contact_ohm_m,
            sigma0,
            &case.protocol,
            &case.currents,
        )?;
        let cover = Cover::new(&case.mesh);
        let problem = Problem {
            model: &model,
            cover: &cover,
        };
        let library = Library::new(&problem, LIBRARY, SEED)?;
        Ok(Self {
            library,
            model,
            cover,
            noise_v,
            protocol: case.protocol.clone(),
            otherwise,
        })
    }

    /// Change in units of its deviation; missing readings have weight zero. `None` if there is no change.
    fn data(&self, baseline: &[Reading], frame: &[Reading]) -> (Option<Data>, usize) {
        let volts = |reading: &Reading| reading.volts().map(|v| v.0).filter(|v| v.is_finite());
        let (mut cross, mut square) = (0.0, 0.0);
        for (reading, model) in baseline.iter().zip(&self.model.baseline) {
            if let Some(volts) = volts(reading) {
                cross += volts * model;
                square += model * model;
            }
        }
        let scale = cross / square;
        let change: Vec<Option<f64>> = baseline
            .iter()
            .zip(frame)
            .map(|(before, now)| Some((volts(now)? - volts(before)?) / scale))
            .collect();
        let valid: Vec<f64> = change.iter().copied().flatten().collect();
        let missing = change.len() - valid.len();
        let rms = (valid.iter().map(|c| c * c).sum::<f64>() / valid.len() as f64).sqrt();
        if !(rms > 0.0 && scale > 0.0) {
            return (None, missing);
        }
        let noise = 2.0 * (self.noise_v / scale).powi(2);
        let weights = DVector::from_iterator(
            change.len(),
            change.iter().map(|change| {
                change.map_or(0.0, |c| {
                    let model = MODEL_ERROR * MODEL_ERROR * (c * c + rms * rms);
                    1.0 / (noise + model).sqrt()
                })
            }),
        );
        let change = DVector::from_iterator(weights.len(), change.iter().map(|c| c.unwrap_or(0.0)));
        let white = change.component_mul(&weights);
        (Some(Data { white, weights }), missing)
    }
}

impl Reconstructor for Shapes {
    fn method(&self) -> &str {
        "shapes"
    }

    fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    fn mesh(&self) -> &Arc<Mesh> {
        &self.model.mesh
    }

    fn assumptions(&self) -> Vec<String> {
        vec![
            "a frame is one to four discs or polygons on circles of up to 70 mm, each with a loss of 0 to 100 %".to_owned(),
            format!(
                "noise {:e} V a reading, white; the model is trusted to {:.0} % of a change",
                self.noise_v,
                100.0 * MODEL_ERROR
            ),
            format!(
                "frames that such shapes leave unexplained by more than {:.0} deviations: {}",
                EXPLAINED.sqrt(),
                self.otherwise.method()
            ),
        ]
    }

    fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        // the other method checks counts, missing readings and dead or reversed baselines
        let general = self.otherwise.reconstruct(baseline, frame)?;
        let (data, masked) = self.data(baseline, frame);
        let Some(data) = data else {
            return Ok(general);
        };
        let problem = Problem {
            model: &self.model,
            cover: &self.cover,
        };
        let numerical = |fault: ForwardError| ReconstructError::Numerical {
            method: "shapes".to_owned(),
            cause: fault.to_string(),
        };
        let fits = search::search(&problem, &self.library, &data, &Settings::default())
            .map_err(numerical)?;
        let Some((_, best)) = fits.first() else {
            return Ok(general);
        };
        let readings = (frame.len() - masked) as f64;
        if 2.0 * best.misfit > EXPLAINED * readings {
            return Ok(general);
        }
        let values = posterior::mean(&problem, &fits, TEMPER, DRAWS);
        if values.iter().any(|value| !value.is_finite()) {
            return Ok(general);
        }
        Ok(Map {
            mesh_hash: self.model.mesh.hash().to_owned(),
            values,
            unit: MapUnit::RelativeConductance,
            method: format!(
                "shapes ({}, {:.2} deviations left)",
                best.shapes.len(),
                (2.0 * best.misfit / readings).sqrt()
            ),
            masked,
            quality: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DiscTank;
    use nalgebra::DMatrix;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use shape::Shape;

    fn tank() -> Case {
        let tank = DiscTank {
            radius_mm: 100.0,
            fineness: 0.7,
            ..DiscTank::default()
        };
        let mesh = tank.mesh().unwrap();
        let protocol = Protocol::sheffield(16).unwrap();
        Case {
            contact_ohm_m: tank.contact_ohm_m(),
            currents: vec![1e-3; protocol.len()],
            has_region: false,
            protocol,
            sigma: [("homog".to_owned(), vec![1e-3; mesh.triangles().len()])].into(),
            mesh: Arc::new(mesh),
        }
    }

    #[test]
    fn the_area_covered_is_the_outlines_own() {
        let case = tank();
        let cover = Cover::new(&case.mesh);
        let areas = case.mesh.region_areas();
        let mut random = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..50 {
            // well inside of the tank
            let shape = Shape::draw([[-0.02; 2], [0.02; 2]], &mut random);
            let outline = shape.outline();
            let o = outline[0];
            let own: f64 = outline
                .windows(2)
                .map(|w| {
                    let (p, q) = (
                        [w[0][0] - o[0], w[0][1] - o[1]],
                        [w[1][0] - o[0], w[1][1] - o[1]],
                    );
                    0.5 * (p[0] * q[1] - p[1] * q[0])
                })
                .sum();
            let covered: f64 = cover
                .of(&outline)
                .iter()
                .map(|&(t, share)| share * areas[t as usize])
                .sum();
            assert!((covered - own).abs() < 1e-12, "{covered} {own}");
        }
    }

    #[test]
    fn derivatives_are_those_of_the_forward_model() {
        let flat = tank();
        let depth = crate::Depth::new(0.2, 0.02, 0.07, 12).unwrap();
        let deep = Arc::new(flat.mesh.with_depth(Some(depth)));
        for mesh in [Arc::clone(&flat.mesh), deep] {
            check_derivatives(&Case {
                mesh,
                ..flat.clone()
            });
        }
    }

    fn check_derivatives(case: &Case) {
        let model = SheetModel::new(
            &case.mesh,
            &case.contact_ohm_m,
            &case.sigma["homog"],
            &case.protocol,
            &case.currents,
        )
        .unwrap();
        let unknowns = case.mesh.region().len();
        let map: Vec<f64> = (0..unknowns)
            .map(|k| -0.5 * f64::from(u8::from(k % 3 == 0)))
            .collect();
        let direction: Vec<f64> = (0..unknowns).map(|k| ((k * 7) % 5) as f64 - 2.0).collect();
        let solved = model.solve(&map).unwrap();
        let listed = direction
            .iter()
            .enumerate()
            .map(|(k, d)| (k as u32, vec![(0, *d)]))
            .collect();
        let along: DMatrix<f64> = model.along(&solved, &listed, 1).unwrap();
        let moved = |step: f64| {
            let map: Vec<f64> = map
                .iter()
                .zip(&direction)
                .map(|(x, d)| x + step * d)
                .collect();
            model.solve(&map).unwrap().change
        };
        let (up, down) = (moved(1e-5), moved(-1e-5));
        let size = along.amax();
        for reading in 0..up.len() {
            let difference = (up[reading] - down[reading]) / 2e-5;
            assert!((difference - along[(reading, 0)]).abs() < 1e-6 * size);
        }
    }

    fn readings(case: &Case, map: &[f64], noise: f64, seed: u64) -> Vec<Reading> {
        use rand_distr::{Distribution, Normal};
        let forward = crate::Forward::new(Arc::clone(&case.mesh), &case.contact_ohm_m).unwrap();
        let sigma: Vec<f64> = map.iter().map(|x| 1e-3 * (1.0 + x)).collect();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let noise = Normal::new(0.0, noise).unwrap();
        forward
            .readings(&sigma, &case.protocol)
            .unwrap()
            .iter()
            .map(|v| Reading::Ok(survey::Volts(1e-3 * v + noise.sample(&mut random))))
            .collect()
    }

    /// A disc is found with its loss; a field that is not a shape goes to the other method; the same bits on any number
    /// of threads.
    #[test]
    fn a_disc_is_found_and_a_ramp_is_not_a_shape() {
        let case = tank();
        let sigma0 = &case.sigma["homog"];
        let general = || {
            crate::OneStep::new(
                Arc::clone(&case.mesh),
                &case.contact_ohm_m,
                sigma0,
                &case.protocol,
                crate::OneStepOptions::default(),
            )
            .unwrap()
        };
        let shapes = Shapes::new(&case, sigma0, 1e-6, Arc::new(general())).unwrap();
        let cover = Cover::new(&case.mesh);
        let outline: Vec<[f64; 2]> = (0..64)
            .map(|k| {
                let (sin, cos) = (f64::from(k) / 64.0 * std::f64::consts::TAU).sin_cos();
                [0.03 + 0.02 * cos, -0.01 + 0.02 * sin]
            })
            .collect();
        let mut truth = vec![0.0; case.mesh.region().len()];
        for (t, share) in cover.of(&outline) {
            truth[t as usize] = -0.6 * share;
        }
        let baseline = readings(&case, &vec![0.0; truth.len()], 1e-6, 1);
        let frame = readings(&case, &truth, 1e-6, 2);
        let map = shapes.reconstruct(&baseline, &frame).unwrap();
        assert!(map.method.starts_with("shapes"), "{}", map.method);
        let (mut error, mut size) = (0.0, 0.0);
        for (found, truth) in map.values.iter().zip(&truth) {
            error += (found - truth).powi(2);
            size += truth * truth;
        }
        assert!(error < 0.02 * size, "{}", error / size);
        let again = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap()
            .install(|| {
                Shapes::new(&case, sigma0, 1e-6, Arc::new(general()))
                    .unwrap()
                    .reconstruct(&baseline, &frame)
                    .unwrap()
            });
        assert_eq!(map, again);
        // a baseline against itself has no load
        let none = shapes.reconstruct(&baseline, &baseline).unwrap();
        assert!(none.values.iter().all(|value| *value == 0.0));
        // gains of conductance everywhere on one side
        let ramp: Vec<f64> = case
            .mesh
            .region_centroids()
            .iter()
            .map(|c| 5.0 * c[0])
            .collect();
        let frame = readings(&case, &ramp, 1e-6, 3);
        let map = shapes.reconstruct(&baseline, &frame).unwrap();
        assert!(map.method.starts_with("one-step"), "{}", map.method);
    }
}
