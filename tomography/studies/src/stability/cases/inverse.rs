//! Hard cases 14 to 18: a sensitivity without full rank, hyper-parameters at both ends, total variation, and bounds.

use std::collections::BTreeMap;
use std::sync::Arc;

use eit::{
    Hyper, Mesh, OneStep, OneStepError, OneStepOptions, Prior, Reconstructor, Scale, Strength, Tv,
    TvOptions,
};
use nalgebra::{DMatrix, DVector, SVD};
use survey::Reading;

use crate::failure::{Attempt, Failure};
use crate::readings::measured;
use crate::stability::outcome::{Check, Naive, Outcome, naive, worst};
use crate::stability::solvers::tank::{Tank, refused};

/// Drive current, A.
const CURRENT: f64 = 1e-3;

fn unsolved(fault: OneStepError) -> Failure {
    Failure::of("the one-step method", &fault)
}

/// A tank of sixteen electrodes with a load, its frames, and its sensitivity at the drive current.
struct Loaded {
    tank: Tank,
    baseline: Vec<Reading>,
    frame: Vec<Reading>,
    change: DVector<f64>,
    sensitivity: DMatrix<f64>,
}

impl Loaded {
    fn new(fineness: f64, left: f64) -> Result<Self, Failure> {
        let tank = Tank::sixteen(fineness)?;
        let load = tank.patch([0.4, 0.1], 0.3);
        let forward = tank.forward(&tank.contact)?;
        let volts = |sigma: &[f64]| -> Result<DVector<f64>, Failure> {
            Ok(forward.readings(sigma, &tank.protocol).map_err(refused)? * CURRENT)
        };
        let (before, after) = (volts(&tank.sigma)?, volts(&tank.with(&load, left))?);
        let mut sensitivity = forward
            .jacobian(&tank.sigma, &tank.protocol)
            .map_err(refused)?
            * (CURRENT * tank.sigma[0]);
        let mut change = &after - &before;
        // reciprocal rows are made equal bit for bit, because with a tiny lambda differences by rounding would appear
        // in the map
        for (reading, twin) in tank.protocol.reciprocal_twins().into_iter().enumerate() {
            if let Some(twin) = twin.filter(|&twin| twin < reading) {
                let row = sensitivity.row(twin).into_owned();
                sensitivity.set_row(reading, &row);
                change[reading] = change[twin];
            }
        }
        Ok(Self {
            baseline: measured(before.as_slice()),
            frame: measured(after.as_slice()),
            change,
            sensitivity,
            tank,
        })
    }

    fn step(&self, options: OneStepOptions) -> Result<OneStep, OneStepError> {
        let options = OneStepOptions {
            scale: Scale::Currents(vec![CURRENT; self.tank.protocol.len()]),
            ..options
        };
        self.tank.one_step(options)
    }

    fn tikhonov(&self, lambda: f64) -> Result<OneStep, OneStepError> {
        self.step(OneStepOptions {
            prior: Prior::Tikhonov,
            hyper: Hyper::Lambda(lambda),
            ..OneStepOptions::default()
        })
    }

    fn tv(&self, options: TvOptions) -> Result<Tv, Failure> {
        let options = TvOptions {
            scale: Scale::Currents(vec![CURRENT; self.tank.protocol.len()]),
            ..options
        };
        self.tank.tv(options)
    }
}

fn far(a: &DVector<f64>, b: &DVector<f64>) -> f64 {
    let apart = (a - b).amax() / b.amax();
    if apart.is_nan() { f64::INFINITY } else { apart }
}

/// 14: half of the readings are reciprocal to the other half, and the singular values of the rest span thirteen
/// decades.
pub(crate) fn without_rank() -> Result<Outcome, Failure> {
    let loaded = Loaded::new(0.3, 0.5)?;
    let svd = SVD::new(loaded.sensitivity.clone(), true, true);
    let (Some(u), Some(v_t)) = (&svd.u, &svd.v_t) else {
        return Err(Failure::because("the singular values were not found"));
    };
    let along = u.tr_mul(&loaded.change);
    let top = svd.singular_values.max();
    let (mut ours, mut normal, mut jump, mut normal_jump) = (0.0, 0.0, 0.0, 0.0);
    for share in [1e-1, 1e-3, 1e-5, 1e-7] {
        let lambda = share * top;
        let filtered = DVector::from_fn(along.len(), |i, _| {
            let s = svd.singular_values[i];
            along[i] * s / (s * s + lambda * lambda)
        });
        let exact = v_t.tr_mul(&filtered);
        let map = |lambda| -> Result<DVector<f64>, Failure> {
            let step = loaded.tikhonov(lambda).map_err(unsolved)?;
            Ok(step.matrix().map_err(unsolved)? * &loaded.change)
        };
        let found = map(lambda)?;
        ours = worst(ours, far(&found, &exact));
        let hasty = normal_equations(&loaded, lambda);
        normal = worst(normal, far(&hasty, &exact));
        let beside = lambda * (1.0 + 1e-9);
        jump = worst(jump, far(&map(beside)?, &found));
        normal_jump = worst(normal_jump, far(&normal_equations(&loaded, beside), &hasty));
    }
    Ok(Outcome::of([
        Check::at_most(
            "map against the filtered singular values, lambda/s1 to 1e-7",
            naive(normal, "has no inverse"),
            ours,
            1e-8,
        ),
        Check::at_most(
            "change of the map where lambda changes by 1e-9",
            naive(normal_jump.max(normal), "has no inverse"),
            jump,
            1e-8,
        ),
    ])
    .noted("naive: the explicit inverse of J'J + lambda^2 I in f32, which is not continuous because it is not a solution"))
}

/// The explicit inverse of the normal equations in f32.
fn normal_equations(loaded: &Loaded, lambda: f64) -> DVector<f64> {
    let j: DMatrix<f32> = loaded.sensitivity.map(|value| value as f32);
    let d: DVector<f32> = loaded.change.map(|value| value as f32);
    let mut system = j.tr_mul(&j);
    for i in 0..system.nrows() {
        system[(i, i)] += (lambda * lambda) as f32;
    }
    match system.try_inverse() {
        Some(inverse) => (inverse * j.tr_mul(&d)).map(f64::from),
        None => DVector::from_element(j.ncols(), f64::NAN),
    }
}

/// 15: hyper-parameters close to zero and to infinity.
pub(crate) fn ends_of_lambda() -> Result<Outcome, Failure> {
    let loaded = Loaded::new(0.3, 0.5)?;
    let svd = SVD::new(loaded.sensitivity.clone(), false, false);
    let top = svd.singular_values.max();
    let (mut rises, mut off, mut counted_off) = (0, 0.0, 0.0);
    let mut last = f64::INFINITY;
    for decade in -7..=4 {
        let lambda = top * 10_f64.powi(decade);
        let degrees = loaded
            .tikhonov(lambda)
            .and_then(|step| step.degrees_of_freedom())
            .map_err(unsolved)?;
        let exact: f64 = svd
            .singular_values
            .iter()
            .map(|s| s * s / (s * s + lambda * lambda))
            .sum();
        let counted = svd.singular_values.iter().filter(|s| **s > lambda).count();
        counted_off = worst(counted_off, (counted as f64 - exact).abs() / exact);
        rises += u8::from(degrees > last);
        off = worst(off, (degrees - exact).abs() / exact);
        last = degrees;
    }
    let tiny = loaded.tikhonov(1e-20 * top);
    let refused = matches!(tiny, Err(OneStepError::Lambda { .. }));
    let inverted = normal_equations(&loaded, 1e-20 * top)
        .iter()
        .all(|value| value.is_finite());
    let flat = loaded.tikhonov(1e4 * top).map_err(unsolved)?;
    let assumptions = flat.assumptions().join("\n");
    let flagged = assumptions.contains("less than one degree of freedom");
    let map = flat.matrix().map_err(unsolved)? * &loaded.change;
    Ok(Outcome::of([
        Check::at_most(
            "lambda of 1e-20 of the largest singular value, accepted",
            Naive::Error(f64::from(u8::from(inverted))),
            f64::from(u8::from(!refused)),
            0.0,
        ),
        Check::at_most(
            "degrees of freedom against the singular values",
            Naive::Error(counted_off),
            off,
            1e-6,
        ),
        Check::at_most(
                        "steps at which they rise with lambda",
            Naive::Absent("a count of singular values does not rise".into()),
            f64::from(rises),
            0.0,
        ),
        Check::at_most(
                        "largest change in a map of lambda -> infinity",
            Naive::Absent("every form gives zero".into()),
            map.amax(),
            1e-6,
        ),
        Check::at_most(
            "maps of it that pass as 'no load'",
            Naive::Absent("a matrix states no assumptions".into()),
            f64::from(u8::from(!flagged)),
            0.0,
        ),
    ])
    .noted("the largest lambda gives a map of zeros in every form; ours states this among its assumptions. Naive: the explicit inverse in f32, which returns an inverse without an error; the number of singular values above lambda, which never rises with lambda"))
}

/// 16: the exact absolute value, without smoothing.
pub(crate) fn total_variation() -> Result<Outcome, Failure> {
    let loaded = Loaded::new(0.3, 0.5)?;
    let unsolved = |fault| Failure::of("total variation", &fault);
    let tv = loaded.tv(TvOptions::default())?;
    let (flat, _) = tv
        .solve(&loaded.baseline, &loaded.baseline)
        .map_err(unsolved)?;
    let flat = flat.values.iter().fold(0.0_f64, |top, x| top.max(x.abs()));
    let noise = std::f64::consts::SQRT_2 * eit::DEFAULT_NOISE_V;
    let problem = Smoothed {
        sensitivity: &loaded.sensitivity / noise,
        borders: borders(&loaded.tank.mesh),
        alpha: tv.alpha(),
    };
    let still = DVector::zeros(loaded.change.len());
    let divided = problem.solve(&still, 0.0, 3).amax();
    let least = tv
        .minimum_offline(&loaded.baseline, &loaded.frame)
        .map_err(unsolved)?;
    let (solution, _) = tv
        .solve(&loaded.baseline, &loaded.frame)
        .map_err(unsolved)?;
    let over = |values: &[f64]| -> Result<f64, Failure> {
        let objective = tv
            .objective(&loaded.baseline, &loaded.frame, values)
            .map_err(unsolved)?;
        Ok(objective / least - 1.0)
    };
    let smoothed = problem.solve(&(&loaded.change / noise), 0.1, 20);
    let finer = loaded.tv(TvOptions {
        gap: 1e-6,
        ..TvOptions::default()
    })?;
    let (fine, _) = finer
        .solve(&loaded.baseline, &loaded.frame)
        .map_err(unsolved)?;
    let [coarse, fine] = [solution.values.clone(), fine.values].map(DVector::from_vec);
    let moved = |map: &DVector<f64>| (map - &fine).norm() / fine.norm();
    Ok(Outcome::of([
        Check::at_most(
            "largest change in the map of a frame like the baseline",
            naive(divided, "0/0 where the map is flat"),
            flat,
            0.0,
        ),
        Check::at_most(
            "objective over its minimum, less 1",
            Naive::Error(over(smoothed.as_slice())?),
            over(&solution.values)?,
            1e-3,
        ),
        Check::at_most(
            "change of the map from a gap of 1e-3 to one of 1e-6",
            Naive::Error(moved(&smoothed)),
            moved(&coarse),
            0.02,
        ),
    ])
    .noted(
        "ours has no beta: the absolute value is exact, and gaps of 1e-3 and 1e-6 are compared in place of two betas. Naive: lagged diffusivity with beta 0, and with beta 0.1",
    ))
}

/// |Jx - d|^2 / 2 + alpha sum L sqrt((xi - xj)^2 + beta^2) by lagged diffusivity.
struct Smoothed {
    sensitivity: DMatrix<f64>,
    borders: Vec<Border>,
    alpha: f64,
}

/// Two adjacent triangles and the length of their common side, m.
struct Border {
    sides: [usize; 2],
    length: f64,
}

fn borders(mesh: &Mesh) -> Vec<Border> {
    let all: Vec<usize> = (0..mesh.triangles().len()).collect();
    let borders = mesh.borders(&all).into_iter();
    borders
        .map(|([other, t], length)| Border {
            sides: [t, other],
            length,
        })
        .collect()
}

impl Smoothed {
    fn solve(&self, data: &DVector<f64>, beta: f64, rounds: usize) -> DVector<f64> {
        let gram = self.sensitivity.tr_mul(&self.sensitivity);
        let right = self.sensitivity.tr_mul(data);
        let mut x: DVector<f64> = DVector::zeros(right.len());
        for _ in 0..rounds {
            let mut system = gram.clone();
            for Border {
                sides: [a, b],
                length,
            } in &self.borders
            {
                let weight = self.alpha * length / (x[*a] - x[*b]).hypot(beta);
                system[(*a, *a)] += weight;
                system[(*b, *b)] += weight;
                system[(*a, *b)] -= weight;
                system[(*b, *a)] -= weight;
            }
            x = match system.lu().solve(&right) {
                Some(x) => x,
                None => DVector::from_element(x.len(), f64::NAN),
            };
        }
        // `amax` would ignore NaN
        if x.iter().all(|x| x.is_finite()) {
            x
        } else {
            DVector::from_element(x.len(), f64::INFINITY)
        }
    }
}

/// 17: the same image on meshes with other triangles.
pub(crate) fn unequal_triangles() -> Result<Outcome, Failure> {
    let tank = |seeding| {
        Tank::of(eit::DiscTank {
            electrodes: 8,
            arc_deg: 12.0,
            fineness: 0.7,
            seeding,
            ..eit::DiscTank::default()
        })
    };
    let plain = tank(0)?;
    let image = disc(&plain);
    let (weighed, counted) = (variation(&plain, &image)?, jumps(&plain.mesh, &image));
    let fine = Tank {
        mesh: Arc::new(quartered(&plain.mesh)?),
        sigma: vec![plain.sigma[0]; 4 * plain.sigma.len()],
        ..tank(0)?
    };
    let image: Vec<f64> = image.iter().flat_map(|x| [*x; 4]).collect();
    let (fine_weighed, fine_counted) = (variation(&fine, &image)?, jumps(&fine.mesh, &image));
    let (mut low, mut high) = (f64::INFINITY, 0.0_f64);
    let (mut few, mut many) = (f64::INFINITY, 0.0_f64);
    for seeding in 0..4 {
        let other = |fineness: f64| -> Result<Tank, Failure> {
            Tank::of(eit::DiscTank {
                fineness,
                ..tank(seeding)?.preset
            })
        };
        let fine = other(2.5)?;
        let weighed = variation(&fine, &disc(&fine))?;
        let around = std::f64::consts::TAU * DISC * fine.radius();
        low = low.min(weighed / around);
        high = high.max(weighed / around);
        // a coarser mesh has fewer jumps
        let coarse = other(if seeding % 2 == 0 { 0.7 } else { 1.4 })?;
        let counted = jumps(&coarse.mesh, &disc(&coarse));
        few = few.min(counted);
        many = many.max(counted);
    }
    Ok(Outcome::of([
        Check::at_most(
            "variation of one image on the quartered mesh, less 1",
            Naive::Error((fine_counted / counted - 1.0).abs()),
            (fine_weighed / weighed - 1.0).abs(),
            1e-12,
        ),
        Check::at_most(
            "spread over four meshes of a disc",
            Naive::Error(many / few - 1.0),
            high / low - 1.0,
            0.1,
        ),
        Check::at_most(
                        "border of the disc on triangles over its perimeter",
            Naive::Absent("a property of the mesh".into()),
            high,
            1.41,
        ),
    ])
    .noted(format!(
        "naive: jumps are counted, not weighted by the length of the border. A disc's border on triangles is {low:.2} to {high:.2} \
         times its perimeter"
    )))
}

/// Radius of the disc, in units of the tank's.
const DISC: f64 = 0.8;

/// 1 within the disc, 0 elsewhere.
fn disc(tank: &Tank) -> Vec<f64> {
    let inside = tank.patch([0.0, 0.0], DISC);
    let mut image = vec![0.0; tank.sigma.len()];
    inside.into_iter().for_each(|t| image[t] = 1.0);
    image
}

/// The sum of an image's jumps between adjacent triangles.
fn jumps(mesh: &Mesh, image: &[f64]) -> f64 {
    borders(mesh)
        .iter()
        .map(|border| (image[border.sides[0]] - image[border.sides[1]]).abs())
        .sum()
}

/// Variation of an image according to the objective of [`eit::Tv`], m.
fn variation(tank: &Tank, image: &[f64]) -> Result<f64, Failure> {
    // so large that the misfit is negligible in the objective
    const ALPHA: f64 = 1e18;
    let unsolved = |fault| Failure::of("total variation", &fault);
    let options = TvOptions {
        strength: Strength::Alpha(ALPHA),
        scale: Scale::Currents(vec![CURRENT; tank.protocol.len()]),
        ..TvOptions::default()
    };
    let tv = tank.tv(options)?;
    let baseline = measured(&tank.ours(&tank.contact, &tank.sigma)?);
    let objective = tv
        .objective(&baseline, &baseline, image)
        .map_err(unsolved)?;
    Ok(objective / ALPHA)
}

/// Every triangle divided into four at the middles of its sides; the four are consecutive.
fn quartered(mesh: &Mesh) -> Result<Mesh, Failure> {
    let mut nodes = mesh.nodes().to_vec();
    let mut middles = BTreeMap::new();
    let mut middle = |a: usize, b: usize| {
        *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
            let (p, q) = (mesh.nodes()[a], mesh.nodes()[b]);
            nodes.push([0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1])]);
            nodes.len() - 1
        })
    };
    let mut triangles = Vec::new();
    for &[a, b, c] in mesh.triangles() {
        let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
        triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    let edges = mesh
        .electrode_edges()
        .iter()
        .map(|edges| {
            edges
                .iter()
                .flat_map(|&[a, b]| {
                    let m = middle(a, b);
                    [[a, m], [m, b]]
                })
                .collect()
        })
        .collect();
    Mesh::new(nodes, triangles, edges, None).attempt("the quartered mesh")
}

/// 18: a load that removes nearly all conductance.
pub(crate) fn long_step() -> Result<Outcome, Failure> {
    let loaded = Loaded::new(0.5, 0.02)?;
    let map = |loss_only| -> Result<Vec<f64>, Failure> {
        let step = loaded
            .step(OneStepOptions {
                loss_only,
                ..OneStepOptions::default()
            })
            .map_err(unsolved)?;
        let map = step.reconstruct(&loaded.baseline, &loaded.frame);
        Ok(map.attempt("the one-step method")?.values)
    };
    let left = |map: &[f64]| {
        map.iter()
            .fold(f64::INFINITY, |least, x| least.min(1.0 + x))
    };
    let (free, bounded) = (map(false)?, map(true)?);
    let tv = loaded.tv(TvOptions {
        loss_only: true,
        ..TvOptions::default()
    })?;
    let (solution, _) = tv
        .solve(&loaded.baseline, &loaded.frame)
        .attempt("total variation")?;
    Ok(Outcome::of([
        Check::at_least(
            "smallest conductance of a map, of the unloaded",
            Naive::Error(left(&free)),
            left(&bounded).min(left(&solution.values)),
            0.0,
        ),
        Check::at_most(
            "largest gain where loads only take away",
            Naive::Error(free.iter().copied().fold(0.0, f64::max)),
            bounded.iter().chain(&solution.values).copied().fold(0.0, f64::max),
            0.0,
        ),
    ])
    .noted(
        "a bound above 0 is asked; 0 holds: a load may take all conductance, and the forward model has a floor for triangles without conductance (case 1). No step is shortened: the bounded problem itself is solved, so no objective can rise",
    ))
}
