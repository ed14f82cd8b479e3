//! Diagram 4: location error (mm) against frame time (s) for settings of the measurement.

use std::sync::Arc;
use std::time::Duration;

use eit::{Hyper, Mesh, OneStep, OneStepOptions, PaperSheet, Preset, Reconstructor};
use keysight_34980a::MapError;
use nalgebra::{DMatrix, Matrix2};
use phantom::{FINER, Load, Phantom, Scene, across};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;
use simulator::{FrameTimes, Profile};
use survey::{Amps, Measurement, Plan, Protocol, RangeRule, Reading, Volts, Wiring};

use crate::evaluation::average;
use crate::failure::{Attempt, Failure};
use crate::judging_seed;
use crate::progress;
use crate::tradeoff::Effort;
use crate::tradeoff::panel::FARTHEST_MM;
use crate::tradeoff::panel::{Panel, Point};

/// Four positions in the region, mm, of a press of 10 mm that halves the conductance.
const PRESSES_MM: [[f64; 2]; 4] = [[107.0, 115.0], [70.0, 80.0], [150.0, 100.0], [40.0, 190.0]];
const DISC_MM: f64 = 10.0;
/// Step for the derivative of the readings with respect to the position, mm.
const STEP_MM: f64 = 0.5;
/// Number of frames in a baseline.
const BASELINE: f64 = 10.0;
/// Ranges of the voltmeter, V, and the margin of a range for a press.
const RANGES: [f64; 3] = [0.1, 1.0, 10.0];
const MARGIN: f64 = 1.5;
/// Compliance of the source, V.
const COMPLIANCE: f64 = 20.0;

/// A module, with its wiring of pairs to the instruments.
struct Module {
    name: &'static str,
    profile: &'static str,
    wiring: fn(usize) -> Result<Wiring, MapError>,
    /// Whether the wiring can connect any two electrodes as a pair.
    free: bool,
}

const MODULES: [Module; 5] = [
    Module {
        name: "34924A pairs, reed",
        profile: "pairs-34924a",
        wiring: |n| keysight_34980a::pairs_34924a(1, n),
        free: false,
    },
    Module {
        name: "34922A pairs, armature",
        profile: "pairs-34922a",
        wiring: |n| keysight_34980a::pairs_34922a(1, n),
        free: false,
    },
    Module {
        name: "34925A pairs, FET",
        profile: "fast-34925a",
        wiring: |n| keysight_34980a::fast_34925a(1, 2, n),
        free: false,
    },
    Module {
        name: "34934A matrix, reed",
        profile: "matrix-34934a",
        wiring: |n| keysight_34980a::matrix_34934a(1, n),
        free: true,
    },
    Module {
        name: "34932A matrix, armature",
        profile: "matrix-34932a",
        wiring: |n| keysight_34980a::matrix_34932a(1, n),
        free: false,
    },
];

/// Settings of the measurement except the current.
#[derive(Clone, Copy)]
struct Way {
    skip: usize,
    half: bool,
    nplc: f64,
    averages: u32,
}

impl Way {
    /// All combinations, in order.
    fn all(effort: &Effort) -> Vec<Self> {
        let skips: &[usize] = effort.of(&[0, 2][..], &[0, 2, 4]);
        let halves: &[bool] = effort.of(&[false][..], &[false, true]);
        let integrations: &[f64] = effort.of(&[0.02, 1.0][..], &[0.02, 0.2, 1.0, 2.0, 10.0]);
        let repeats: &[u32] = effort.of(&[1][..], &[1, 4]);
        let mut all = Vec::new();
        for &skip in skips {
            for &half in halves {
                for &nplc in integrations {
                    all.extend(repeats.iter().map(|&averages| Self {
                        skip,
                        half,
                        nplc,
                        averages,
                    }));
                }
            }
        }
        all
    }

    /// Noise of a reading as a share of its range.
    fn noise_share(&self) -> f64 {
        keysight_34980a::resolution(self.nplc) / f64::from(self.averages).sqrt()
    }
}

/// Results of one setting.
struct Found {
    bound_mm: f64,
    /// Mean location error of each draw, mm.
    errors_mm: Vec<f64>,
    /// Noise of a reading, rms over the readings, V.
    noise_v: f64,
}

/// Numbers of electrodes along the width and along the height of the compared sheets.
const RINGS: [[usize; 2]; 4] = [[4, 4], [5, 5], [6, 7], [8, 8]];

/// Numbers of electrodes along the width and along the height of the compared sheet with this number of electrodes;
/// `None` if there is no such sheet.
pub fn ring(electrodes: usize) -> Option<[usize; 2]> {
    let count = |[width, height]: &[usize; 2]| 2 * (width + height);
    RINGS.into_iter().find(|ring| count(ring) == electrodes)
}

pub(crate) fn panel(effort: &Effort) -> Result<Panel, Failure> {
    let rings: &[[usize; 2]] = effort.of(&[RINGS[0], RINGS[2]][..], &RINGS);
    let ways = Way::all(effort);
    let currents: &[f64] = effort.of(&[1e-3][..], &[1e-4, 1e-3, 1e-2]);
    let modules: Vec<&Module> = MODULES
        .iter()
        .filter(|module| effort.full || ["pairs-34924a", "matrix-34934a"].contains(&module.profile))
        .collect();
    let mut points = Vec::new();
    for &[along_width, along_height] in rings {
        let sheet = PaperSheet {
            electrodes_per_width: along_width,
            electrodes_per_height: along_height,
            fineness: effort.of(0.5, 0.7),
            ..PaperSheet::default()
        };
        let electrodes = sheet.electrodes();
        let truth = Truth::new(&sheet)?;
        let bar = progress::bar(ways.len(), "maps");
        let found: Vec<Vec<Found>> = ways
            .par_iter()
            .map(|way| {
                let each = currents
                    .iter()
                    .map(|&current| truth.found(way, current, effort));
                let found = each.collect();
                bar.inc(1);
                found
            })
            .collect::<Result<_, Failure>>()?;
        bar.finish_and_clear();
        for module in &modules {
            let mut times = module.times(&sheet)?;
            let bar = progress::bar(ways.len(), "frames");
            for (way, found) in ways.iter().zip(&found) {
                bar.inc(1);
                if !module.free && way.skip > 0 {
                    continue;
                }
                let plan = module.plan(electrodes, way.skip, way.half)?;
                let seconds = times
                    .of(&plan, way.nplc, way.averages)
                    .attempt("a plan in virtual time")?
                    .as_secs_f64();
                let measured = currents.iter().zip(found);
                points.extend(measured.map(|(&current, found)| {
                    point(module, electrodes, way, current, seconds, found)
                }));
            }
            bar.finish_and_clear();
        }
    }
    Ok(Panel {
        panel: "acquisition".to_owned(),
        title: "Acquisition: millimetres against seconds".to_owned(),
        across: "a frame, s".to_owned(),
        up: "location error, mm".to_owned(),
        shows: format!(
            "A {DISC_MM} mm press that takes half the conductance, found by one-step (mean over four places, bars over {} draws of \
             the noise), against what a frame takes by the instruments' own clock: integration, averages, half or whole frame, \
             pattern, module, number of electrodes and current, every reading on the range that fits its baseline; the table \
             has the lower bound of any unbiased method.",
            Effort::SEEDS
        ),
        not_proved: "Noise is the voltmeter's table value and nothing else (no thermal voltages, drift or mains; `scene \
                     explain` names their sizes), the method is one of many, and neither settling nor the messages to the instruments \
                     are in the time: one per injection, 2 to 5 ms each on a real instrument, a large part of a fast frame."
            .to_owned(),
        not_built: Vec::new(),
        costs: true,
        points,
    })
}

fn point(
    module: &Module,
    electrodes: usize,
    way: &Way,
    current: f64,
    seconds: f64,
    found: &Found,
) -> Point {
    let pattern = match way.skip {
        0 => String::new(),
        skip => format!(", skip {skip}"),
    };
    let setting = format!(
        "{electrodes} electrodes, {} PLC x {}, {}{} mA",
        way.nplc,
        way.averages,
        if way.half { "half, " } else { "" },
        1e3 * current
    );
    let line = format!("{}{pattern}", module.name);
    Point::new(line, setting, seconds, &found.errors_mm)
        .with("bound, mm", found.bound_mm)
        .with("noise, uV rms", 1e6 * found.noise_v)
        .with("electrodes", electrodes as f64)
        .with("NPLC", way.nplc)
        .with("averages", f64::from(way.averages))
        .with("half", f64::from(u8::from(way.half)))
        .with("skip", way.skip as f64)
        .with("current, mA", 1e3 * current)
}

fn protocol(electrodes: usize, skip: usize, half: bool) -> Result<Protocol, Failure> {
    let whole = survey::skip(electrodes, skip);
    let measurements: Vec<Measurement> = match half {
        true => survey::half(whole).collect(),
        false => whole.collect(),
    };
    Protocol::new(electrodes, measurements).attempt("the pattern")
}

impl Module {
    fn times(&self, sheet: &PaperSheet) -> Result<FrameTimes, Failure> {
        let profile = Profile::shipped(self.profile).ok_or_else(|| {
            Failure::because(format!(
                "profile '{}' does not ship with this build",
                self.profile
            ))
        })?;
        // only the time of the readings matters, so a coarse mesh is sufficient
        let scene = Scene {
            sheet: Preset::PaperSheet(PaperSheet {
                fineness: 0.5,
                ..sheet.clone()
            }),
            ..Scene::quiet()
        };
        FrameTimes::new(&profile, scene).attempt("the simulated rig")
    }

    fn plan(&self, electrodes: usize, skip: usize, half: bool) -> Result<Plan, Failure> {
        let wiring = (self.wiring)(electrodes).attempt("the wiring")?;
        let protocol = protocol(electrodes, skip, half)?;
        let wiring = wiring.joining(&protocol).chained();
        Plan::new(
            &protocol,
            &wiring,
            Amps(1e-3),
            Volts(COMPLIANCE),
            Duration::ZERO,
        )
        .attempt("the plan")
    }
}

/// The simulated sheet on a finer mesh, and the model of the reconstruction. The matrices are transfer impedances, ohm.
struct Truth {
    sheet: PaperSheet,
    model: Arc<Mesh>,
    empty: DMatrix<f64>,
    /// The sheet with each press.
    pressed: Vec<DMatrix<f64>>,
    /// Derivatives with respect to the position of each press, ohm/mm: along x, along y.
    slopes: Vec<[DMatrix<f64>; 2]>,
}

impl Truth {
    fn new(sheet: &PaperSheet) -> Result<Self, Failure> {
        let failed = |fault| Failure::of("the simulated sheet", &fault);
        let model = Arc::new(sheet.mesh().attempt("the mesh")?);
        let mut phantom = Phantom::new(Scene {
            sheet: Preset::PaperSheet(PaperSheet {
                fineness: 1.0,
                ..sheet.clone()
            })
            .remeshed(FINER, 1),
            ..Scene::quiet()
        })
        .map_err(failed)?;
        let mut at = |place: Option<[f64; 2]>| -> Result<DMatrix<f64>, Failure> {
            phantom.release();
            if let Some(place) = place {
                phantom
                    .press(Load::disc(place, DISC_MM, 0.5))
                    .map_err(failed)?;
            }
            phantom
                .transfer_impedance(Duration::ZERO)
                .cloned()
                .map_err(failed)
        };
        let empty = at(None)?;
        let (mut pressed, mut slopes) = (Vec::new(), Vec::new());
        for [x, y] in PRESSES_MM {
            pressed.push(at(Some([x, y]))?);
            let along_x = at(Some([x + STEP_MM, y]))? - at(Some([x - STEP_MM, y]))?;
            let along_y = at(Some([x, y + STEP_MM]))? - at(Some([x, y - STEP_MM]))?;
            slopes.push([along_x / (2.0 * STEP_MM), along_y / (2.0 * STEP_MM)]);
        }
        Ok(Self {
            sheet: sheet.clone(),
            model,
            empty,
            pressed,
            slopes,
        })
    }

    fn found(&self, way: &Way, current: f64, effort: &Effort) -> Result<Found, Failure> {
        let protocol = protocol(self.sheet.electrodes(), way.skip, way.half)?;
        let of = |z: &DMatrix<f64>| readings(&protocol, z, current);
        let empty = of(&self.empty);
        let ranges = RangeRule {
            available: RANGES.map(Volts).to_vec(),
            margin: MARGIN,
        };
        let noise: Vec<f64> = empty
            .iter()
            .map(|volts| {
                let range = ranges
                    .choose(Volts(*volts))
                    .map_or(RANGES[2], |range| range.0);
                way.noise_share() * range
            })
            .collect();
        let noise_v = average(noise.iter().map(|noise| noise * noise)).sqrt();
        let bounds = self
            .slopes
            .iter()
            .map(|[along_x, along_y]| bound(&of(along_x), &of(along_y), &noise));
        let failed = |fault: &dyn std::error::Error| Failure::of("one-step", fault);
        let sigma0 = vec![self.sheet.conductance(); self.model.triangles().len()];
        let method = OneStep::new(
            Arc::clone(&self.model),
            &self.sheet.contact_ohm_m(),
            &sigma0,
            &protocol,
            OneStepOptions {
                hyper: Hyper::Noise {
                    volts: noise_v,
                    current,
                },
                deviations: Some(noise.clone()),
                ..OneStepOptions::default()
            },
        )
        .map_err(|fault| failed(&fault))?;
        let (centroids, areas) = (self.model.region_centroids(), self.model.region_areas());
        let mut errors_mm = Vec::new();
        for draw in 0..Effort::SEEDS {
            let mut random = ChaCha8Rng::seed_from_u64(judging_seed(effort.seed, draw));
            let unit = Normal::new(0.0, 1.0).expect("constants");
            let mut noisy = |volts: &[f64], times: f64| -> Vec<Reading> {
                volts
                    .iter()
                    .zip(&noise)
                    .map(|(volts, noise)| {
                        Reading::Ok(Volts(volts + times * noise * unit.sample(&mut random)))
                    })
                    .collect()
            };
            let baseline = noisy(&empty, BASELINE.sqrt().recip());
            let mut errors = Vec::new();
            for (place, z) in PRESSES_MM.iter().zip(&self.pressed) {
                let frame = noisy(&of(z), 1.0);
                let map = method
                    .reconstruct(&baseline, &frame)
                    .map_err(|fault| failed(&fault))?;
                // a map without a loss has no position; it gets the error [`FARTHEST_MM`]
                errors.push(map.found(&centroids, &areas).map_or(FARTHEST_MM, |[x, y]| {
                    (1e3 * x - place[0]).hypot(1e3 * y - place[1])
                }));
            }
            errors_mm.push(average(errors.into_iter()));
        }
        Ok(Found {
            bound_mm: average(bounds),
            errors_mm,
            noise_v,
        })
    }
}

fn readings(protocol: &Protocol, z: &DMatrix<f64>, current: f64) -> Vec<f64> {
    protocol
        .measurements()
        .iter()
        .map(|q| current * across(z, q.sense, q.drive))
        .collect()
}

/// Cramer-Rao bound on the rms location error of unbiased methods, mm, for a load of known size and loss and a baseline
/// that is the mean of [`BASELINE`] frames.
fn bound(along_x: &[f64], along_y: &[f64], noise: &[f64]) -> f64 {
    let mut information = Matrix2::zeros();
    for ((x, y), noise) in along_x.iter().zip(along_y).zip(noise) {
        let weight = 1.0 / (noise * noise * (1.0 + 1.0 / BASELINE));
        information += weight * Matrix2::new(x * x, x * y, x * y, y * y);
    }
    information
        .try_inverse()
        .map_or(f64::NAN, |inverse| inverse.trace().sqrt())
}

#[cfg(test)]
mod tests {
    use keysight_34980a::Model;

    use super::*;

    #[test]
    fn duration_of_frames_follows_the_formula() {
        let sheet = PaperSheet::default();
        for (module, model) in [
            (&MODULES[0], Model::M34924A),
            (&MODULES[1], Model::M34922A),
            (&MODULES[3], Model::M34934A),
            (&MODULES[4], Model::M34932A),
        ] {
            let timing = model.timing(1.0, 50.0);
            let plan = module.plan(26, 0, false).unwrap();
            let took = module.times(&sheet).unwrap().of(&plan, 1.0, 1).unwrap();
            let ratio = took.as_secs_f64() / plan.duration(&timing).as_secs_f64();
            assert!((ratio - 1.0).abs() < 0.01, "{}: {ratio}", module.name);
        }
    }

    #[test]
    fn the_bound_is_that_of_independent_coordinates() {
        // each coordinate is determined by a separate reading
        let noise = [2.0, 3.0];
        let expected = ((2.0_f64 / 4.0).powi(2) + (3.0_f64 / 5.0).powi(2)).sqrt();
        let bound = bound(&[4.0, 0.0], &[0.0, 5.0], &noise);
        assert!((bound / (expected * 1.1_f64.sqrt()) - 1.0).abs() < 1e-12);
    }
}
